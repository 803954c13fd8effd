#!/usr/bin/env python3
"""Compares a fitted model with what is known of the run: known.py ROWS.json LAG_S DELAY_MS LOSS_PERCENT."""

import json
import sys

rows = {row["name"]: row["predicted"]["value"] for row in json.load(open(sys.argv[1]))}
lag, delay, loss = map(float, sys.argv[2:])
missed = False
print()
for name, known, bar in [
    ("drivetrain lag", lag, 0.05),
    ("all links, delay", delay, 2.0),
    ("all links, loss", loss, 2.0),
    *((name, delay, 2.0) for name in rows if name.startswith("link ") and name.endswith("delay")),
    *((name, loss, 2.0) for name in rows if name.startswith("link ") and name.endswith("loss")),
]:
    off = abs(rows[name] - known)
    print(f"{name}: fitted {rows[name]:.3f}, known {known}" + ("" if off <= bar else ": MISSED"))
    missed |= off > bar
sys.exit(missed)
