#!/usr/bin/env bash
# A captured member of a team whose members have keys of their own attacks through a real Zenoh router on this machine, and the team
# is stopped again and again. Exit code 1 if a stop fails or is undone.
#
#   bash tests/peers/zenoh/captured.sh PYTHON [STOPS [RATE]]
#
# PYTHON has eclipse-zenoh. RATE datagrams a second are forged, 2000 unless told: a session drops what it has no room for.
set -euo pipefail
here=$(realpath "$(dirname "$0")")
python=$1 stops=${2:-20} rate=${3:-2000} router=
log=$(mktemp)

end() {
    [ -z "$router" ] || kill -9 "$router" 2>/dev/null || true
    rm -f "$log"
}
trap end EXIT
trap 'exit 130' INT TERM

"$python" "$here/router.py" udp/127.0.0.1:7447 >"$log" 2>&1 &
router=$!
until grep -q '^router' "$log"; do
    kill -0 "$router" 2>/dev/null || { cat "$log"; exit 1; }
    sleep 0.1
done
cd "$here/../../.."
TESTS_MUST="zenoh " MURMURATE_ROUTER=udp/127.0.0.1:7447 MURMURATE_CAPTURED="$stops $rate" \
    cargo test --locked --package murmurate-cli --features zenoh --test live -- captured::nor_does_one_through --nocapture
