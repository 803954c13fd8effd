#!/usr/bin/env bash
# Compares the link with raw multicast and with Cyclone DDS (best effort), interleaved, and prints medians and ratios.
#
#   NETPEERS=/path/to/harness netpeer/compare.sh [PEER ...]       default: raw cyc-be and the `netpeer` of netpeer/
#
# NETPEERS is a copy of the harness (run.sh, peers.txt) with its peers built into $NETPEERS/.build or $BUILD. Needs root
# (network namespaces, named after NP_PREFIX, default `mn`). ROUNDS (5), SECONDS_EACH (4) and CASES ("N:RATE ...")
# choose what is measured, PROFILE (release) how the example is built, `robot` with link-time optimisation; OUT keeps
# every run as a line of JSON. NP_ROBOT=0 leaves out what robots send beside messages, as the other peers do; SENDER=1 also
# measures the `netpeer` with keys of members. Skips, saying so, where the harness is absent.
set -euo pipefail
cd "$(dirname "$0")/.."

harness=${NETPEERS:-}
if [ -z "$harness" ] || [ ! -x "$harness/run.sh" ]; then
    echo "skipped: NETPEERS names no folder with the messaging harness (run.sh)"
    exit 0
fi
if [ "$(id -u)" != 0 ]; then
    echo "skipped: network namespaces need root"
    exit 0
fi
export BUILD=${BUILD:-$harness/.build} NP_PREFIX=${NP_PREFIX:-mn} NP_KEEP_TOPO=1
profile=${PROFILE:-release}
ours=$PWD/target/$profile/examples/netpeer
peers=("$@")
if [ ${#peers[@]} = 0 ]; then
    cargo build --quiet --profile "$profile" --example netpeer
    peers=(raw cyc-be "$ours")
    [ -z "${SENDER:-}" ] || peers+=("env NP_AUTH=sender $ours")
fi
rounds=${ROUNDS:-5}
seconds=${SECONDS_EACH:-4}
cases=${CASES:-5:60 5:200 5:500 5:5000}
out=${OUT:-$(mktemp)}
trap '"$harness/topo.sh" down' EXIT
for ((round = 1; round <= rounds; round++)); do
    for case in $cases; do
        for peer in "${peers[@]}"; do
            "$harness/run.sh" "$peer" "${case#*:}" 0 "$seconds" "${case%:*}" >>"$out"
        done
    done
done
python3 - "$out" "${peers[0]}" <<'PYTHON'
import json, re, statistics, sys

rows = {}
for line in open(sys.argv[1]):
    run = json.loads(line)
    rows.setdefault((run["n"], run["rate"]), {}).setdefault(run["peer"], []).append(run)
fields = {"p50_us": 1, "p99_us": 1, "cpu_s_per_1k": 1e3, "delivered": 100, "pkts_per_msg": 1, "other_cpu": 1}
print(f"{'N':>3} {'msg/s':>6} {'peer':26} {'p50 us':>8} {'p99 us':>8} {'cpu us':>8} {'deliv %':>8} {'frames':>7} {'other':>6}"
      "   p50 x  cpu x")
for (n, rate), peers in sorted(rows.items()):
    medians = {}
    for peer, runs in peers.items():
        found = {field: [run[field] for run in runs if run.get(field) is not None] for field in fields}
        medians[peer] = {f: statistics.median(v) * fields[f] if v else float("nan") for f, v in found.items()}
    first = medians.get(sys.argv[2])
    for peer, m in medians.items():
        ratios = "" if first is None else f"{m['p50_us'] / first['p50_us']:7.2f} {m['cpu_s_per_1k'] / first['cpu_s_per_1k']:6.2f}"
        print(f"{n:3} {rate:6.0f} {re.sub(r'[^ ]*/', '', peer)[:26]:26} {m['p50_us']:8.1f} {m['p99_us']:8.1f} "
              f"{m['cpu_s_per_1k']:8.1f} {m['delivered']:8.2f} {m['pkts_per_msg']:7.2f} {m['other_cpu']:6.2f}  {ratios}")
PYTHON
