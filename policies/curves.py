"""Draws success against minutes of training, for the `curve.csv` of one or more trainings by `murmurate train`.

    python3 policies/curves.py published=runs/published robust=runs/robust --out curves.svg

Each argument is a label and the folder of a training. Drawn are the checks that a training makes on the way: the share of
layouts in which the team succeeds, in lock step with perfect messages and under the conditions of the training. With
`--episodes` it is the share of the training's own episodes, over decisions. Then labels are `PANEL/LABEL`, and each panel has a
picture of its own:

    python3 policies/curves.py --episodes passage/one=runs/one passage/three=runs/three --out curves.svg

Needs matplotlib.
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


def episodes(folder: pathlib.Path) -> tuple[list[float], list[float]]:
    """Millions of decisions, and success [%] of the training's own episodes, each the mean of ten iterations."""
    with open(folder / "curve.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["success"] != "NaN"]
    success = [100 * float(row["success"]) for row in rows]
    means = [sum(success[max(0, at - 9) : at + 1]) / min(10, at + 1) for at in range(len(rows))]
    return [int(row["decisions"]) / 1e6 for row in rows], means


def panels(trainings: list[str], parser: argparse.ArgumentParser) -> dict[str, dict[str, pathlib.Path]]:
    """Folders of the trainings by panel and label."""
    found: dict[str, dict[str, pathlib.Path]] = {}
    for training in trainings:
        label, equals, folder = training.partition("=")
        panel, slash, name = label.partition("/")
        if not equals or not slash:
            parser.error(f"'{training}' is not PANEL/LABEL=FOLDER")
        found.setdefault(panel, {})[name] = pathlib.Path(folder)
    return found


def draw_episodes(given: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Draws one picture for each panel, side by side."""
    all_panels = panels(given.trainings, parser)
    figure, axes = plt.subplots(1, len(all_panels), figsize=(10, 4), sharey=True, squeeze=False)
    for axis, (panel, trainings) in zip(axes[0], all_panels.items()):
        for label, folder in trainings.items():
            axis.plot(*episodes(folder), label=label)
        axis.set(title=panel, xlabel="decisions [million]", ylim=(0, 100))
        axis.grid(alpha=0.3)
        axis.legend()
    axes[0][0].set_ylabel("success of the training's episodes [%]")
    figure.tight_layout()
    figure.savefig(given.out, metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("trainings", nargs="+", metavar="LABEL=FOLDER")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("curves.svg"))
    parser.add_argument("--episodes", action="store_true", help="the trainings' own episodes, over decisions")
    given = parser.parse_args()
    # The same data give the same file.
    plt.rcParams["svg.hashsalt"] = "murmurate"
    if given.episodes:
        draw_episodes(given, parser)
        return
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
