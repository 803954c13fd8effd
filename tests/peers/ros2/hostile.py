"""Forged RTPS packets at the DDS processes of a host that drives a robot: what the host and the robot notice of them.

    python3 hostile.py MURMURATE [PACKETS]

Mutated copies of the team's own packets go to every port of the DDS processes of robot 0's host (active and spare), about
3000 a second. Prints one line of JSON: late ticks of the host, its memory, that of its largest DDS process, the longest time
for which the robot stood, and the time from the last packet until it drives. Exit code 1 if a bar is missed. Root, apt:
iproute2 (ss).
"""

import json
import os
import pathlib
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[2]
STARTS = ["/r0=-1.2,-2", "/r1=-0.6,-2", "/r2=0,-2", "/r3=0.6,-2", "/r4=1.2,-2"]
# All memory of a process, what it has allocated, and pages of its program file that it has run or read.
FIELDS = ["VmRSS:", "RssAnon:", "RssFile:"]
WORDS = [b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0", b"\1\0\0\0", b"\0\0\0\x80"]


def packets(seconds):
    """Different RTPS packets that are on loopback within this time."""
    raw = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(0x0800))
    raw.bind(("lo", 0))
    raw.settimeout(0.5)
    seen, end = set(), time.monotonic() + seconds
    while time.monotonic() < end and len(seen) < 400:
        try:
            packet = raw.recv(65535)
        except socket.timeout:
            continue
        payload = packet[(packet[0] & 15) * 4 + 8 :]
        if packet[9] == socket.IPPROTO_UDP and payload[:4] == b"RTPS":
            seen.add(payload)
    return sorted(seen)


def mutated(packet):
    """A copy of a packet that is cut, has bits inverted, or has a length replaced by an extreme one."""
    copy, kind = bytearray(packet), random.random()
    if kind < 0.25:
        return copy[: random.randrange(4, len(copy))]
    if kind < 0.6:
        for _ in range(random.randrange(1, 6)):
            copy[random.randrange(4, len(copy))] ^= 1 << random.randrange(8)
        return copy
    word = random.choice(WORDS) if kind < 0.8 else random.choice(WORDS)[:2]
    at = random.randrange(20, max(21, len(copy) - len(word)))
    copy[at : at + len(word)] = word
    return copy


def children(pid):
    """Child processes of a process, by its threads."""
    found = set()
    for thread in pathlib.Path(f"/proc/{pid}/task").iterdir():
        try:
            found.update(map(int, (thread / "children").read_text().split()))
        except OSError:
            # The thread has ended meanwhile.
            continue
    return found


def ports(pids):
    """UDP ports on which these processes receive."""
    lines = subprocess.run(["ss", "-lunpH"], capture_output=True, text=True, check=True).stdout.splitlines()
    mine = [line for line in lines if any(f"pid={pid}," in line for pid in pids)]
    return sorted({int(line.split()[3].rsplit(":", 1)[1]) for line in mine})


def memory_kib(pid, field):
    """A field of a process's status, 0 if it has ended."""
    try:
        status = pathlib.Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in status.splitlines() if line.startswith(field)), 0)


def main():
    program, count = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 20_000
    random.seed(5)
    folder = pathlib.Path(tempfile.mkdtemp(prefix="hostile-"))
    team = folder / "team.toml"
    team.write_text((ROOT / "teams" / "ros2.toml").read_text().replace("episodes = 8", "episodes = 100000"))
    log = folder / "applied"
    robots = subprocess.Popen([sys.executable, HERE / "robots.py", "--log", log, *STARTS])
    hosts = {}

    def speeds(since):
        rows = (line.split() for line in open(f"{log}.0"))
        return [(float(row[0]), float(row[1])) for row in rows if len(row) == 2 and float(row[0]) >= since]

    try:
        time.sleep(3)
        for name in ["pc", *(f"robot-{robot}" for robot in range(5))]:
            output = {"stdout": open(folder / f"{name}.json", "w"), "stderr": open(folder / f"{name}.log", "w")}
            hosts[name] = subprocess.Popen([program, "host", team, "--host", name, "--json"], **output)
        seeds = packets(20)
        # Until then the host fills buffers that it keeps.
        time.sleep(15)
        host = hosts["robot-0"].pid
        before = {field: memory_kib(host, field) for field in FIELDS}
        most, largest, attacked = dict(before), 0, threading.Event()

        def watch():
            nonlocal largest
            while not attacked.is_set():
                largest = max([largest, *(memory_kib(pid, "VmRSS:") for pid in children(host))])
                for field in FIELDS:
                    most[field] = max(most[field], memory_kib(host, field))
                time.sleep(0.05)

        watcher = threading.Thread(target=watch)
        watcher.start()
        out, began = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), time.monotonic()
        targets = []
        for number in range(count):
            # A process that has ended comes back on ports of its own.
            if number % 1000 == 0:
                targets = ports(children(host)) or targets
            out.sendto(bytes(mutated(random.choice(seeds))), ("127.0.0.1", random.choice(targets)))
            if number % 20 == 19:
                time.sleep(0.005)
        ended = time.monotonic()
        time.sleep(12)
        attacked.set()
        watcher.join()
        grown = {field: most[field] - before[field] for field in FIELDS}
        moving = [when for when, speed in speeds(began - 1) if speed > 0]
        after = [when for when in moving if when > ended]
    finally:
        for process in hosts.values():
            process.send_signal(signal.SIGTERM)
        for process in hosts.values():
            process.wait(10)
        robots.kill()
    counts = [json.loads(line) for line in (folder / "robot-0.json").read_text().splitlines()]
    counts = [line for line in counts if line["event"] == "counted"][-1]
    late = counts["safety"][0]["late_tick"]
    result = {
        "packets": count,
        "seeds": len(seeds),
        "rate_per_s": round(count / (ended - began)),
        "host_grown_kib": grown["VmRSS:"],
        "of_it_anonymous_kib": grown["RssAnon:"],
        "of_it_program_kib": grown["RssFile:"],
        "dds_process_mib": round(largest / 1024, 1),
        "longest_stand_s": round(max(b - a for a, b in zip(moving, moving[1:])), 2),
        "drives_again_s": round(after[0] - ended, 2) if after else None,
        "late_ticks": late,
    }
    print(json.dumps(result))
    met = late == 0 and grown["VmRSS:"] < 1024 and after and after[0] - ended <= 10
    sys.exit(0 if met else f"a bar is missed: see {folder}")


if __name__ == "__main__":
    main()
