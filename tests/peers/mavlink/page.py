"""The commands of docs/mavlink.md, with teams/px4-rtk.toml, against two stand-in autopilots that a person arms.

    python3 page.py MURMURATE

Of the file the serial ports, the ports of the copies and the interface are changed. PYTHON has pymavlink."""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from teams import OWN, logged, missed, peer, program_of, tell, wait

ROOT = Path(__file__).resolve().parents[3]
PORT = 14_610


def file_of(place):
    """Writes the team file for this machine."""
    text = (ROOT / "teams" / "px4-rtk.toml").read_text().replace('"wlan0"', '"lo"\ngroup = "239.255.91.9:7791"')
    head, *hosts = text.split("[[deployment.host]]")
    for robot in (0, 1):
        serial = hosts[robot].replace("serial:///dev/ttyACM0:921600", f"udpin://127.0.0.1:{PORT + robot}")
        hosts[robot] = serial.replace("127.0.0.1:14560", f"127.0.0.1:{PORT + 50 + robot}")
    (place / "px4-rtk.toml").write_text("[[deployment.host]]".join([head, *hosts]))


def main():
    program = program_of(sys.argv)
    page = (ROOT / "docs" / "mavlink.md").read_text()
    named = [words.split() for words in re.findall(r"`murmurate ([^`]*px4-rtk\.toml[^`]*)`", page)]
    doctor = next(words for words in named if words[0] == "doctor")
    host = next(words for words in named if words[0] == "host")
    failed = False
    with tempfile.TemporaryDirectory(prefix="mavlink-page-") as folder:
        place = Path(folder)
        file_of(place)
        subprocess.run([program, "key", "new", "--out", "team.key"], cwd=place, check=True, capture_output=True)
        logs = [place / f"{robot}.log" for robot in (0, 1)]
        starts = [("-1.2", "0", "0"), ("1.2", "0", "3.14159")]
        peers = [peer(PORT + robot, logs[robot], "px4", "--at", *starts[robot][:2], "--heading", starts[robot][2]) for robot in (0, 1)]
        hosts = []
        try:
            for robot in (0, 1):
                words = [str(robot) if word == "N" else word for word in doctor]
                done = subprocess.run([program, *words], cwd=place, capture_output=True, text=True)
                # The rover is not armed yet, which is the one check that fails.
                fails = [line for line in done.stdout.splitlines() if line.startswith("fail")]
                fit = len(fails) == 1 and "not armed" in fails[0]
                failed |= missed([("murmurate " + " ".join(words), f"exit code {done.returncode}, not armed: {fit}", fit)])
                if not fit:
                    print(done.stdout[-2000:], done.stderr[-2000:])
            for which in (["--robot", "0"], ["--robot", "1"], ["--host", "pc"]):
                out = open(place / f"{which[1]}.out", "w+")
                hosts.append((out, subprocess.Popen([program, *host[:2], *which, "--json"], cwd=place, stdout=out, stderr=subprocess.PIPE)))
            offboard = wait(lambda: all(any(e.get("mode") == OWN["px4"] for e in logged(log)) for log in logs), 30.0)
            failed |= missed([("both are in OFFBOARD, disarmed", bool(offboard), bool(offboard))])
            for autopilot in peers:
                tell(autopilot, "arm")
            ended = wait(lambda: hosts[2][1].poll() is not None, 240.0)
            lines = (place / "pc.out").read_text().splitlines()
            done = [json.loads(line) for line in lines if '"event":"episode"' in line]
            won = sum(1 for event in done if event.get("verdict") == "success")
            failed |= missed([("murmurate host ..., armed by hand", f"{won} of {len(done)} episodes", bool(ended) and won >= 3)])
        finally:
            for process in [*(process for _, process in hosts), *peers]:
                process.kill()
                process.wait()
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
