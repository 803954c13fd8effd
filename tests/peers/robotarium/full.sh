# Runs the commands of docs/robotarium.md: both exported folders and both teams in the Robotarium's simulator, 20 episodes each.
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
    "$murmurate" host "examples/robotarium/$task-team.toml" --host sim --json >"$work/$task.jsonl"
    successes=$(grep -c '"verdict":"success"' "$work/$task.jsonl" || true)
    echo "$task by the driver program: $successes of 20"
    judge "$repository/$task.json"
    rm -f "$repository/$task.json"
    [ "$successes" -ge 18 ]
done
