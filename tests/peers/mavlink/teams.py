"""Teams of two robots with stand-in autopilots: team files, processes, and what the robots have logged."""

import contextlib
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from bars import missed, program_of  # noqa: E402, F401

HERE = Path(__file__).resolve().parent
KEY = "0123456789abcdef" * 4
# Custom modes: that of setpoints, and one that a pilot chooses.
OWN = {"px4": 6 << 16, "ardupilot": 15}
PILOT = {"px4": 1 << 16, "ardupilot": 4}
NAMES = {"px4": "MANUAL", "ardupilot": "HOLD"}


def driver(firmware, port, more="", vehicle="rover"):
    body = ', setpoints = "body"' if (firmware, vehicle) == ("ardupilot", "rover") else ""
    return (f'{{ name = "mavlink", address = "udpin://127.0.0.1:{port}", autopilot = "{firmware}", '
            f'vehicle = "{vehicle}", speed_m_s = 0.6, arm = true, forward = "127.0.0.1:{port + 100}"{body}{more} }}')


def source(port, more=""):
    earth = "origin_latitude_deg = 52.2053, origin_longitude_deg = 0.1218"
    return f'{{ name = "mavlink", address = "udpin://127.0.0.1:{port + 100}", {earth}{more} }}'


def team_file(folder, firmware, port, episodes=2, driver_more="", source_more="", vehicle="rover", body=""):
    """Writes a team file of two robots that change places; each has its own host, and one has the state server."""
    drive = "holonomic" if vehicle == "copter" else "differential"
    text = f"""team = 53
scenario = "swap"
policy = "orca"
episodes = {episodes}
wall_radius_m = 0.3

[link.air]
interface = "lo"
group = "239.255.91.{port % 200 + 10}:{port}"

[safety]
own_state_s = 0.25

[deployment]
mode = "autopilots"
robots = 2
placement = "drive"
stepping = "seeded"

[deployment.body]
drive = "{drive}"
{"point_ahead_m = 0.2" if drive == "differential" else ""}
speed_m_s = 0.6
{"yaw_rate_rad_s = 1.5" if drive == "differential" else ""}
{body}
"""
    for robot in (0, 1):
        text += f"""
[[deployment.host]]
name = "robot-{robot}"
agents = [[{robot}]]
actuates = [{robot}]
localizes = [{robot}]
driver = {driver(firmware, port + robot, driver_more, vehicle)}
source = {source(port + robot, source_more)}
"""
    carried = ["reading", "latent", "heartbeat", "mode", "stop"]
    text += f"""
[[deployment.host]]
name = "pc"
state_server = true

[[deployment.link]]
name = "air"
carries = {json.dumps(carried)}
"""
    path = Path(folder) / "team.toml"
    path.write_text(text)
    return path


def peer(port, log, firmware="px4", *more):
    command = [sys.executable, HERE / "autopilot.py", str(port), "--firmware", firmware, "--log", str(log), *more]
    return subprocess.Popen(command, stdin=subprocess.PIPE, text=True)


def tell(process, line):
    process.stdin.write(line + "\n")
    process.stdin.flush()


def logged(path):
    lines = Path(path).read_text().splitlines() if Path(path).exists() else []
    return [json.loads(line) for line in lines if line.endswith("}")]


def wait(what, seconds=30.0):
    """Waits until `what()` is true, and returns that."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        found = what()
        if found:
            return found
        time.sleep(0.02)
    return None


class Team:
    """Two robots with their hosts, and the host of the state server."""

    def __init__(self, program, firmware, port, key=None, vehicle="rover", peers=(), hosts=(0, 1, "pc"), **settings):
        self.folder = tempfile.TemporaryDirectory(prefix="mavlink-")
        self.program, self.port, self.firmware = program, port, firmware
        if key:
            keyfile = Path(self.folder.name) / "link.key"
            keyfile.write_text(key + "\n")
            keyfile.chmod(0o600)
            more = f', signing_key_file = "{keyfile}"'
            settings = {"driver_more": settings.get("driver_more", "") + more, "source_more": more, **settings}
        self.file = team_file(self.folder.name, firmware, port, vehicle=vehicle, **settings)
        self.logs = [Path(self.folder.name) / f"robot-{robot}.log" for robot in (0, 1)]
        starts = [("-1.2", "0", "0"), ("1.2", "0", "3.14159")]
        keyed = ["--key", key] if key else []
        self.peers = [
            peer(port + robot, self.logs[robot], firmware, "--vehicle", vehicle, "--at", *starts[robot][:2],
                 "--heading", starts[robot][2], *keyed, *peers)
            for robot in (0, 1)
        ]
        self.hosts = {which: self.host(which) for which in hosts}

    def host(self, which, *more):
        chosen = ["--host", "pc"] if which == "pc" else ["--robot", str(which)]
        out = open(Path(self.folder.name) / f"{which}.out", "w")
        log = open(Path(self.folder.name) / f"{which}.err", "w")
        return subprocess.Popen([self.program, "host", str(self.file), *chosen, "--json", *more], stdout=out, stderr=log)

    def said(self, which):
        return (Path(self.folder.name) / f"{which}.err").read_text()

    def events(self, which):
        lines = (Path(self.folder.name) / f"{which}.out").read_text().splitlines()
        return [json.loads(line) for line in lines if line.startswith("{") and line.endswith("}")]

    def moves(self, robot=0, since=0.0):
        """Whether a setpoint has moved the robot since a time."""
        return any(any(abs(v) > 0.01 for v in entry["setpoint"] if v is not None)
                   for entry in logged(self.logs[robot]) if "setpoint" in entry and entry["at"] > since)

    def end(self):
        for process in [*self.hosts.values(), *self.peers]:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            process.wait()
        self.folder.cleanup()
