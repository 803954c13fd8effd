"""Draws success against minutes of training, for the `curve.csv` of one or more trainings by `murmurate train`.

    python3 policies/curves.py published=runs/published robust=runs/robust --out curves.svg

Each argument is a label and the folder of a training. Drawn are the checks that a training makes on the way: the share of
128 layouts in which the team succeeds, in lock step with perfect messages and under the conditions of the training. Needs
matplotlib.
"""

import argparse
import csv
import pathlib

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

CHECKS = {"perfect_success": "lock step, perfect messages", "disturbed_success": "conditions of the training"}


def checks(folder: pathlib.Path, column: str) -> tuple[list[float], list[float]]:
    """Minutes and success [%] of a training's checks."""
    with open(folder / "curve.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row[column]]
    return [float(row["elapsed_s"]) / 60 for row in rows], [100 * float(row[column]) for row in rows]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("trainings", nargs="+", metavar="LABEL=FOLDER")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("curves.svg"))
    given = parser.parse_args()
    # The same data give the same file.
    plt.rcParams["svg.hashsalt"] = "murmurate"
    figure, axes = plt.subplots(1, len(CHECKS), figsize=(10, 4), sharey=True)
    for axis, (column, title) in zip(axes, CHECKS.items()):
        for training in given.trainings:
            label, found, folder = training.partition("=")
            if not found:
                parser.error(f"'{training}' is not LABEL=FOLDER")
            minutes, success = checks(pathlib.Path(folder), column)
            axis.plot(minutes, success, label=label)
        axis.set(title=title, xlabel="minutes", ylim=(0, 100))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("success [%]")
    axes[0].legend()
    figure.tight_layout()
    figure.savefig(given.out, metadata={"Date": None})


if __name__ == "__main__":
    main()
