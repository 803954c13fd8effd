#!/usr/bin/env bash
# Alert rules against promtool, and against a real Prometheus with a team of six hosts, of which one is killed and which
# is then stopped. `alerts.sh PROGRAM`, with Debian's package prometheus installed.
set -euo pipefail
. "$(dirname "$0")/begin.sh"

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
