"""Kills a recording host at random moments and reads what it left.

    python kills.py MURMURATE TEAM.toml FOLDER COUNT

Prints the largest span that a record lacks before the kill. Exit code 1 if it is over 250 ms, or a reader fails.
"""

import pathlib
import random
import signal
import subprocess
import sys
import time

from mcap.reader import NonSeekingReader, make_reader


def kill_one(program, team, folder, seconds):
    for old in folder.glob("*"):
        old.unlink()
    command = [program, "host", team, "--host", "world", "--json", "--record", str(folder)]
    host = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    host.stdout.readline()
    time.sleep(seconds)
    killed = time.time_ns()
    host.send_signal(signal.SIGKILL)
    host.wait()
    host.stdout.close()
    [record] = folder.glob("*.mcap")
    last = count = 0
    with open(record, "rb") as file:
        try:
            for _, _, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                last, count = max(last, message.log_time), count + 1
        except Exception as error:
            if "EndOfFile" not in type(error).__name__ and "unpack" not in str(error):
                raise
    lost_ms = (killed - last) / 1e6 if last else seconds * 1e3
    subprocess.run([program, "record", "repair", str(record)], check=True, stdout=subprocess.DEVNULL)
    with open(record, "rb") as file:
        whole = sum(1 for _ in make_reader(file).iter_messages())
    assert whole == count, f"{count} messages in the cut file, {whole} in the repaired one"
    return lost_ms


def main(program, team, folder, count):
    random.seed(17)
    folder = pathlib.Path(folder)
    folder.mkdir(exist_ok=True)
    lost = sorted(kill_one(program, team, folder, random.uniform(0.4, 1.2)) for _ in range(int(count)))
    print(f"{len(lost)} kills: lost at worst {lost[-1]:.0f} ms, half of them at most {lost[len(lost) // 2]:.0f} ms")
    return 0 if lost[-1] <= 250 else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
