"""Curves of trainings in one picture: the share of episodes in which all robots arrived, against minutes.

    python python/examples/curves.py NAME=curve.csv [NAME=curve.csv ...] --out curves.svg

The files are those of `--curve` of the examples beside this file.
"""

import argparse
import csv

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt  # noqa: E402

if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("curves", nargs="+", metavar="NAME=FILE.csv")
    parser.add_argument("--out", default="curves.svg")
    arguments = parser.parse_args()
    # Names in the file that do not change from run to run.
    plt.rcParams["svg.hashsalt"] = "curves"
    fig, axes = plt.subplots(figsize=(7, 3.5))
    for given in arguments.curves:
        name, _, file = given.partition("=")
        if not file:
            parser.error(f"'{given}' is not NAME=FILE.csv")
        with open(file, newline="") as lines:
            rows = list(csv.DictReader(lines))
        axes.plot([float(row["minutes"]) for row in rows], [100 * float(row["all_arrived"]) for row in rows], label=name)
    axes.set(xlabel="minutes", ylabel="episodes in which all arrived [%]", ylim=(0, 100))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    fig.tight_layout()
    fig.savefig(arguments.out, metadata={"Date": None})
