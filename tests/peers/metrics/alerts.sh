#!/usr/bin/env bash
# Alert rules against promtool, and against a real Prometheus with a team of six hosts, of which one is killed and which
# is then stopped. `alerts.sh PROGRAM`, with Debian's package prometheus installed.
set -euo pipefail
program=$(realpath "$1")
root=$(cd "$(dirname "$0")/../../.." && pwd)
for needed in prometheus promtool curl python3; do
    command -v "$needed" > /dev/null || { echo "$needed is missing: apt-get install prometheus curl python3" >&2; exit 2; }
done
work=$(mktemp -d)
pids=()
finish() {
    for pid in "${pids[@]}"; do kill -INT "$pid" 2> /dev/null || true; done
    wait || true
    rm -rf "$work"
}
trap finish EXIT

(cd "$root/packaging/prometheus" && promtool check rules alerts.yml && promtool test rules alerts_test.yml)
# Every trigger that a rule names is one of the program's.
grep -o 'trigger="[^"]*"' "$root/packaging/prometheus/alerts.yml" | sort -u | while IFS='"' read -r _ name _; do
    grep -qF "\"$name\"" "$root/src/messages/trigger.rs" || { echo "FAILED: no trigger '$name'" >&2; exit 1; }
done

# The example as it is, but for addresses.
ports=(world:10.0.0.9:19471 agent-0:10.0.0.10:19472 agent-1:10.0.0.11:19473 agent-2:10.0.0.12:19474
    agent-3:10.0.0.13:19475 agent-4:10.0.0.14:19476)
cp "$root"/packaging/prometheus/{prometheus,alerts}.yml "$work"
"$program" key new --out "$work/metrics.token" > /dev/null
for entry in "${ports[@]}"; do
    IFS=: read -r host address port <<< "$entry"
    sed -i "s/\"$address:9464\"/\"127.0.0.1:$port\"/" "$work/prometheus.yml"
    "$program" host "$root/teams/offboard.toml" --host "$host" --set team=4714 --set episodes=1000 --json \
        --metrics "127.0.0.1:$port" --metrics-token-file "$work/metrics.token" > /dev/null 2> "$work/$host" &
    pids+=($!)
done
promtool check config "$work/prometheus.yml"
prometheus --config.file="$work/prometheus.yml" --storage.tsdb.path="$work/data" \
    --web.listen-address=127.0.0.1:19091 --log.level=error 2> "$work/prometheus.log" &
pids+=($!)
python3 "$root/tests/peers/metrics/alerts.py" http://127.0.0.1:19091 "${pids[1]}" \
    "$program" stop "$root/teams/offboard.toml" --set team=4714
