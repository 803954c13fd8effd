"""The commands of docs/crazyflie.md, one after the other, with its team file, against two fake Crazyflies under a fake tracker.

    python3 page.py MURMURATE FOLDER

FOLDER has the examples `fake_crazyflie` and `natnet_server`. Of the file the tracker's server and interface alone are changed."""

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from teams import Fakes, missed, program_of, wait

PAGE = Path(__file__).resolve().parents[3] / "docs" / "crazyflie.md"


def main():
    program, folder = program_of(sys.argv), sys.argv[2]
    blocks = dict(reversed(re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text(), re.S)))
    text = blocks["toml"].replace("10.0.0.2", "127.0.0.1").replace("eth1", "lo")
    commands = [line.split(" #")[0].split() for line in blocks["sh"].splitlines() if line.startswith("murmurate ")]
    fakes, failed = Fakes(folder, 2), False
    with tempfile.TemporaryDirectory(prefix="crazyflie-page-") as place:
        (Path(place) / "crazyflies.toml").write_text(text)
        try:
            time.sleep(0.5)
            for words in commands:
                said, wanted = " ".join(words), 0
                run = [program, *words[1:], *(["--yes"] if "--wiggle" in words else [])]
                if words[1] == "stop":
                    # It stops a team that flies.
                    host = subprocess.Popen(hosts, cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                    flew = wait(lambda: all(now["z"] > 0.4 for now in fakes.now), 40.0)
                    done = subprocess.run(run, cwd=place, capture_output=True, text=True, timeout=60)
                    landed = flew and wait(fakes.grounded, 15.0)
                    host.terminate()
                    host.wait(timeout=30)
                    failed |= missed([(said, f"exit code {done.returncode}, landed {bool(landed)}", bool(landed))])
                    continue
                hosts = run
                done = subprocess.run(run, cwd=place, capture_output=True, text=True, timeout=400)
                failed |= missed([(said, f"exit code {done.returncode}", done.returncode == wanted)])
                if failed:
                    print(done.stdout[-3000:], done.stderr[-2000:])
            whole = not any(now["crashed"] or now["cuts"] or now["refused"] for now in fakes.now)
            landed = bool(wait(fakes.grounded, 10.0))
            failed |= missed([("all landed whole", landed, landed and whole)])
        finally:
            fakes.end()
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
