"""Judges a policy file for `coverage` or `coverage-table` against its scripted baselines on worlds that nobody has chosen.

Each world is an episode of a seed of its own; the seeds begin at the beginning of the file's SHA-256. All policies get the same
worlds. The ratio is that of the mean costs, the policy's to the decentralised baseline's. Its interval is of 10 000 bootstrap
samples of the worlds, drawn in pairs. The baselines that know more than a robot can are run in lock step alone.

    python3 policies/judge_coverage.py FILE [--scenario coverage] [--program target/release/murmurate] [--worlds 100] [--jobs 2]
"""

import concurrent.futures
import pathlib
import random
import statistics

from judging import chosen, parser, sim

BASELINE = "coverage-cvt"
OTHERS = ["coverage-centralised", "coverage-clairvoyant"]
MODES = {
    "lock step": ["--mode", "sim"],
    "`onboard-adhoc`, 20 ms, 16 % lost": ["--mode", "onboard-adhoc", "--delay-ms", "20", "--loss", "0.16"],
}


def interval(own: list[float], other: list[float]) -> tuple[float, float]:
    """The ends of the 95 % interval of the ratio of mean costs, by the bootstrap over pairs."""
    draw = random.Random(0)
    worlds = range(len(own))
    ratios = []
    for _ in range(10_000):
        drawn = draw.choices(worlds, k=len(own))
        ratios.append(sum(own[world] for world in drawn) / sum(other[world] for world in drawn))
    ratios.sort()
    return ratios[249], ratios[9749]


def main() -> None:
    flags = parser(__doc__)
    flags.add_argument("--scenario", default="coverage")
    flags.add_argument("--worlds", type=int, default=100)
    flags.add_argument("--jobs", type=int, default=2)
    given = flags.parse_args()
    digest, first = chosen(given.policy)
    print(f"`{given.policy.name}`, SHA-256 {digest[:16]}..., {given.worlds} worlds, seeds from {first}\n")
    print("| conditions | policy | mean cost [m²] | ratio to the decentralised baseline | 95 % | cheaper worlds | not completed |")
    print("|---|---|---|---|---|---|---|")

    def run(policy: str, mode: list[str], world: int) -> dict:
        return sim(given.program, "--scenario", given.scenario, "--policy", policy, "--episodes", "1", "--jobs", "1",
                   "--seed", str(first + world), *mode)

    lockstep = next(iter(MODES))
    rows = [(conditions, policy) for conditions in MODES for policy in [BASELINE, str(given.policy)]]
    rows += [(lockstep, policy) for policy in OTHERS]
    baseline: dict[str, list[float]] = {}
    with concurrent.futures.ThreadPoolExecutor(given.jobs) as pool:
        for conditions, policy in rows:
            found = list(pool.map(lambda world: run(policy, MODES[conditions], world), range(given.worlds)))
            own = [episode["cost_mean"] for episode in found]
            other = baseline.setdefault(conditions, own)
            failed = sum(1 - episode["completed"] for episode in found)
            low, high = interval(own, other)
            cheaper = sum(one < two for one, two in zip(own, other))
            ratio = statistics.mean(own) / statistics.mean(other)
            print(f"| {conditions} | `{pathlib.Path(policy).name}` | {statistics.mean(own):.6g} | {ratio:.4f} "
                  f"| {low:.4f} to {high:.4f} | {cheaper} of {given.worlds} | {failed} |", flush=True)


if __name__ == "__main__":
    main()
