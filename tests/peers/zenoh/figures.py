#!/usr/bin/env python3
"""Figures of recorded teams, whose hosts share this machine's clock.

figures.py delivery PROGRAM FOLDER           time from the publication of a latent to its arrival at the other hosts
figures.py outage PROGRAM FOLDER FROM TO     who moves while the router is away, from FROM to TO [s]
"""

import bisect
import csv
import glob
import subprocess
import sys
import tempfile

from mcap.reader import make_reader

# Longest time that a robot may be driven after the router has gone [s]: the 0.2 s of its last command, two steps of the
# World, and the commands that were under way.
DRIVEN_FOR_S = 0.35
# Longest time until it stands [s]: from 1 m/s it brakes at the 1 m/s2 of the simulated robots.
MOVES_FOR_S = DRIVEN_FOR_S + 1.0
# Speed below which a robot stands [m/s].
STANDS_M_S = 1e-3


def anchor_s(path):
    """Returns the time of the machine's clock that a record's times count from [s]."""
    with open(path, "rb") as file:
        for metadata in make_reader(file).iter_metadata():
            if metadata.name == "murmurate.run":
                return int(metadata.metadata["anchor_ns"]) / 1e9
    raise SystemExit(f"{path}: no record")


def rows(program, path, flag):
    """Returns the rows of one of a record's tables, with the machine's time in place of the record's."""
    start = anchor_s(path)
    with tempfile.NamedTemporaryFile(suffix=".csv") as table:
        subprocess.run([program, "record", "export", path, flag, table.name], check=True, capture_output=True)
        with open(table.name) as file:
            return [row | {"at": start + float(row["time_s"])} for row in csv.DictReader(file)]


def quantile(ordered, share):
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def delivery(program, folder):
    published, arrived, robots = {}, [], set()
    for path in sorted(glob.glob(f"{folder}/*.mcap")):
        for row in rows(program, path, "--messages"):
            if row["kind"] != "Latent":
                continue
            if row["event"] == "published":
                published.setdefault(int(row["sender"]), []).append(row["at"])
                robots.add(row["host"])
            else:
                arrived.append((row["host"], int(row["sender"]), row["at"]))
    delays = []
    # Other hosts may get them, too, and do nothing with them.
    for sender, at in [(sender, at) for host, sender, at in arrived if host in robots]:
        times = published.get(sender, [])
        before = bisect.bisect_right(times, at)
        if before:
            delays.append(1e3 * (at - times[before - 1]))
    delays.sort()
    sent = sum(len(times) for times in published.values()) * (len(published) - 1)
    print(
        f"latents: {len(delays)} of {sent} arrived ({len(delays) / sent:.1%}); "
        f"ms p50 {quantile(delays, 0.5):.2f}, p90 {quantile(delays, 0.9):.2f}, p99 {quantile(delays, 0.99):.2f}"
    )


def outage(program, folder, begins, ends):
    (path,) = glob.glob(f"{folder}/world*.mcap")
    trajectories = rows(program, path, "--trajectories")

    def times(x, y):
        """Returns when any robot has this velocity, in order, and which robots had it just before the outage."""
        fast = [row for row in trajectories if (float(row[x]) ** 2 + float(row[y]) ** 2) ** 0.5 > STANDS_M_S]
        before = {row["robot"] for row in fast if begins - 0.5 < row["at"] <= begins}
        return sorted(row["at"] for row in fast), before

    driven, before = times("command_x_m_s", "command_y_m_s")
    moved, _ = times("vx_m_s", "vy_m_s")
    last = [max(at for at in all if at <= ends) - begins for all in (driven, moved)]
    again = min((at for at in driven if at > ends), default=float("inf")) - ends
    print(
        f"{len(before)} robots were driven when the router was killed; the last command to move ended "
        f"{last[0] * 1e3:.0f} ms later, the last one stood after {last[1] * 1e3:.0f} ms; "
        f"driven again {again:.1f} s after the router was back"
    )
    if len(before) < 2 or last[0] > DRIVEN_FOR_S or last[1] > MOVES_FOR_S or again == float("inf"):
        print(f"MISSED: none is driven after {DRIVEN_FOR_S} s nor moves after {MOVES_FOR_S} s, and all go on")
        raise SystemExit(1)


if __name__ == "__main__":
    what, program, folder, *times = sys.argv[1:]
    if what == "delivery":
        delivery(program, folder)
    else:
        outage(program, folder, *map(float, times))
