"""Copters with stand-in autopilots: a team that rises, changes places and lands; a host that ends in the air; a pilot.

    python3 copters.py MURMURATE

Prints a line for each figure with its bar; exit code 1 if one is missed. PYTHON has pymavlink.
"""

import signal
import sys
import time

from teams import OWN, PILOT, Team, logged, missed, program_of, tell, wait

BODY = "height_m = 1.2"
OWN_COPTER = {"px4": OWN["px4"], "ardupilot": 4}


def of(log, key):
    return [entry for entry in logged(log) if key in entry]


def flown(program, firmware, port):
    team = Team(program, firmware, port, vehicle="copter", episodes=2, body=BODY)
    try:
        ended = wait(lambda: team.hosts["pc"].poll() is not None, 150.0)
        won = sum(1 for event in team.events("pc") if event.get("verdict") == "success")
        down = wait(lambda: all([e["armed"] for e in of(log, "armed")][-1:] == [False] for log in team.logs), 20.0)
        cut = sum(1 for log in team.logs for e in of(log, "ask_arm") if e["ask_arm"] < 0.5)
        failed = missed([(f"{firmware} copters: episodes", f"{won} of 2 succeeded", bool(ended) and won == 2),
                         (f"{firmware} copters: all have landed and are disarmed", bool(down), bool(down)),
                         (f"{firmware} copters: motors cut by a command", cut, cut == 0)])
        if failed:
            print(team.said(0)[-2500:], team.said("pc")[-1500:], team.events("pc")[-2:], logged(team.logs[0])[-3:])
        return failed
    finally:
        team.end()


def ends(program, firmware, port):
    """The host of a robot in the air is asked to end: it lands it first. A pilot takes another one over."""
    team = Team(program, firmware, port, vehicle="copter", episodes=1000, body=BODY)
    try:
        if not wait(lambda: team.moves(0) and team.moves(1), 60.0):
            print(team.said(0)[-2500:], team.said("pc")[-1500:])
            return True
        since = time.monotonic()
        pilot = PILOT[firmware] if firmware == "px4" else 5
        tell(team.peers[1], f"mode {pilot}")
        team.hosts[0].send_signal(signal.SIGTERM)
        landed = wait(lambda: any(e["at"] > since and e["armed"] is False for e in of(team.logs[0], "armed")), 20.0)
        time.sleep(1.0)
        after = [e for e in of(team.logs[1], "ask_mode") if e["at"] > since + 0.2]
        return missed([(f"{firmware} copter: its host ends, and it lands", bool(landed), bool(landed)),
                       (f"{firmware} copter: orders to one that a pilot has taken over", len(after), not after)])
    finally:
        team.end()


def main():
    program, failed = program_of(sys.argv), False
    for at, firmware in enumerate(OWN_COPTER):
        failed |= flown(program, firmware, 16_700 + 10 * at)
        failed |= ends(program, firmware, 16_730 + 10 * at)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
