"""Robots of the Robotarium's simulator as robots of a team, for the driver and the source `program`.

    robots.py drive PORT             the motors of a robot: hands lines of the host to the simulator
    robots.py track PORT ROBOTS [turned] [REPORT.json]
                                     the simulator, paced at 0.033 s, and the tracker: says where the robots are

It needs `pip install numpy scipy matplotlib robotarium-python-simulator`. With `turned` the team's frame is the
Robotarium's, turned by a quarter: for ground that is longer along y. The report has what the simulator's validator
complained of.
"""

import json
import math
import select
import socket
import sys
import time

STEP_S = 0.033
ANSWER_S = 0.02  # of a step: for the commands that a host sends once it has these poses
PLACES = [-1.3, -0.6, 0.6, 1.3]  # along x: where robots stand at the beginning
ROWS = [0.7, -0.7, 0.0]


def drive(here):
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    print('{"health": "ready"}', flush=True)
    for line in sys.stdin:  # the end of the input means: stand; the commands expire
        link.sendto(line.encode(), here)


def newest(link, commands, over):
    """Takes the commands that arrive until a time; each holds until its own end."""
    while select.select([link], [], [], max(0.0, over - time.monotonic()))[0]:
        line = json.loads(link.recv(4096))
        until = time.monotonic() + line["for_s"]
        commands[line["robot"]] = (line["ahead"] or 0.0, line["yaw_rate"] or 0.0, until)


def track(here, robots, turned, report):
    import matplotlib

    matplotlib.use("Agg")
    import numpy as np
    import rps.robotarium as robotarium

    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(here)
    start = [[PLACES[k % 4], ROWS[k // 4], 0.0] for k in range(robots)]
    arena = robotarium.Robotarium(
        number_of_robots=robots, show_figure=False, sim_in_real_time=True, initial_conditions=np.array(start).T
    )
    commands, steps, due, motion = {}, 0, time.monotonic(), np.zeros((2, robots))
    while not select.select([sys.stdin], [], [], 0)[0]:
        now, poses = time.monotonic(), arena.get_poses().copy()
        for robot in range(robots):
            x, y, heading = poses[:, robot]
            if turned:
                x, y, heading = -y, x, heading + math.pi / 2
            forward, turn = motion[:, robot]
            reading = {"robot": robot, "stamp_s": now, "x": x, "y": y, "heading": math.remainder(heading, math.tau)}
            motions = {"vx": forward * math.cos(heading), "vy": forward * math.sin(heading), "yaw_rate": turn}
            print(json.dumps({**reading, **motions}), flush=True)
        # As a script of the Robotarium: poses, then the commands that follow from them, then the step. A command that was
        # computed from the poses before would act while its robot has turned on by up to 7 degrees.
        newest(link, commands, time.monotonic() + ANSWER_S)
        now, motion = time.monotonic(), np.zeros((2, robots))
        for robot, (forward, turn, until) in commands.items():
            if now < until:
                motion[:, robot] = forward, turn
        arena.set_velocities(np.arange(robots), motion.copy())
        arena.step()
        steps, due = steps + 1, max(due + STEP_S, time.monotonic() - STEP_S)
        time.sleep(max(0.0, due - time.monotonic()))
    if report:
        # The simulator keeps what it complained of in `_errors`.
        complaints = {kind: count for kind, count in arena._errors.items() if not kind.endswith("_string")}
        with open(report, "w") as file:
            json.dump({"steps": steps, "complaints": complaints}, file)


def main():
    here, rest = ("127.0.0.1", int(sys.argv[2])), sys.argv[3:]
    if sys.argv[1] == "drive":
        drive(here)
    else:
        reports = [word for word in rest[1:] if word != "turned"]
        track(here, int(rest[0]), "turned" in rest, reports[0] if reports else None)


if __name__ == "__main__":
    main()
