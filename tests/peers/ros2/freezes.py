"""What five ROS 2 robots apply after something has died: the time until robot 0 stands, at random moments.

    python3 freezes.py MURMURATE CASE [MOMENTS]

CASE: kill, halt (the host of robot 0, with its agent), freeze, lost, stamp (a tracker at 100 Hz), odometry (at 10 Hz),
gps (a real gpsd at 10 Hz is halted, of a rover without odometry), fused (the same, with odometry that goes on), scan (the
scanner of a robot whose policy takes its LaserScan at 20 Hz says nothing), scans (it contradicts itself). Prints one line
of JSON: the moments, the median and the worst time [ms]. Exit code 1 if a bar is missed.
"""

import json
import os
import pathlib
import random
import re
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[2]
ROVER = HERE.parent / "gps_rover.py"
# Of GPS: own_state_s and 100 ms; with odometry, for alone_s longer. Of a scan: the 120 ms of the policy, a step of 50 ms, a
# step of the robot of 20 ms, and 30 ms for DDS both ways and processes that wait for a processor.
BARS_MS = {"kill": 250, "halt": 250, "freeze": 250, "lost": 250, "stamp": 250, "odometry": 400, "gps": 350, "fused": 500}
BARS_MS |= {"scan": 220, "scans": 220}
SCANNED = ("scan", "scans")
GPSD_PORT = 29_473
STARTS = ["/r0=-1.2,-2", "/r1=-0.6,-2", "/r2=0,-2", "/r3=0.6,-2", "/r4=1.2,-2"]


def team_file(case, folder):
    """The team file of the tutorial, with the tracker or the slow odometry of a case, and episodes without end."""
    text = (ROOT / "teams" / "ros2.toml").read_text().replace("episodes = 8", "episodes = 100000")
    if case in ("freeze", "lost", "stamp"):
        text = text.replace('source = { name = "odometry" }\n', "")
        lines = [line for line in text.splitlines() if not line.startswith("localizes")]
        text = "\n".join(lines).replace(
            "state_server = true",
            'localizes = [0, 1, 2, 3, 4]\nstate_server = true\nsource = { name = "ros2", interface = "lo" }',
        )
    if case == "odometry":
        text = text.replace("[deployment.body]", "[deployment.body]\nheading_age_s = 0.25")
        text = text.replace("[link.air]", "[safety]\nown_state_s = 0.25\n\n[link.air]")
    if case in ("gps", "fused"):
        gpsd = f'name = "gpsd", address = "127.0.0.1:{GPSD_PORT}", heading = "none", origin_latitude_deg = 52.2053'
        gpsd += ", origin_longitude_deg = 0.1218" + (", fuse = { heading_rad = 0.0, alone_s = 0.3 }" * (case == "fused"))
        text = text.replace('source = { name = "odometry" }', "source = { " + gpsd + " }", 1)
    if case == "gps":
        command = json.dumps([sys.executable, str(ROVER), "drive", str(GPSD_PORT)])
        driver = f'driver = {{ name = "program", command = {command}, speed_m_s = 1.5 }}'
        text = re.sub(r'driver = \{ name = "ros2", namespace = "/r0".*', lambda _: driver, text)
        text = text.replace("[link.air]", "[safety]\nown_state_s = 0.25\n\n[link.air]")
    if case in SCANNED:
        policy = ROOT / "tests" / "onnx" / "data" / "lidar.policy.toml"
        text = text.replace('scenario = "passage"', f'scenario = "swap"\npolicy = "{policy}"')
        text += '\n[senses.lidar]\nkind = "ros2"\ninterface = "lo"\nrays = 32\nrange_m = 2.0\n'
    path = folder / "team.toml"
    path.write_text(text)
    return path


class Phases(threading.Thread):
    """Phase of the team, from the instructions of its state server (docs/wire.md). Robots reset without their scans."""

    RUNNING, MODE = 3, 4
    newest, other = None, -1.0  # The newest phase, and when another one than `RUNNING` was told last [s].

    def run(self):
        heard = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        heard.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        heard.bind(("239.255.77.30", 7730))
        joined = socket.inet_aton("239.255.77.30") + socket.inet_aton("127.0.0.1")
        heard.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)
        while True:
            datagram = heard.recv(2048)
            at = 14
            while at + 3 <= len(datagram):
                length = int.from_bytes(datagram[at + 1 : at + 3], "little")
                if datagram[at] == self.MODE:
                    self.newest = self.phase(datagram[at + 3 : at + 3 + length])
                    self.other = self.other if self.newest == self.RUNNING else time.monotonic()
                at += 3 + length

    @staticmethod
    def phase(body):
        """The third field of a MessagePack array, after a pair of integers and an integer."""
        at = 2
        for field in range(4):
            wide = {0xCC: 1, 0xCD: 2, 0xCE: 4, 0xCF: 8}.get(body[at], 0)
            value = int.from_bytes(body[at + 1 : at + 1 + wide], "big") if wide else body[at]
            at += 1 + wide
        return value


def main():
    program, case = sys.argv[1], sys.argv[2]
    moments = int(sys.argv[3]) if len(sys.argv) > 3 else 20
    folder = pathlib.Path(tempfile.mkdtemp(prefix="freezes-"))
    team = team_file(case, folder)
    log = folder / "applied"
    options = ["--tracker-hz", "100"] if case in ("freeze", "lost", "stamp") else []
    options += ["--odom-hz", "10"] if case == "odometry" else []
    options += ["--scan-hz", "20"] if case in SCANNED else []
    options += ["--fault", case] if case in ("freeze", "lost", "stamp", "odometry", *SCANNED) else []
    options += ["--receiver", str(GPSD_PORT)] if case == "fused" else []
    # The rover's log is that of robot 0.
    robots = [sys.executable, HERE / "robots.py", *options]
    robots += ["--log", folder / "others", *STARTS[1:]] if case == "gps" else ["--log", log, *STARTS]
    at_fault = robots = subprocess.Popen(robots)
    if case in ("gps", "fused"):
        rover = ["rover", "--log", f"{log}.0", "--", "-1.2", "-2"] if case == "gps" else ["receiver"]
        at_fault = subprocess.Popen([sys.executable, ROVER, *rover[:1], "--port", str(GPSD_PORT), *rover[1:]])

    phases = Phases(daemon=True)
    phases.start()

    def in_episode(since):
        return case not in SCANNED or (phases.newest == Phases.RUNNING and phases.other < since)

    def start(name):
        return subprocess.Popen([program, "host", team, "--host", name], stdout=subprocess.DEVNULL, stderr=errors)

    def speeds(since):
        with open(f"{log}.0") as lines:
            lines.seek(max(0, os.path.getsize(f"{log}.0") - 4000))
            lines.readline()
            for line in lines:
                fields = line.split()
                if len(fields) == 2 and float(fields[0]) >= since:
                    yield float(fields[0]), float(fields[1])

    errors = open(folder / "hosts.log", "w")
    hosts = {}
    times, applied_again = [], 0
    try:
        time.sleep(3)
        hosts = {name: start(name) for name in ["pc", *(f"robot-{robot}" for robot in range(5))]}
        began = time.monotonic()
        while len(times) < moments:
            if time.monotonic() - began > 60 + 30 * moments:
                sys.exit(f"the robots do not move: see {folder}")
            recent = [speed for _, speed in speeds(time.monotonic() - 0.3)]
            if len(recent) < 10 or min(recent) < 0.1 or not in_episode(time.monotonic() - 0.1):
                time.sleep(0.02)
                continue
            time.sleep(random.random() * 0.1)
            at = time.monotonic()
            {
                "kill": lambda: hosts["robot-0"].kill(),
                "halt": lambda: hosts["robot-0"].send_signal(signal.SIGSTOP),
            }.get(case, lambda: at_fault.send_signal(signal.SIGUSR1))()
            time.sleep(1.0)
            after = list(speeds(at))
            moving = [when for when, speed in after if speed > 0]
            if in_episode(at):
                times.append((moving[-1] - at + 0.02) * 1e3 if moving else 0.0)
            if case == "kill":
                hosts["robot-0"].wait()
                hosts["robot-0"] = start("robot-0")
            elif case == "halt":
                hosts["robot-0"].send_signal(signal.SIGCONT)
            else:
                at_fault.send_signal(signal.SIGUSR2)
            time.sleep(1.0)
    finally:
        for host in hosts.values():
            host.terminate()
        at_fault.terminate()
        robots.kill()
    worst = max(times)
    result = {"case": case, "moments": moments, "median_ms": statistics.median(times), "worst_ms": worst}
    print(json.dumps({key: round(value, 1) if isinstance(value, float) else value for key, value in result.items()}))
    sys.exit(0 if worst <= BARS_MS[case] else 1)


if __name__ == "__main__":
    main()
