"""Judges a policy file for `swap` against `orca` on places that nobody has chosen: seeds from the beginning of the file's SHA-256.

Episodes of one seed share their places and differ in who starts where, so the table is over many seeds. The conditions are
those of `onboard-adhoc` with a lag of 0.5 s, 20 ms, a loss of 16 % and the safety filter.

    python3 policies/judge_swap.py FILE [--program target/release/murmurate] [--seeds 40] [--episodes 50]
"""

import argparse
import hashlib
import json
import math
import pathlib
import statistics
import subprocess

SIZES = [4, 8, 16]
CONDITIONS = ("--mode onboard-adhoc --lag-s 0.5 --delay-ms 20 --loss 0.16 --contacts judge --wall-radius-m 0.16 "
              "--clamp deployed --safety deployed").split()


def wilson(successes: int, episodes: int) -> tuple[float, float]:
    """The ends of Wilson's 95 % interval, in percent."""
    z, share = 1.96, successes / episodes
    middle = share + z * z / 2 / episodes
    half = z * math.sqrt(share * (1 - share) / episodes + z * z / 4 / episodes**2)
    scale = 100 / (1 + z * z / episodes)
    return scale * (middle - half), scale * (middle + half)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("policy", type=pathlib.Path)
    parser.add_argument("--program", default="target/release/murmurate")
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--episodes", type=int, default=50)
    given = parser.parse_args()
    digest = hashlib.sha256(given.policy.read_bytes()).hexdigest()
    first = int(digest[:8], 16)
    print(f"`{given.policy.name}`, SHA-256 {digest[:16]}..., {given.seeds} seeds from {first}, {given.episodes} episodes each\n")
    print("| robots | policy | success [%] | 95 % | contacts | mean of the median makespans | faster than `orca` |")
    print("|---|---|---|---|---|---|---|")
    for robots in SIZES:
        medians = {}
        for name, policy in [("orca", "orca"), (given.policy.name, str(given.policy))]:
            found = [json.loads(subprocess.run(
                [given.program, "sim", "--scenario", "swap", "--robots", str(robots), "--policy", policy, "--repeats", "1",
                 "--episodes", str(given.episodes), "--seed", str(first + seed), "--json", *CONDITIONS],
                check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL).stdout) for seed in range(given.seeds)]
            medians[name] = [run["makespan_median_s"] or math.inf for run in found]
            successes, episodes = (sum(run[key] for run in found) for key in ["successes", "episodes"])
            contacts = sum(run["robot_collisions"] + run["wall_collisions"] for run in found)
            low, high = wilson(successes, episodes)
            faster = sum(own < orca for own, orca in zip(medians[name], medians["orca"]))
            print(f"| {robots} | `{name}` | {100 * successes / episodes:.2f} | {low:.1f} to {high:.1f} | {contacts} "
                  f"| {statistics.mean(medians[name]):.2f} s | {'' if name == 'orca' else f'{faster} of {given.seeds}'} |", flush=True)


if __name__ == "__main__":
    main()
