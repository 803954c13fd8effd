#!/usr/bin/env bash
# Metrics against a real Prometheus: the page of a simulation and a host of a team, scraped for a while; every query of
# the Grafana dashboard is put to it. `full.sh PROGRAM`, with Debian's package prometheus installed.
set -euo pipefail
. "$(dirname "$0")/begin.sh"

"$program" sim --watch --mode offboard --episodes 1000 --quiet --listen 127.0.0.1:19464 > /dev/null 2> "$work/sim" &
pids+=($!)
"$program" host "$root/teams/offboard.toml" --host world --set team=4711 --metrics 127.0.0.1:19465 --json \
    2> "$work/host" > /dev/null &
pids+=($!)
"$program" key new --out "$work/token" > /dev/null
"$program" host "$root/teams/offboard.toml" --host agent-0 --set team=4711 --metrics 0.0.0.0:19466 --json \
    --metrics-token-file "$work/token" 2> "$work/robot" > /dev/null &
pids+=($!)

for port in 19464 19465 19466; do
    for _ in $(seq 100); do
        curl -fsS "http://127.0.0.1:$port/healthz" > /dev/null 2>&1 && break
        read -rt 0.1 < <(:) || true
    done
    echo "healthz of $port: $(curl -fsS "http://127.0.0.1:$port/healthz")"
done
[ "$(curl -s -o /dev/null -w '%{http_code}' http://127.0.0.1:19466/metrics)" = 401 ]
curl -fsS http://127.0.0.1:19464/metrics > "$work/metrics.txt"
promtool check metrics < "$work/metrics.txt"
curl -fsS http://127.0.0.1:19465/metrics | promtool check metrics

cat > "$work/prometheus.yml" <<END
global: { scrape_interval: 1s }
scrape_configs:
  - job_name: murmurate
    static_configs: [{ targets: ['127.0.0.1:19464', '127.0.0.1:19465'] }]
  - job_name: guarded
    authorization: { credentials_file: $work/token }
    static_configs: [{ targets: ['127.0.0.1:19466'] }]
END
promtool check config "$work/prometheus.yml"
prometheus --config.file="$work/prometheus.yml" --storage.tsdb.path="$work/data" \
    --web.listen-address=127.0.0.1:19090 --log.level=error 2> "$work/prometheus.log" &
pids+=($!)
python3 "$root/tests/peers/metrics/check.py" http://127.0.0.1:19090 "$root/packaging/grafana/murmurate.json"
