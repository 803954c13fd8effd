"""Judges a policy file for `swap` against `orca` on places that nobody has chosen: seeds from the beginning of the file's SHA-256.

Episodes of one seed share their places and differ in who starts where, so the table is over many seeds. The conditions are
those of `onboard-adhoc` with a lag of 0.5 s, 20 ms, a loss of 16 % and the safety filter.

    python3 policies/judge_swap.py FILE [--program target/release/murmurate] [--seeds 40] [--episodes 50]
"""

import math
import statistics

from judging import CONDITIONS, chosen, parser, sim, wilson

SIZES = [4, 8, 16]


def main() -> None:
    flags = parser(__doc__)
    flags.add_argument("--seeds", type=int, default=40)
    flags.add_argument("--episodes", type=int, default=50)
    given = flags.parse_args()
    digest, first = chosen(given.policy)
    print(f"`{given.policy.name}`, SHA-256 {digest[:16]}..., {given.seeds} seeds from {first}, {given.episodes} episodes each\n")
    print("| robots | policy | success [%] | 95 % | contacts | mean of the median makespans | faster than `orca` |")
    print("|---|---|---|---|---|---|---|")
    for robots in SIZES:
        medians = {}
        for name, policy in [("orca", "orca"), (given.policy.name, str(given.policy))]:
            found = [sim(given.program, "--scenario", "swap", "--robots", str(robots), "--policy", policy, "--episodes",
                         str(given.episodes), "--seed", str(first + seed), *CONDITIONS) for seed in range(given.seeds)]
            medians[name] = [run["makespan_median_s"] or math.inf for run in found]
            successes, episodes = (sum(run[key] for run in found) for key in ["successes", "episodes"])
            contacts = sum(run["robot_collisions"] + run["wall_collisions"] for run in found)
            faster = sum(own < orca for own, orca in zip(medians[name], medians["orca"]))
            print(f"| {robots} | `{name}` | {100 * successes / episodes:.2f} | {wilson(successes, episodes)} | {contacts} "
                  f"| {statistics.mean(medians[name]):.2f} s | {'' if name == 'orca' else f'{faster} of {given.seeds}'} |", flush=True)


if __name__ == "__main__":
    main()
