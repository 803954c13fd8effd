"""Six fake Crazyflies at once, flown by the hosts of a team: whose setpoints reach whom, axes and signs, hosts that die, lost
packets, faults.

    python3 flights.py MURMURATE FOLDER [CASE...]

FOLDER has the examples `fake_crazyflie` and `natnet_server`; CASE: six, wiggle, kill, halt, resumed, pc-kill, pc-halt, loss, faults.
Prints a line for each figure with its bar; exit code 1 if one is missed. PYTHON has mcap and msgpack, for `six`."""

import json
import math
import random
import signal
import statistics
import struct
import sys
import time
from pathlib import Path

from teams import HEIGHTS, Team, missed, program_of, wait

MOMENTS = 20
LEVELS_S, SHUTS_DOWN_S = 0.5, 2.0  # the firmware's


def ms(seconds):
    return f"{1000 * seconds:.0f} ms"


def spread(times):
    return f"median {ms(statistics.median(times))}, worst {ms(max(times))}" if times else "none"


def commands(record, robot):
    """Returns the velocities that a host has commanded its robot, in their order, from its record."""
    import mcap.reader
    import msgpack

    found = []
    with open(record, "rb") as file:
        for _, channel, message in mcap.reader.make_reader(file).iter_messages():
            blocks = message.data[14:] if channel.topic.startswith("/wire/") else b""
            while len(blocks) > 3:
                kind, length = blocks[0], struct.unpack("<H", blocks[1:3])[0]
                if kind == 2:
                    fields = msgpack.unpackb(blocks[3 : 3 + length])
                    if fields[0] == robot:
                        found.append((message.log_time, struct.unpack("<2f", fields[1])))
                blocks = blocks[3 + length :]
    return [velocity for _, velocity in sorted(found, key=lambda entry: entry[0])]


def world(line):
    """Returns the velocity of a setpoint in the world frame."""
    if "world" in line:
        return line["world"][:2]
    (ahead, left), yaw = line["hover"][:2], line["yaw"]
    return [math.cos(yaw) * ahead - math.sin(yaw) * left, math.sin(yaw) * ahead + math.cos(yaw) * left]


def old_ones(sent, wanted):
    """Returns how many setpoints are none that was commanded, and how many are older than one that was sent before. A robot may
    stand by itself between commands."""
    at, unknown, old = 0, 0, 0
    for velocity in sent:
        near = [k for k, other in enumerate(wanted) if math.dist(velocity, other) < 2e-3]
        if any(k >= at for k in near):
            at = next(k for k in near if k >= at)
        elif math.hypot(*velocity) > 1e-3:
            old, unknown = old + bool(near), unknown + (not near)
    return unknown, old


def six(program, folder):
    failed = False
    for setpoint in ("hover", "velocity-world"):
        team = Team(program, folder, setpoint=setpoint, episodes=3)
        try:
            record = Path(team.place.name) / "record"
            code, out, log = team.run("launch", str(team.file), "--json", "--record", str(record), seconds=400.0)
            result = json.loads(out) if out.startswith("{") else {}
            won = sum(episode.get("verdict") == "success" for episode in result.get("episodes", []))
            fakes = team.fakes
            wait(fakes.grounded, 10.0)
            count = [len(fakes.setpoints(robot)) for robot in range(6)]
            foreign = sum(
                abs(line["hover"][3] - HEIGHTS[robot]) > 1e-3
                for robot in range(6) for line in fakes.setpoints(robot) if "hover" in line
            )
            unknown, old = 0, 0
            for robot in range(6):
                files = sorted(record.glob(f"*robot-{robot}*.mcap"))
                wanted = [velocity for file in files for velocity in commands(file, robot)]
                more = old_ones([world(line) for line in fakes.setpoints(robot)], wanted)
                unknown, old = unknown + more[0], old + more[1]
            total = sum(count)
            failed |= missed([
                (f"six, {setpoint}: launch", f"exit code {code}, {won} of 3 episodes", code == 0 and won >= 2),
                (f"six, {setpoint}: setpoints", f"{total}, the fewest of one {min(count)}", min(count) > 100),
                (f"six, {setpoint}: for another robot, by height", foreign, foreign == 0),
                (f"six, {setpoint}: none of the robot's own commands", unknown, unknown == 0),
                (f"six, {setpoint}: older than the one before", old, old == 0),
                (f"six, {setpoint}: landed whole", fakes.grounded(), fakes.grounded() and whole(fakes)),
            ])
            if failed:
                print(log[-3000:], out[-500:])
        finally:
            team.end()
    return failed


def whole(fakes):
    return not any(now["crashed"] or now["cuts"] or now["refused"] for now in fakes.now)


def wiggle(program, folder):
    team = Team(program, folder, together=True)
    try:
        code, out, log = team.run("doctor", str(team.file), "--host", "pc", "--wiggle", "--yes", "--json", seconds=300.0)
        said = json.loads(out)
        lines = [str(check) for check in said.get("checks", []) if "wiggle" in str(check)]
        driven = sum("ok" in line for line in lines)
        landed = bool(wait(team.fakes.grounded, 10.0))
        failed = missed([
            ("wiggle: six robots of other headings", f"exit code {code}, {driven} as they should", code == 0 and driven >= 6),
            ("wiggle: all landed whole", landed, landed and whole(team.fakes)),
        ])
        if failed:
            print(out[-4000:], log[-2000:])
        return failed
    finally:
        team.end()


def aloft(team):
    """Starts the hosts, and waits until all robots have flown for a while."""
    team.start_all()
    if not wait(lambda: team.fakes.fly() and any(team.moves(robot) for robot in range(6)), 60.0):
        sys.exit(f"the robots do not rise: {team.said('pc')[-1500:]} {team.said('robot-0')[-1500:]}")


def dies(program, folder, which):
    """Hosts of robots are killed or halted at random moments: when do their robots level, and when are their motors off?"""
    draws, levels, offs, sent, others, landed = random.Random(6), [], [], [], 0, 0
    flights = math.ceil(MOMENTS / 5)
    for _ in range(flights):
        team = Team(program, folder, episodes=1000)
        try:
            aloft(team)
            fakes = team.fakes
            for robot in range(5):
                time.sleep(draws.uniform(0.02, 0.4))
                at = time.monotonic()
                team.signal(f"robot-{robot}", which)
                time.sleep(0.0)
                wait(lambda: fakes.flown(robot, "off", at), 4.0)
                after = [line["at"] - at for line in fakes.setpoints(robot, at)]
                sent.append(max(after, default=0.0))
                last = max(line["at"] for line in fakes.setpoints(robot))
                level, off = fakes.flown(robot, "level", at), fakes.flown(robot, "off", at)
                levels.append((level or math.inf) - last)
                offs.append((off or math.inf) - last)
            # The last robot's host lives: it hovers, and lands once the episode cannot go on and its team ends.
            others += not fakes.now[5]["crashed"] and fakes.now[5]["cuts"] == 0
            team.signal("robot-5", signal.SIGTERM)
            landed += bool(wait(lambda: fakes.now[5]["z"] < 0.05 and not fakes.now[5]["motors"], 10.0))
        finally:
            team.end()
    name = which.name
    return missed([
        (f"{name}: last setpoint after it, {len(sent)} moments", spread(sent), max(sent) < 0.06),
        (f"{name}: the robot levels after its last setpoint", spread(levels), max(levels) < LEVELS_S + 0.05),
        (f"{name}: its motors are off after its last setpoint", spread(offs), max(offs) < SHUTS_DOWN_S + 0.05),
        (f"{name}: the robot whose host lives is whole, and lands", f"{others} and {landed} of {flights}", others == landed == flights),
    ])


def resumed(program, folder):
    """A robot's host is halted for 0.3 to 1.6 s, and goes on: what it does then."""
    draws, worst, landed, level = random.Random(7), 0.0, 0, []
    for _ in range(4):
        team = Team(program, folder, episodes=1000)
        try:
            aloft(team)
            fakes = team.fakes
            for robot in range(5):
                at, lasts = time.monotonic(), draws.uniform(0.3, 1.6)
                team.signal(f"robot-{robot}", signal.SIGSTOP)
                time.sleep(lasts)
                team.signal(f"robot-{robot}", signal.SIGCONT)
                gone = time.monotonic()
                time.sleep(0.6)
                first = [line["at"] - gone for key in ("order",) for line in fakes.all(robot, key, gone)]
                first += [line["at"] - gone for line in fakes.setpoints(robot, gone)]
                level.append(min(first, default=math.inf))
            time.sleep(4.0)
            worst = max(worst, max(now["hardest"] for now in fakes.now))
            landed += sum(not now["crashed"] and not now["cuts"] for now in fakes.now)
        finally:
            team.end()
    return missed([
        ("halted for 0.3 to 1.6 s: first packet after it goes on, 20 moments", spread(level), max(level) < 0.3),
        ("halted for 0.3 to 1.6 s: robots that are whole", f"{landed} of 24, hardest landing {worst:.2f} m/s", landed == 24),
    ])


def pc_dies(program, folder, which):
    """The host of the tracker and the state server is killed or halted: when do the robots hover, and when do they land?"""
    draws, hovers, lands, whole_ones = random.Random(8), [], [], 0
    team = Team(program, folder, episodes=1000)
    try:
        aloft(team)
        fakes = team.fakes
        for moment in range(MOMENTS):
            wait(lambda: fakes.fly() and any(team.moves(robot, time.monotonic() - 0.3) for robot in range(6)), 60.0)
            time.sleep(draws.uniform(0.0, 0.5))
            at = time.monotonic()
            team.signal("pc", which)
            grounded = wait(fakes.grounded, 12.0)
            for robot in range(6):
                moved = [line["at"] - at for line in fakes.setpoints(robot, at) if math.hypot(*world(line)) > 0.02]
                hovers.append(max(moved, default=0.0))
                orders = [line["at"] - at for line in fakes.all(robot, "order", at) if line["order"] == 8]
                lands.append(min(orders, default=math.inf))
            whole_ones += bool(grounded) and whole(fakes)
            if which == signal.SIGSTOP:
                team.signal("pc", signal.SIGKILL)
            if moment + 1 < MOMENTS:
                team.start("pc")
    finally:
        team.end()
    name = which.name
    return missed([
        (f"pc {name}: last setpoint that moves a robot, {MOMENTS} moments, six robots", spread(hovers), max(hovers) < 0.3),
        (f"pc {name}: first order to land", spread(lands), max(lands) < 2.5),
        (f"pc {name}: all landed whole", f"{whole_ones} of {MOMENTS}", whole_ones == MOMENTS),
    ])


def loss(program, folder):
    failed = False
    for percent in (1, 5, 10, 20):
        team = Team(program, folder, episodes=3)
        try:
            team.fakes.tell(f"all loss {percent}")
            code, out, log = team.run("launch", str(team.file), "--json", seconds=400.0)
            result = json.loads(out) if out.startswith("{") else {}
            won = sum(episode.get("verdict") == "success" for episode in result.get("episodes", []))
            fakes, gap, levels = team.fakes, 0.0, 0
            landed = bool(wait(fakes.grounded, 10.0))
            for robot in range(6):
                times = [line["at"] for line in fakes.setpoints(robot)]
                gap = max([gap, *(b - a for a, b in zip(times, times[1:]) if b - a < 1.0)])
                levels += len([line for line in fakes.all(robot, "flown") if line["flown"] == "level"])
            failed |= missed([
                (f"{percent} % lost each way: episodes", f"{won} of 3, exit code {code}", code == 0 and won >= 2),
                (f"{percent} % lost each way: longest gap between setpoints", f"{ms(gap)}, levelled {levels}", levels == 0),
                (f"{percent} % lost each way: all landed whole", landed, landed and whole(fakes)),
            ])
            if failed:
                print(log[-3000:], out[-500:])
        finally:
            team.end()
    return failed


def faults(program, folder):
    failed = False
    for fault, word in (("battery 15", "battery"), ("tumbled", "tumbled"), ("crashed", "crashed"), ("locked", "locked"),
                        ("silent 3", "does not answer")):
        team = Team(program, folder, episodes=1000, body="battery_least = 0.2")
        try:
            aloft(team)
            fakes, at = team.fakes, time.monotonic()
            fakes.tell(f"2 {fault}")
            last = lambda: [line["at"] - at for line in fakes.setpoints(2, at) if math.hypot(*world(line)) > 0.02]  # noqa: E731
            down = wait(lambda: fakes.now[2]["z"] < 0.05 and not fakes.now[2]["motors"] and fakes.now[2]["at"] - at, 10.0)
            orders = [line["at"] - at for line in fakes.all(2, "order", at) if line["order"] == 8]
            moved = max(last(), default=0.0)
            others = all(now["z"] > 0.3 and not now["crashed"] for robot, now in enumerate(fakes.now) if robot != 2)
            told = word in team.said("robot-2")
            first = ms(min(orders)) if orders else "never"
            failed |= missed([
                (f"{fault}: last setpoint that moves it, first order to land, on the ground",
                 f"{ms(moved)}, {first}, {ms(down) if down else 'never'}", bool(down) and (moved < 0.5 or "silent" in fault)),
                (f"{fault}: told, and the others are in the air", f"{told}, {others}", told and others),
            ])
            if failed:
                print(team.said("robot-2")[-2000:])
        finally:
            team.end()
    return failed


def main():
    program, folder, cases = program_of(sys.argv), sys.argv[2], sys.argv[3:]
    runs = {
        "six": lambda: six(program, folder),
        "wiggle": lambda: wiggle(program, folder),
        "kill": lambda: dies(program, folder, signal.SIGKILL),
        "halt": lambda: dies(program, folder, signal.SIGSTOP),
        "resumed": lambda: resumed(program, folder),
        "pc-kill": lambda: pc_dies(program, folder, signal.SIGKILL),
        "pc-halt": lambda: pc_dies(program, folder, signal.SIGSTOP),
        "loss": lambda: loss(program, folder),
        "faults": lambda: faults(program, folder),
    }
    failed = False
    for case in cases or runs:
        failed |= bool(runs[case]())
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
