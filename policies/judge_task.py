"""Judges a policy file for a task against a scripted one on layouts that nobody has chosen: seeds from the file's SHA-256.

Each layout is a run of one episode, so that both policies have the same starts and goals. The conditions are those of
`onboard-adhoc` with a lag of 0.5 s, 20 ms, a loss of 16 % and the safety filter.

    python3 policies/judge_task.py FILE TASK [--program target/release/murmurate] [--layouts 2000] [--against orca] [-- FLAGS]

FLAGS are further flags of `sim`, such as `--robots 12`.
"""

import argparse
import concurrent.futures
import hashlib
import json
import math
import pathlib
import statistics
import subprocess
import sys

CONDITIONS = ("--mode onboard-adhoc --lag-s 0.5 --delay-ms 20 --loss 0.16 --contacts judge --wall-radius-m 0.16 "
              "--clamp deployed --safety deployed --episodes 1 --repeats 1 --json").split()


def wilson(successes: int, episodes: int) -> str:
    """Wilson's 95 % interval, in percent."""
    z, share = 1.96, successes / episodes
    middle = share + z * z / 2 / episodes
    half = z * math.sqrt(share * (1 - share) / episodes + z * z / 4 / episodes**2)
    scale = 100 / (1 + z * z / episodes)
    return f"{scale * (middle - half):.1f} to {scale * (middle + half):.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("policy", type=pathlib.Path)
    parser.add_argument("task")
    parser.add_argument("--program", default="target/release/murmurate")
    parser.add_argument("--layouts", type=int, default=2000)
    parser.add_argument("--against", default="orca")
    parser.add_argument("--jobs", type=int, default=2)
    own, _, flags = " ".join(sys.argv[1:]).partition(" -- ")
    given = parser.parse_args(own.split())
    digest = hashlib.sha256(given.policy.read_bytes()).hexdigest()
    first = int(digest[:8], 16)

    def run(policy: str, seed: int) -> dict:
        found = subprocess.run([given.program, "sim", "--scenario", given.task, "--policy", policy, "--seed", str(seed),
                                *CONDITIONS, *flags.split()], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        if not found.stdout:
            raise SystemExit(found.stderr)
        return json.loads(found.stdout)

    def runs(policy: str) -> list[dict]:
        with concurrent.futures.ThreadPoolExecutor(given.jobs) as pool:
            return list(pool.map(lambda at: run(policy, first + at), range(given.layouts)))

    print(f"`{given.policy.name}`, SHA-256 {digest[:16]}..., {given.layouts} layouts, seeds from {first}\n")
    print("| policy | success [%] | 95 % | contacts | median makespan | of the layouts that both solve |")
    print("|---|---|---|---|---|---|")
    found = {given.against: runs(given.against), given.policy.name: runs(str(given.policy))}
    pairs = [pair for pair in zip(*found.values()) if all(run["successes"] == 1 for run in pair)]
    for at, (name, results) in enumerate(found.items()):
        successes = sum(run["successes"] for run in results)
        contacts = sum(run["robot_collisions"] + run["wall_collisions"] for run in results)
        solved = [run["makespan_median_s"] for run in results if run["successes"] == 1]
        median = f"{statistics.median(solved):.2f} s" if solved else "-"
        both = f"{statistics.median(pair[at]['makespan_median_s'] for pair in pairs):.2f} s" if pairs else "-"
        share = 100 * successes / len(results)
        print(f"| `{name}` | {share:.2f} | {wilson(successes, len(results))} | {contacts} | {median} | {both} |")
    faster = sum(own["makespan_median_s"] < other["makespan_median_s"] for other, own in pairs)
    print(f"\n{len(pairs)} layouts are solved by both; on {faster} of them `{given.policy.name}` is faster.")


if __name__ == "__main__":
    main()
