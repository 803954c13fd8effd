"""Rovers with stand-in autopilots, driven by the hosts of a team: episodes, a pilot who takes over, hosts that die, silence,
signatures, junk.

    python3 rovers.py MURMURATE [CASE...]

CASE: episodes, one, double, loss, pilot, kill, halt, silence, restart, double, lie, signed, unsigned, otherkey, doctor, junk. Prints a
line for each figure with its bar; exit code 1 if one is missed. PYTHON has pymavlink.
"""

import random
import signal
import socket
import statistics
import subprocess
import sys
import time

from teams import KEY, NAMES, OWN, PILOT, Team, logged, missed, program_of, tell, wait

MOMENTS = 20


def at_of(log, since, **wanted):
    found = [e["at"] for e in logged(log) if e["at"] >= since and all(e.get(k) == v for k, v in wanted.items())]
    return found[0] if found else None


def episodes(program, firmware, port, count=4, name="", line="", **settings):
    team = Team(program, firmware, port, episodes=count, **settings)
    try:
        for robot in team.peers if line else ():
            tell(robot, line)
        ended = wait(lambda: team.hosts["pc"].poll() is not None, 60.0 + 40.0 * count)
        out = team.events("pc")
        done = [event for event in out if event.get("event") == "episode"]
        won = sum(1 for event in done if event.get("verdict") == "success")
        asked = [e for log in team.logs for e in logged(log) if e.get("ask_mode") == OWN[firmware]]
        first = min((e["setpoints"] for e in asked), default=0)
        bars = [(f"{firmware} {name}episodes", f"{won} of {count} succeeded", bool(ended) and won >= count - 1)]
        if firmware == "px4":
            bars.append((f"{firmware} {name}setpoints before the mode was asked for", first, first >= 10))
        if missed(bars):
            print(team.said(0)[-2000:], team.said("pc")[-2000:], out[-3:])
            return True
        return False
    finally:
        team.end()


def pilot(program, firmware, port):
    """At random moments a pilot changes the mode while the robot moves: when does the last setpoint arrive?"""
    draws, late, after, told = random.Random(3), [], 0, 0
    for moment in range(MOMENTS):
        team = Team(program, firmware, port + 2 * moment, episodes=1000)
        try:
            if not wait(lambda: team.moves(0)):
                print(team.said(0)[-2000:], team.said("pc")[-2000:])
                return True
            time.sleep(draws.uniform(0.1, 1.5))
            since = time.monotonic()
            tell(team.peers[0], f"mode {PILOT[firmware]}")
            changed = wait(lambda: at_of(team.logs[0], since, mode=PILOT[firmware]), 5.0)
            time.sleep(1.0)
            # He goes back to the mode of setpoints: nothing moves for that.
            tell(team.peers[0], f"mode {OWN[firmware]}")
            time.sleep(1.0)
            sent = [e["at"] for e in logged(team.logs[0]) if "setpoint" in e and e["at"] > changed]
            late.append(1000 * max([at - changed for at in sent], default=0.0))
            after += sum(1 for at in sent if at - changed > 0.1)
            told += f"the pilot took over: mode {NAMES[firmware]}" in team.said(0)
        finally:
            team.end()
    worst, median = max(late), statistics.median(late)
    return missed([
        (f"{firmware} pilot: last setpoint after his change, {MOMENTS} moments",
         f"median {median:.0f} ms, worst {worst:.0f} ms", worst <= 100),
        (f"{firmware} pilot: setpoints later than 100 ms", after, after == 0),
        (f"{firmware} pilot: the reason is told", f"{told} of {MOMENTS}", told == MOMENTS),
    ])


def dies(program, firmware, port, how):
    """At random moments the robot's host is killed or halted: when does the last setpoint that moves it arrive?"""
    draws, late = random.Random(4), []
    for moment in range(MOMENTS):
        team = Team(program, firmware, port + 2 * moment, episodes=1000)
        try:
            if not wait(lambda: team.moves(0)):
                print(team.said(0)[-2000:])
                return True
            time.sleep(draws.uniform(0.1, 1.5))
            died = time.monotonic()
            team.hosts[0].send_signal(how)
            time.sleep(1.6)
            setpoints = [e["at"] for e in logged(team.logs[0]) if "setpoint" in e and e["at"] > died]
            left = at_of(team.logs[0], died, mode=4 << 16 | 3 << 24)
            late.append((1000 * max([at - died for at in setpoints], default=0.0), left and 1000 * (left - died)))
        finally:
            team.end()
    last = max(at for at, _ in late)
    bars = [(f"{firmware} {how.name}: setpoints after it, {MOMENTS} moments", f"the last after {last:.0f} ms", last <= 60)]
    if firmware == "px4":
        left = [at for _, at in late if at]
        said = f"{len(left)} of {MOMENTS}, at most {max(left, default=0):.0f} ms"
        bars.append((f"{firmware} {how.name}: the stand-in leaves OFFBOARD", said, len(left) == MOMENTS))
    return missed(bars)


def disturbed(program, firmware, port, line, text, key=None, peers=(), moves=True, **settings):
    """The autopilot does something; the robot's host has to say `text`."""
    team = Team(program, firmware, port, episodes=1000, key=key, peers=peers, **settings)
    try:
        if moves and not wait(lambda: team.moves(0)):
            print(team.said(0)[-2000:])
            return True
        if line:
            tell(team.peers[0], line)
        told = wait(lambda: text in team.said(0), 15.0)
        name = line or "from the start"
        alive = team.hosts[0].poll() is None
        failed = missed([(f"{firmware} {name}: the host says '{text}'", bool(told), bool(told) and alive)])
        if failed:
            print(team.said(0)[-3000:])
        return failed
    finally:
        team.end()


def doctor(program, port):
    """What `doctor` says of the end of setpoints, and of an unsigned autopilot."""
    failed = False
    for firmware, text in (("px4", "PX4 leaves OFFBOARD after 1 s (COM_OF_LOSS_T), then COM_OBL_RC_ACT 5: Hold"),
                           ("ardupilot", "ArduPilot stops the rover after 3 s")):
        team = Team(program, firmware, port, hosts=())
        try:
            command = [program, "doctor", str(team.file), "--robot", "0", "--listen", "4"]
            said = subprocess.run(command, capture_output=True, text=True)
            failed |= missed([(f"doctor says '{text}'", text in said.stdout, text in said.stdout)])
            print("\n".join(line for line in said.stdout.splitlines() if "mavlink" in line))
        finally:
            team.end()
    team = Team(program, "px4", port + 4, key=KEY, hosts=(), peers=("--key", "ff" * 32))
    try:
        said = subprocess.run([program, "doctor", str(team.file), "--robot", "0", "--listen", "3"], capture_output=True,
                              text=True)
        text = "signed by another key"
        failed |= missed([("doctor names another key", text in said.stdout, text in said.stdout and said.returncode == 1)])
        shown = KEY in said.stdout + said.stderr
        failed |= missed([("the key is shown", shown, not shown)])
        print("\n".join(line for line in said.stdout.splitlines() if "mavlink" in line))
    finally:
        team.end()
    return failed


def junk(program, port, seconds=60.0):
    """Random bytes, cut, changed and repeated frames for a minute, from the autopilot's own socket's address and another."""
    team = Team(program, "px4", port, episodes=1000)
    draws, sent = random.Random(5), 0
    socket_ = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if not wait(lambda: team.moves(0)):
            return True
        heard = sample()
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            frame = bytearray(draws.choice(heard))
            kind = draws.randrange(4)
            if kind == 0:
                frame = bytearray(draws.randbytes(draws.randrange(600)))
            elif kind == 1:
                frame = frame[:draws.randrange(len(frame))]
            else:
                for _ in range(draws.randrange(1, 4)):
                    frame[draws.randrange(len(frame))] = draws.randrange(256)
            socket_.sendto(bytes(frame), ("127.0.0.1", port))
            sent += 1
            if sent % 20 == 0:
                time.sleep(0.01)
        alive = team.hosts[0].poll() is None
        drives = team.moves(0, time.monotonic() - 20.0)
        return missed([(f"junk for {seconds:.0f} s: {sent} datagrams, the host lives", alive, alive),
                       ("junk: the robot was driven in its last 20 s", drives, drives)])
    finally:
        team.end()


def sample():
    """Frames of many kinds, by pymavlink."""
    from pymavlink.dialects.v20 import development as mav

    link = mav.MAVLink(None, srcSystem=1, srcComponent=1)
    messages = [mav.MAVLink_heartbeat_message(10, 12, 129, 6 << 16, 4, 3), mav.MAVLink_attitude_message(1, 0, 0, 1, 0, 0, 0),
                mav.MAVLink_local_position_ned_message(5, 1, 2, 3, 0, 0, 0), mav.MAVLink_current_mode_message(0, 6 << 16, 0),
                mav.MAVLink_statustext_message(3, b"words"), mav.MAVLink_command_ack_message(400, 4),
                mav.MAVLink_param_value_message(b"COM_OF_LOSS_T", 1.0, 9, 1, 1), mav.MAVLink_gps_global_origin_message(1, 2, 3)]
    return [message.pack(link) for message in messages]


def main():
    program, cases = program_of(sys.argv), sys.argv[2:]
    both = ("px4", "ardupilot")
    names = {"px4": "MANUAL", "ardupilot": "MANUAL"}
    runs = {
        "episodes": lambda: [episodes(program, firmware, 14_800 + 4 * at) for at, firmware in enumerate(both)],
        "one": lambda: [episodes(program, "ardupilot", 14_810, 2, "MAVLink 1 ", peers=("--one",),
                                 driver_more=", version = 1", source_more=", version = 1")],
        "double": lambda: [episodes(program, "px4", 14_820, 4, "doubled ", "double")],
        "loss": lambda: [episodes(program, "px4", 14_830, 4, "10 % lost ", "drop 10")],
        "pilot": lambda: [pilot(program, firmware, 15_000 + 200 * at) for at, firmware in enumerate(both)],
        "kill": lambda: [dies(program, firmware, 15_400 + 200 * at, signal.SIGKILL) for at, firmware in enumerate(both)],
        "halt": lambda: [dies(program, firmware, 15_800 + 200 * at, signal.SIGSTOP) for at, firmware in enumerate(both)],
        "silence": lambda: [disturbed(program, f, 16_300 + 4 * at, "halt 5", "the autopilot is silent")
                            for at, f in enumerate(both)],
        "restart": lambda: [disturbed(program, f, 16_310 + 4 * at, "restart", "took over: mode " + names[f])
                            for at, f in enumerate(both)],
        "lie": lambda: [disturbed(program, "px4", 16_330, "lie", "an ATTITUDE has a yaw that is none")],
        "signed": lambda: [episodes(program, "px4", 16_340, 2, "signed ", key=KEY)],
        "unsigned": lambda: [disturbed(program, "px4", 16_350, "unsigned", "a frame is unsigned on a signed link", KEY)],
        "otherkey": lambda: [disturbed(program, "px4", 16_360, "", "signed by another key", KEY, ("--key", "ff" * 32), False)],
        "doctor": lambda: [doctor(program, 16_400)],
        "junk": lambda: [junk(program, 16_500)],
    }
    failed = False
    for case in cases or runs:
        failed |= any(runs[case]())
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
