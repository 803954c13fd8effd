# Runs the commands of docs/robotarium.md: both exported folders and the team of `passage` in the Robotarium's simulator.
# Fails if its validator complains, or if fewer than 18 of 20 episodes succeed. PATH has a python3 with `rps`.
set -euo pipefail
murmurate=$(realpath "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
repository=$(pwd)

judge() {
    python3 - "$1" <<'PY'
import json, sys
results = json.load(open(sys.argv[1]))
assert not results["complaints"], results["complaints"]
assert results.get("successes", 20) >= 18, results
PY
}

"$murmurate" export robotarium --policy policies/warehouse.safetensors --task examples/robotarium/warehouse.toml "$work/warehouse"
"$murmurate" export robotarium --policy shipped --task passage --scale 0.47 --hull-m 0.06 --robots 4 "$work/passage"
for task in warehouse passage; do
    python3 "$work/$task/check.py"
    (cd "$work/$task" && python3 main.py --headless && judge results.json)
done

for task in warehouse passage; do
    "$murmurate" doctor "examples/robotarium/$task-team.toml" --host sim
done
"$murmurate" host examples/robotarium/passage-team.toml --host sim --json | tee "$work/team.jsonl" | tail -1
judge "$repository/passage.json"
rm -f "$repository/passage.json" "$repository/warehouse.json"
