#!/usr/bin/env bash
# Records of three hosts in network namespaces of their own, whose clocks are 0, +200 and -200 ms off: `record merge` has to
# find that. Exit code 1 if it is more than a millisecond off. Needs root and Debian's faketime.
#
#   bash tests/peers/record/clocks.sh MURMURATE
set -euo pipefail
cd "$(dirname "$0")/../../.."
program=$(realpath "$1")
library=$(ls /usr/lib/*/faketime/libfaketimeMT.so.1)
work=$(mktemp -d)
undo() {
    for name in 0 1 2 b; do ip netns del "mmc$name" 2>/dev/null || true; done
    rm -rf "$work"
}
trap undo EXIT
"$program" key new --out "$work/key" >/dev/null
ip netns add mmcb
ip -n mmcb link add br0 type bridge mcast_snooping 0
ip -n mmcb link set br0 up
hosts=(agent-0 agent-1 world) clocks=(+0 +0.2 -0.2)
for at in 0 1 2; do
    ip netns add "mmc$at"
    ip link add veth netns "mmc$at" type veth peer name "port$at" netns mmcb
    ip -n mmcb link set "port$at" master br0 up
    ip -n "mmc$at" addr add "10.9.0.$((at + 1))/24" dev veth
    ip -n "mmc$at" link set veth up
    ip -n "mmc$at" route add 224.0.0.0/4 dev veth
done
for at in 0 1 2; do
    # The real clock alone: the monotonic one is what robots are driven by.
    ip netns exec "mmc$at" env LD_PRELOAD="$library" FAKETIME="${clocks[$at]}" FAKETIME_DONT_FAKE_MONOTONIC=1 \
        "$program" host teams/offboard.toml --set robots=2 --set episodes=3 --interface veth --host "${hosts[$at]}" \
        --key-file "$work/key" --record "$work/records" >/dev/null 2>"$work/said.$at" &
done
wait
"$program" record merge "$work/records" -o "$work/run.mcap" | tee "$work/found"
awk '/^agent-1/ { d = $2 - 200 } /^world/ { e = $2 + 200 } END { exit !(d < 1 && d > -1 && e < 1 && e > -1) }' \
    "$work/found" || { echo "FAILED: the clocks are 0, +200 and -200 ms off"; exit 1; }
