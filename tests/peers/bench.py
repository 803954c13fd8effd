"""Robots and their tracker for tests of `doctor`: bench.py drive|track PORT FAULT

`drive` is the program of a driver: it hands its lines to the tracker, and reports a condition. `track` is the program of
a source: it moves all robots by their commands and prints a reading of each, 50 times a second. With the FAULT `told`
nothing is broken: both print their process numbers on stderr, `drive` with each line that it reads.
"""

import json
import os
import select
import socket
import sys
import time

part, port, fault = sys.argv[1], int(sys.argv[2]), sys.argv[3]
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

if part == "drive":
    condition = {"health": "ready", "battery": 87, "temperature_c": 41.0}
    if fault == "flat":
        condition["battery"] = 3
    elif fault == "hot":
        condition["temperature_c"] = 88.0
    elif fault == "mute":
        condition = {"health": "ready"}
    elif fault == "faulty":
        condition = {"health": "faulty", "battery": 87, "reason": "bumper pressed"}
    print(json.dumps(condition), flush=True)
    if fault == "ended":
        sys.exit()
    for line in sys.stdin:
        if fault == "told":
            print(json.dumps({"drives": os.getpid(), **json.loads(line)}), file=sys.stderr, flush=True)
        link.sendto(line.encode(), ("127.0.0.1", port))
    sys.exit()

link.bind(("127.0.0.1", port))
if fault == "told":
    print(json.dumps({"tracks": os.getpid()}), file=sys.stderr, flush=True)
at = {0: [-1.0, -1.0], 1: [1.0, -1.0]}
commands = {}
began = last = time.monotonic()
while not select.select([sys.stdin], [], [], 0.02)[0]:
    while select.select([link], [], [], 0)[0]:
        command = json.loads(link.recv(4096))
        commands[command["robot"]] = (command["vx"], command["vy"], time.monotonic() + command["for_s"])
    now = time.monotonic()
    passed, last = now - last, now
    for robot, place in at.items():
        vx, vy, until = commands.get(robot, (0.0, 0.0, 0.0))
        if now > until or fault == "deaf":
            vx = vy = 0.0
        if fault == "mirrored-y":
            vy = -vy
        elif fault == "swapped-axes":
            vx, vy = vy, vx
        elif fault == "slow":
            vx, vy = 0.4 * vx, 0.4 * vy
        place[0] += passed * vx
        place[1] += passed * vy
        name = 1 - robot if fault == "swapped" else robot
        if fault == "dead-tracker" or fault == "lost" and robot == 1:
            continue
        stamp = {"frozen": began, "milliseconds": began + (now - began) * 1e-3}.get(fault, now)
        reading = {"robot": name, "stamp_s": stamp, "x": place[0], "y": place[1], "vx": vx, "vy": vy, "heading": 0.0}
        print(json.dumps(reading), flush=True)
