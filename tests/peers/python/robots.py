"""Five robots whose policy is a class in Python, each with a process of its own: how long its steps take, and what happens
when these processes are killed, halted, or take too much memory.

    python robots.py PROGRAM [MINUTES [MOMENTS]]

PROGRAM is `murmurate`; this interpreter has the package `murmurate`, or PYTHONPATH names it. For MINUTES (10) nothing is
done to the processes; then a process is killed, halted for 3 s, or made to take memory, MOMENTS (20) times each. Exits with
1 if a bar is missed.
"""

import collections
import datetime
import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import time

ROBOTS = 5
#: Longest time for a step [us], the share of steps that keep it, and the longest time until a robot stands [s].
LONGEST_US, SHARE, STANDS_S = 10_000, 0.999, 0.25

MODULE = """
import os
import murmurate
import numpy as np

class Drive(murmurate.Policy):
    def __init__(self, contract):
        super().__init__(contract)
        self.order = os.path.join(os.path.dirname(__file__), f"eat-{os.getpid()}")
        self.mark = os.path.join(os.path.dirname(__file__), f"step-{os.getpid()}")
        open(self.mark, "w").close()
        self.weights = np.random.default_rng(1).normal(size=(64, 64)).astype(np.float32)

    def step(self, inputs):
        os.utime(self.mark)
        if os.path.exists(self.order):
            os.remove(self.order)
            eaten = []
            while True:
                eaten.append(np.ones(32 << 20, np.uint8))
        hidden = np.tanh(np.tile(inputs.observation["goal"], (1, 32)) @ self.weights)
        state = 0.9 * inputs.state + 0.1 * hidden[:, :8]
        return murmurate.Outputs(action=np.clip(inputs.observation["goal"], -1, 1), message=hidden[:, :32], state=state)
"""
CONTRACT = """
format = 3
name = "drive"
python = "drive:Drive"
memory_mb = 1024
rate_hz = 20
radius_m = 2.0
hold_s = 0.2

[observation.goal]
source = "goal-minus-position"
shape = [2]
unit = "m"
frame = "world"

[message]
floats = 32

[state]
floats = 8
after_gap_s = 0.5

[action]
kind = "velocity"
unit = "m/s"
frame = "world"
limit = 1.0
"""
TEAM = f"""
team = 97
mode = "onboard-infra"
scenario = "swap"
robots = {ROBOTS}
episodes = 100000
policy = "drive.policy.toml"

[link.infra]
interface = "lo"

[link.wires]
interface = "lo"
"""


class Hosts:
    """Processes of the team's hosts, one a robot and one for the world, and what they log."""

    def __init__(self, program, folder):
        self.folder = folder
        environment = {**os.environ, "PYTHON_OF_MURMURATE": sys.executable, "MURMURATE_LOG": "murmurate=debug"}
        self.logs = {}
        self.processes = {}
        for name in [f"robot-{robot}" for robot in range(ROBOTS)] + ["world"]:
            log = self.logs[name] = folder / f"{name}.log"
            words = [program, "host", "team.toml", "--host", name]
            self.processes[name] = subprocess.Popen(
                words, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=log.open("w")
            )
        self.read = dict.fromkeys(self.logs, 0)

    def lines(self, name):
        """Returns the new lines of a host's log, without those that are not finished."""
        with self.logs[name].open("rb") as log:
            log.seek(self.read[name])
            text = log.read()
        whole = text[: text.rfind(b"\n") + 1]
        self.read[name] += len(whole)
        return re.sub(r"\x1b\[[0-9;]*m", "", whole.decode(errors="replace")).splitlines()

    def serving(self, name):
        """Returns the process that computes the policy of a robot's host; None if there is none now."""
        host = self.processes[name].pid
        for stat in pathlib.Path("/proc").glob("[0-9]*/stat"):
            try:
                parent = int(stat.read_text().rsplit(") ", 1)[1].split()[1])
                command = (stat.parent / "cmdline").read_bytes()
            except (OSError, IndexError):
                continue
            if parent == host and b"murmurate.serve" in command:
                return int(stat.parent.name)
        return None

    def end(self):
        for process in self.processes.values():
            process.send_signal(signal.SIGINT)
        for process in self.processes.values():
            process.wait(30)


def stamp(line):
    """Returns the time of a line of the log [s since 1970]; None if it has none."""
    found = re.search(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d+Z", line)
    return found and datetime.datetime.fromisoformat(found[0].replace("Z", "+00:00")).timestamp()


def answers(lines):
    return [int(found[1]) for line in lines if (found := re.search(r"has answered.*\bus=(\d+)", line))]


def wait_for(hosts, name, pattern, since, longest_s):
    """Waits for a line of a host's log that has `pattern` and is not older than `since`, and returns its time."""
    until = time.time() + longest_s
    while time.time() < until:
        for line in hosts.lines(name):
            if re.search(pattern, line) and (stamp(line) or 0) >= since - 0.002:
                return stamp(line)
        time.sleep(0.02)
    return None


STANDS = "has not answered in time|counts as none"


def undisturbed(hosts, minutes):
    """Lets the team drive, and returns how long steps took [us]."""
    took, until = [], time.time() + 60 * minutes
    while time.time() < until:
        time.sleep(1)
        for name in list(hosts.logs)[:ROBOTS]:
            took += answers(hosts.lines(name))
    return sorted(took)


def stepped(hosts, name):
    """Returns when the policy of a robot has been asked last [s since 1970]; 0 if it has no process."""
    pid = hosts.serving(name)
    try:
        return (hosts.folder / f"step-{pid}").stat().st_mtime if pid else 0
    except OSError:
        return 0


def disturb(hosts, how, moment):
    """Does something to the process of one robot in an episode; returns how long until it stood and until it was answered
    again [s], how many steps of others were late, and whether the episode went on meanwhile."""
    name = f"robot-{moment % ROBOTS}"
    others = [other for other in list(hosts.logs)[:ROBOTS] if other != name]
    # In a reset the policy is not asked.
    while stepped(hosts, name) < time.time() - 0.06:
        time.sleep(0.01)
    time.sleep(0.37 * (moment % 3) / 10)
    pid = hosts.serving(name)
    for other in list(hosts.logs):
        hosts.lines(other)
    began = time.time()
    if how == "killed":
        os.kill(pid, signal.SIGKILL)
    elif how == "halted":
        os.kill(pid, signal.SIGSTOP)
    else:
        (hosts.folder / f"eat-{pid}").touch()
    time.sleep(STANDS_S + 0.05)
    runs = max(stepped(hosts, other) for other in others) > began + STANDS_S - 0.06
    stood = wait_for(hosts, name, STANDS, began, 10)
    if how == "halted":
        time.sleep(3)
        os.kill(pid, signal.SIGCONT)
    goes_on = wait_for(hosts, name, "has answered", stood or began, 30)
    late = {other: sum(bool(re.search(STANDS, line)) for line in hosts.lines(other)) for other in others}
    return stood and stood - began, goes_on and goes_on - began, sum(late.values()), runs


def main():
    program = os.path.abspath(sys.argv[1])
    minutes = float(sys.argv[2]) if len(sys.argv) > 2 else 10
    moments = int(sys.argv[3]) if len(sys.argv) > 3 else 20
    failed = []
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / "drive.py").write_text(MODULE)
        (folder / "drive.policy.toml").write_text(CONTRACT)
        (folder / "team.toml").write_text(TEAM)
        hosts = Hosts(program, folder)
        try:
            time.sleep(15)
            for host in hosts.logs:
                hosts.lines(host)
            took = undisturbed(hosts, minutes)
            share = sum(us <= LONGEST_US for us in took) / max(len(took), 1)
            place = lambda part: took[min(int(part * len(took)), len(took) - 1)] if took else None
            facts = {"steps": len(took), "within_10_ms": round(share, 6), "median_us": place(0.5)}
            facts |= {"p99_us": place(0.99), "p999_us": place(0.999), "worst_us": place(1.0)}
            print(json.dumps({"undisturbed": facts}), flush=True)
            if share < SHARE or len(took) < 0.5 * minutes * 60 * 20 * ROBOTS:
                failed.append("undisturbed")
            for how in ["killed", "halted", "memory"]:
                stood, again, others = [], [], 0
                moment, ended = 0, 0
                while len(stood) < moments and ended <= 3 * moments:
                    stands_s, goes_on_s, late, runs = disturb(hosts, how, moment)
                    moment += 1
                    time.sleep(1)
                    if not runs:
                        # The episode has ended before the robot had to stand.
                        ended += 1
                        continue
                    stood.append(stands_s)
                    again.append(goes_on_s)
                    others += late
                missing = collections.Counter(["stood" for at in stood if at is None] + ["again" for at in again if at is None])
                known = [at for at in stood if at is not None]
                facts = {"moments": moments, "left_out": ended, "stands_worst_s": round(max(known, default=-1), 3), "missing": dict(missing)}
                facts["again_worst_s"] = round(max((at for at in again if at is not None), default=-1), 3)
                facts["late_steps_of_others"] = others
                print(json.dumps({how: facts}), flush=True)
                if missing or len(stood) < moments or max(known, default=9) > STANDS_S:
                    failed.append(how)
            alive = [host for host, process in hosts.processes.items() if process.poll() is None]
            print(json.dumps({"hosts_alive": len(alive), "failed": failed}), flush=True)
            if len(alive) != ROBOTS + 1:
                failed.append("hosts")
        finally:
            hosts.end()
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
