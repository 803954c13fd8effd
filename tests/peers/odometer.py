"""Robots whose odometry can fail, for tests of `place`: odometer.py drive|measure PORT

`drive` is the program of a driver: it hands its lines to `measure`, the program of a source. That one moves two robots by
their commands, and prints what their odometry says, 50 times a second. A datagram to its port changes that, or asks where
the robots really are:

    {"fault": "restart", "robot": 0}             it counts from zero again, where the robot stands
    {"fault": "jump", "robot": 0, "by": [3, 1, 0.5]}    its poses are from now on elsewhere
    {"fault": "silence", "robot": 0, "for_s": 2} it says nothing for a while, and then counts from zero again
    {"ask": true}                                answered with the true poses and speeds
"""

import json
import math
import select
import socket
import sys
import time

part, port = sys.argv[1], int(sys.argv[2])
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

if part == "drive":
    print('{"health": "ready"}', flush=True)
    for line in sys.stdin:
        link.sendto(line.encode(), ("127.0.0.1", port))
    sys.exit()


def moved(frame, pose):
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    x, y = frame[0] + cos * pose[0] - sin * pose[1], frame[1] + sin * pose[0] + cos * pose[1]
    return [x, y, math.remainder(frame[2] + pose[2], math.tau)]


def inverse(pose):
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return [-cos * pose[0] - sin * pose[1], sin * pose[0] - cos * pose[1], -pose[2]]


link.bind(("127.0.0.1", port))
truth = {0: [-0.8, 0.0, 0.0], 1: [0.8, 0.0, 0.0]}
# Frame in which each robot's odometry counts; at first that of the team.
frames = {0: [0.0, 0.0, 0.0], 1: [0.0, 0.0, 0.0]}
commands, silent = {}, {}
last = time.monotonic()
while not select.select([sys.stdin], [], [], 0.02)[0]:
    now = time.monotonic()
    passed, last = min(now - last, 0.1), now
    speeds = {}
    for robot, pose in truth.items():
        vx, vy, until = commands.get(robot, (0.0, 0.0, 0.0))
        speeds[robot] = (vx, vy) if now <= until else (0.0, 0.0)
        pose[0] += passed * speeds[robot][0]
        pose[1] += passed * speeds[robot][1]
    while select.select([link], [], [], 0)[0]:
        data, sender = link.recvfrom(4096)
        word = json.loads(data)
        robot = word.get("robot")
        if "ask" in word:
            told = {str(robot): [*truth[robot], math.hypot(*speeds[robot])] for robot in truth}
            link.sendto(json.dumps(told).encode(), sender)
        elif word.get("fault") == "restart":
            frames[robot] = list(truth[robot])
        elif word.get("fault") == "jump":
            frames[robot] = moved(frames[robot], word["by"])
        elif word.get("fault") == "silence":
            silent[robot], frames[robot] = now + word["for_s"], None
        else:
            commands[robot] = (word["vx"], word["vy"], time.monotonic() + word["for_s"])
    for robot, pose in truth.items():
        if now < silent.get(robot, 0.0):
            continue
        if frames[robot] is None:
            frames[robot] = list(pose)
        x, y, heading = moved(inverse(frames[robot]), pose)
        cos, sin = math.cos(frames[robot][2]), math.sin(frames[robot][2])
        vx, vy = cos * speeds[robot][0] + sin * speeds[robot][1], cos * speeds[robot][1] - sin * speeds[robot][0]
        said = {"robot": robot, "stamp_s": now, "x": x, "y": y, "vx": vx, "vy": vy, "heading": heading}
        print(json.dumps(said), flush=True)
