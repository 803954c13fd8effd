"""Teams of fake Crazyflies under a fake tracker: team files, processes, and what the robots have logged.

A team has a host for each robot, and `pc` with the tracker and the state server. `FAKES` is the folder of the examples
`fake_crazyflie` and `natnet_server`."""

import contextlib
import json
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from bars import missed, program_of  # noqa: E402, F401

PORT = 19850
# A robot is known by the height of its setpoints.
HEIGHTS = [0.4, 0.5, 0.6, 0.7, 0.8, 0.9]


def team_file(folder, robots=6, episodes=2, setpoint="hover", body="", together=False):
    """Writes a team file of robots that change places; all are of one host if they are `together`."""
    text = f"""team = 54
scenario = "swap"
policy = "orca"
episodes = {episodes}
wall_radius_m = 0.08

[link.air]
interface = "lo"
group = "239.255.92.1:7954"

[deployment]
mode = "crazyflies"
robots = {robots}
placement = "drive"
stepping = "seeded"
scale = 0.5
hull_m = 0.1

[deployment.body]
height_m = {HEIGHTS[0]}
speed_m_s = 0.5
{body}
"""
    for robot in range(robots):
        text += f"\n[deployment.bodies.{robot}]\nheight_m = {HEIGHTS[robot]}\n"
    source = 'source = { name = "natnet", server = "127.0.0.1", interface = "lo" }'
    each = list(range(robots))
    if together:
        text += f'\n[[deployment.host]]\nname = "pc"\nagents = {[[robot] for robot in each]}\nactuates = {each}\n'
        text += f'localizes = {each}\nstate_server = true\n{source}\n\n[deployment.host.driver]\nname = "crazyflie"\n'
        text += f'setpoint = "{setpoint}"\n'
        text += "".join(f'robot.{robot}.uri = "udp://127.0.0.1:{PORT + robot}"\n' for robot in each)
    else:
        for robot in each:
            text += f'\n[[deployment.host]]\nname = "robot-{robot}"\nagents = [[{robot}]]\nactuates = [{robot}]\ndriver = '
            text += f'{{ name = "crazyflie", uri = "udp://127.0.0.1:{PORT + robot}", setpoint = "{setpoint}" }}\n'
        text += f'\n[[deployment.host]]\nname = "pc"\nlocalizes = {each}\nstate_server = true\n{source}\n'
        text += '\n[[deployment.link]]\nname = "air"\ncarries = ["reading", "latent", "heartbeat", "mode", "stop"]\n'
    path = Path(folder) / "team.toml"
    path.write_text(text)
    return path


def wait(what, seconds=30.0):
    """Waits until `what()` is true, and returns that."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        found = what()
        if found:
            return found
        time.sleep(0.02)
    return None


class Fakes:
    """Fake robots, and the tracker that sees them. What the robots log is in `lines`, by robot."""

    def __init__(self, folder, count=6):
        server = [Path(folder) / "natnet_server", "4.1", "100000", "multicast", "127.0.0.1", "lines"]
        self.tracker = subprocess.Popen(server, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
        fakes = [Path(folder) / "fake_crazyflie", str(count), str(PORT)]
        self.robots = subprocess.Popen(fakes, stdin=subprocess.PIPE, stdout=self.tracker.stdin, stderr=subprocess.PIPE, text=True)
        self.lines, self.now = [[] for _ in range(count)], [{} for _ in range(count)]
        threading.Thread(target=self.read, daemon=True).start()
        if not wait(lambda: all(self.now), 10.0):
            sys.exit("the fake robots do not start: are their ports free?")

    def read(self):
        for line in self.robots.stderr:
            try:
                line = json.loads(line)
            except json.JSONDecodeError:
                print(line, end="", file=sys.stderr)
                continue
            if "motors" in line:
                self.now[line["robot"]] = line
            else:
                self.lines[line["robot"]].append(line)

    def tell(self, line):
        self.robots.stdin.write(line + "\n")
        self.robots.stdin.flush()

    def all(self, robot, key, since=0.0):
        return [line for line in list(self.lines[robot]) if key in line and line["at"] >= since]

    def setpoints(self, robot, since=0.0):
        return [line for line in list(self.lines[robot]) if ("hover" in line or "world" in line) and line["at"] >= since]

    def flown(self, robot, who, since=0.0):
        """Returns when somebody began to fly the robot, or None."""
        found = [line["at"] for line in self.all(robot, "flown", since) if line["flown"] == who]
        return found[0] if found else None

    def fly(self):
        """Whether all robots are at their heights."""
        return all(abs(now["z"] - HEIGHTS[robot]) < 0.1 for robot, now in enumerate(self.now))

    def grounded(self):
        return all(now["z"] < 0.05 and not now["motors"] for now in self.now)

    def end(self):
        for process in (self.robots, self.tracker):
            process.kill()
            process.wait()


class Team:
    """Fake robots and the hosts of their team."""

    def __init__(self, program, folder, robots=6, **settings):
        self.place = tempfile.TemporaryDirectory(prefix="crazyflies-")
        self.program, self.robots = program, robots
        self.file = team_file(self.place.name, robots, **settings)
        self.fakes = Fakes(folder, robots)
        self.hosts = {}

    def start(self, *names):
        for name in names:
            out, log = (open(Path(self.place.name) / f"{name}.{end}", "a") for end in ("out", "err"))
            command = [self.program, "host", str(self.file), "--host", name, "--json"]
            self.hosts[name] = subprocess.Popen(command, stdout=out, stderr=log)

    def start_all(self):
        self.start(*[f"robot-{robot}" for robot in range(self.robots)], "pc")

    def said(self, name):
        return (Path(self.place.name) / f"{name}.err").read_text()

    def events(self, name="pc"):
        lines = (Path(self.place.name) / f"{name}.out").read_text().splitlines()
        return [json.loads(line) for line in lines if line.startswith("{") and line.endswith("}")]

    def run(self, *command, seconds=300.0):
        """Runs the program to its end; returns its exit code, output and log."""
        done = subprocess.run([self.program, *command], capture_output=True, text=True, timeout=seconds)
        return done.returncode, done.stdout, done.stderr

    def moves(self, robot, since=0.0):
        """Whether a setpoint has moved the robot since a time."""
        return any(max(map(abs, (line.get("hover") or line["world"])[:2])) > 0.02 for line in self.fakes.setpoints(robot, since))

    def signal(self, name, which):
        self.hosts[name].send_signal(which)
        if which == signal.SIGKILL:
            self.hosts.pop(name).wait()

    def end(self):
        for process in self.hosts.values():
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            process.wait()
        self.fakes.end()
        self.place.cleanup()
