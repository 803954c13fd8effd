"""Judges a policy file for `passage` on layouts that nobody has chosen: the seed is the beginning of the file's SHA-256.

Prints a table in Markdown: the seven columns of `study modes` with five robots, without and with the safety filter; the
column `onboard-adhoc` for other teams and gaps; and five robots with more lag, delay and loss.

    python3 policies/judge.py FILE [--program target/release/murmurate] [--layouts 2000] [--out FOLDER]
"""

import json
import pathlib
import subprocess
import tempfile

from judging import chosen, parser

SIZES = [2, 3, 4, 6, 8, 10, 12]
GAPS = [(5, 0.8), (5, 1.2), (8, 0.8), (8, 1.2)]
# Lag [s], delay [ms], loss [%].
HARD = [(0.5, 20, 16), (0.7, 20, 16), (0.5, 100, 30)]


def row(what: str, handling: str, found: dict) -> None:
    low, high = (100 * end for end in found["success_ci95"])
    makespan = found["makespan_median_s"]
    seconds = "-" if makespan is None else f"{makespan:.2f} s"
    print(f"| {what} | {handling} | {100 * found['success_rate']:.2f} | {low:.1f} to {high:.1f} | {seconds} |", flush=True)


def run(args: list[str]) -> bytes:
    return subprocess.run(args, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL).stdout


def main() -> None:
    flags = parser(__doc__)
    flags.add_argument("--layouts", type=int, default=2000)
    flags.add_argument("--out", type=pathlib.Path, help="folder that keeps the studies")
    given = flags.parse_args()
    digest, seed = chosen(given.policy)
    out = given.out or pathlib.Path(tempfile.mkdtemp(prefix="judge-"))
    print(f"`{given.policy.name}`, SHA-256 {digest[:16]}..., seed {seed}, {given.layouts} layouts a row\n")
    print("| what | handling | success [%] | 95 % | median makespan |\n|---|---|---|---|---|")

    def study(name: str, handling: str, *flags: str) -> list[dict]:
        folder = out / f"{name}-{handling}"
        run([given.program, "study", "modes", "--policy", str(given.policy), "--handling", handling, "--repeats", "1",
             "--layouts", str(given.layouts), "--seed", str(seed), "--out", str(folder), *flags])
        return json.loads((folder / "columns.json").read_text())

    for handling in ["default", "filtered"]:
        for column in study("modes", handling):
            row(f"5 robots, `{column['name']}`", handling, column)
    for robots in SIZES:
        for column in study(f"robots-{robots}", "filtered", "--columns", "onboard-adhoc", "--robots", str(robots)):
            row(f"{robots} robots", "filtered", column)
    for robots, gap in GAPS:
        flags = ["--columns", "onboard-adhoc", "--robots", str(robots), "--gap-m", str(gap)]
        for column in study(f"robots-{robots}-gap-{gap}", "filtered", *flags):
            row(f"{robots} robots, gap {gap} m", "filtered", column)
    for lag, delay, loss in HARD:
        for safety in ["emulated", "deployed"]:
            text = run([given.program, "sim", "--policy", str(given.policy), "--mode", "onboard-adhoc", "--contacts", "judge",
                        "--wall-radius-m", "0.16", "--clamp", "deployed", "--lag-s", str(lag), "--delay-ms", str(delay),
                        "--loss", str(loss / 100), "--safety", safety, "--episodes", str(given.layouts), "--repeats", "1",
                        "--seed", str(seed), "--json"])
            row(f"5 robots, lag {lag} s, {delay} ms, {loss} %", f"--safety {safety}", json.loads(text))


if __name__ == "__main__":
    main()
