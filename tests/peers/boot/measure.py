#!/usr/bin/env python3
"""How soon a host is in its team after its network interface is fit, and back after its address or interface has changed.

    measure.py MURMURATE [TIMES [LINK...]]

Three machines as network namespaces on one bridge, and a team of two robots and a PC on them. Every state is made TIMES
times (20). The time begins when the kernel shows the interface up, with a carrier and a usable address; it ends when the
state server on the PC hears robot 0 again, and, if its address is another one on a unicast link, both others send there. An
outage of which the state server notices nothing is shorter than a second. Exit code 1 if one took more than two seconds.
Needs root and `ip`. LINK is multicast, unicast (both by default) or zenoh, which needs the package eclipse-zenoh, and a
program with the feature `zenoh`.
"""

import itertools
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import threading
import time

LIMIT_S = 2.0
# What an outage counts as of which the state server notices nothing [s].
UNNOTICED_S = 1.0
LOG = "warn,zenoh=error,murmurate::actors::presence=info,murmurate::net::transport::udp=debug"
TAG = f"mb{os.getpid()}"
PREFIX = "10.78.0."
NETWORK = pathlib.Path(__file__).parents[2] / "cases/robots/lib_network.sh"
HOSTS = ["robot-0", "robot-1", "pc"]
PEERS = "transport = 'unicast'\n[link.infra.peers]\n" + "".join(
    f"{name} = '{PREFIX}1{number}:7700'\n" for number, name in enumerate(HOSTS)
)
LINKS = {
    "multicast": "interface = 'w0'\n",
    "multicast, auto": "interface = 'auto'\n",
    "multicast IPv6": "interface = 'w0'\ngroup = '[ff02::4d75]:7700'\n",
    "unicast": "interface = 'w0'\n" + PEERS,
    "zenoh": f"transport = 'zenoh'\nconnect = 'udp/{PREFIX}13:7447'\n",
}


def net(*words, check=True, **more):
    """Runs a function of the cases' shell file, such as: net("interface", "0")."""
    subprocess.run(["bash", NETWORK, TAG, *words], check=check, **more)


def ip0(*words, check=True):
    subprocess.run(["ip", "-n", f"{TAG}-0", *words], check=check, stderr=None if check else subprocess.DEVNULL)


def space(machine):
    return ["ip", "netns", "exec", f"{TAG}-{machine}"]


def present(machine=0, last=None):
    """Makes the interface of a machine, with an address, and up."""
    net("interface", str(machine))
    net("address", str(machine), f"{PREFIX}{last or 10 + machine}/24")
    net("up", str(machine))


def fit(family):
    """Waits until machine 0 has a usable address on w0; returns the time."""
    while True:
        shown = subprocess.run(["ip", "-n", f"{TAG}-0", "-j", "addr", "show", "dev", "w0"], capture_output=True, text=True)
        link = json.loads(shown.stdout or "[]")
        usable = [at for one in link for at in one.get("addr_info", []) if at["family"] == family and not at.get("tentative")]
        if link and link[0].get("operstate") == "UP" and usable:
            return time.monotonic()
        time.sleep(0.01)


class Host:
    """A host's process, whose log lines and events are kept with their times."""

    def __init__(self, program, machine, name, folder):
        environment = dict(os.environ, MURMURATE_LOG=LOG)
        command = [*space(machine), program, "host", "team.toml", "--host", name, "--json"]
        self.child = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.said, self.more = [], threading.Condition()
        for pipe in (self.child.stdout, self.child.stderr):
            threading.Thread(target=self.read, args=(pipe,), daemon=True).start()

    def read(self, pipe):
        for line in pipe:
            if '"event":"counted"' not in line:
                with self.more:
                    self.said.append((time.monotonic(), line))
                    self.more.notify()

    def until(self, text, limit_s):
        """Returns the time at which the first line with `text` came; None after the limit."""
        first = lambda: next((at for at, line in self.said if text in line), None)
        with self.more:
            return self.more.wait_for(first, limit_s)

    def last(self):
        with self.more:
            return [line for _, line in self.said[-20:]]

    def forget(self):
        with self.more:
            self.said.clear()

    def end(self):
        self.child.kill()
        self.child.wait()


class Team:
    def __init__(self, program, link, folder):
        self.program, self.folder, self.router = program, folder, None
        net("team", input=link, text=True, env=dict(os.environ, CASE_WORK=str(folder), murmurate=program, episodes="100000"))
        if "zenoh" in link:
            router = pathlib.Path(__file__).parents[1] / "zenoh/router.py"
            command = [*space(3), sys.executable, str(router), f"udp/{PREFIX}13:7447"]
            self.router = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            self.router.stdout.readline()
        self.pc, self.other = (Host(program, number, HOSTS[number], folder) for number in (2, 1))
        self.robot = None

    def start(self):
        self.robot = Host(self.program, 0, "robot-0", self.folder)

    def heard(self, limit_s):
        return self.pc.until("heartbeats of robot 0 arrive", limit_s)

    def found(self):
        """Returns when the last of both others had found robot 0 at its new address."""
        all_s = [one.until("host 0 is at another address", 20) for one in (self.pc, self.other)]
        assert all(all_s), ("robot 0 is not found at its address", all_s, self.robot.last())
        return max(all_s)

    def forget(self):
        for one in (self.pc, self.other):
            one.forget()

    def end(self):
        for one in (self.pc, self.other, self.robot):
            if one:
                one.end()
        if self.router:
            self.router.kill()
            self.router.wait()


def away():
    ip0("link", "del", "w0", check=False)


def boots(team, before, after, family, moved=False):
    """Starts robot 0 in the state `before`, makes its interface fit by `after`, and returns how long it took [s]."""
    away()
    before()
    # The state server has to miss the robot first.
    time.sleep(1.5)
    team.forget()
    team.start()
    if after:
        # A host on Zenoh need not wait for its session.
        waits = team.robot.until("going on without" if team.router else "waiting up to", 20)
        assert waits, ("it does not wait", team.robot.last())
        time.sleep(0.7)
        after()
    at = fit(family)
    found = team.found() if moved else at
    heard = team.heard(20)
    team.robot.end()
    assert heard, ("robot 0 was not heard", team.robot.last(), team.pc.last())
    return max(heard, found) - at


def changes(team, change, moved=False):
    """Applies a change to the interface of robot 0, which is in its team; returns how long it took [s]."""
    team.forget()
    team.robot.forget()
    change()
    at = fit("inet")
    found = team.found() if moved else at
    heard = team.heard(4)
    if heard is None:
        lines = "".join(team.robot.last())
        assert team.robot.child.poll() is None and "open again" in lines, ("robot 0 is mute", lines)
    # Whoever is measured next is to be in the team.
    time.sleep(1.2)
    return max(heard - at if heard else UNNOTICED_S, found - at)


def flip(numbers):
    """Gives the interface another address in place of the one it has."""
    new, _ = numbers
    numbers.reverse()
    ip0("addr", "flush", "dev", "w0")
    ip0("addr", "add", f"{PREFIX}{new}/24", "dev", "w0")


def lease(numbers):
    """Takes the address away, and gives another one two seconds later."""
    new, _ = numbers
    numbers.reverse()
    ip0("addr", "flush", "dev", "w0")
    time.sleep(2)
    ip0("addr", "add", f"{PREFIX}{new}/24", "dev", "w0")


def replug(last):
    away()
    time.sleep(3)
    present(last=last)


def main():
    program, times = os.path.realpath(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 20
    links = sys.argv[3:] or ["multicast", "unicast"]
    add = lambda: net("address", "0", f"{PREFIX}10/24")
    raised = lambda: net("up", "0")
    # Never the same twice in a row.
    places = itertools.cycle(["55", "66"])
    elsewhere = lambda: net("address", "0", f"{PREFIX}{next(places)}/24")
    nothing = lambda: None
    bare = lambda: (net("interface", "0"), raised())
    down = lambda: (net("interface", "0"), add())
    boot = [
        ("multicast", "down", down, raised, "inet"),
        ("multicast", "not there yet", nothing, present, "inet"),
        ("multicast", "up, no IPv4 address yet", bare, add, "inet"),
        ("multicast, auto", "down", down, raised, "inet"),
        ("multicast IPv6", "tentative address", bare, None, "inet6"),
        ("unicast", "not there yet", nothing, present, "inet"),
        ("unicast", "up, no IPv4 address yet", bare, add, "inet"),
        ("unicast", "up, then another address than in the file", bare, elsewhere, "inet"),
        ("zenoh", "not there yet", nothing, present, "inet"),
    ]
    boot = [state for state in boot if state[0].startswith(tuple(links))]
    missed = False

    def row(link, state, all_s):
        nonlocal missed
        missed |= max(all_s) > LIMIT_S
        middle, most = (
            "< 1" if one_s == UNNOTICED_S else f"{one_s:.2f}" for one_s in (statistics.median(all_s), max(all_s))
        )
        print(f"| {link} | {state} | {len(all_s)} | {middle} | {most} |", flush=True)

    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        try:
            net("machines", "4")
            for machine in range(4):
                present(machine)
            print("| link | state | times | median [s] | most [s] |\n|---|---|---|---|---|")
            for link, state, before, after, family in boot:
                team = Team(program, LINKS[link], folder)
                try:
                    moved = after is elsewhere
                    row(link, f"boot: {state}", [boots(team, before, after, family, moved) for _ in range(times)])
                finally:
                    team.end()
            for link in links:
                away()
                present()
                fit("inet")
                team = Team(program, LINKS[link], folder)
                try:
                    team.start()
                    assert team.heard(30), team.robot.last()
                    time.sleep(1.5)
                    numbers = ["55", "10"]
                    moved = link == "unicast"
                    all_s = [changes(team, lambda: flip(numbers), moved) for _ in range(times)]
                    row(link, "another address at once", all_s)
                    all_s = [changes(team, lambda: lease(numbers), moved) for _ in range(times)]
                    row(link, "no address for 2 s, then another", all_s)
                    row(link, "made again after 3 s", [changes(team, lambda: replug(numbers[1])) for _ in range(times)])
                finally:
                    team.end()
        finally:
            net("spaces_end")
    sys.exit(1 if missed else 0)


main()
