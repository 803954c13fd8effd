"""Judges a policy file, or a file of roles, for a task against a scripted one, on layouts of seeds from the file's SHA-256.

Each layout is a run of one episode, so that both policies have the same starts and goals. The conditions are those of
`onboard-adhoc` with a lag of 0.5 s, 20 ms, a loss of 16 % and the safety filter.

    python3 policies/judge_task.py FILE TASK [--program target/release/murmurate] [--layouts 2000] [--against orca] [-- FLAGS]

FLAGS are further flags of `sim`, such as `--robots 12`.
"""

import concurrent.futures
import statistics
import sys

from judging import CONDITIONS, chosen, parser, sim, wilson


def main() -> None:
    flags = parser(__doc__)
    flags.add_argument("task")
    flags.add_argument("--layouts", type=int, default=2000)
    flags.add_argument("--against", default="orca")
    flags.add_argument("--jobs", type=int, default=2)
    end = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    given, more = flags.parse_args(sys.argv[1:end]), sys.argv[end + 1 :]
    digest, first = chosen(given.policy)

    def run(policy: str, seed: int) -> dict:
        kind = "--roles" if policy.endswith(".toml") else "--policy"
        return sim(given.program, "--scenario", given.task, kind, policy, "--seed", str(seed), "--episodes", "1",
                   *CONDITIONS, *more)

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
