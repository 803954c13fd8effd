#!/usr/bin/env bash
# gpsd is given by the name of its host, which gets another address while the program runs: the old one falls silent, without
# an end of its connection. Expected: the name is resolved again, and readings come from the new address.
[ "${INSIDE:-}" ] || INSIDE=1 exec unshare --net --mount bash "$0" "$@"
source "$(dirname "$0")/lib_devices.sh"
port=29881
ip link set lo up || fail "network namespaces need root and ip"
# The name is in a hosts file of these namespaces alone.
at() { printf '127.0.0.1 localhost\n%s receiver\n' "$1" >"$CASE_WORK/hosts"; }
at 127.0.1.1
mount --bind "$CASE_WORK/hosts" /etc/hosts || fail "a mount needs root"

gpsd_team $port 'heading = "none"'
sed -i "s/address = \"127.0.0.1:/address = \"receiver:/" team.toml
start lib_gpsd.py good $port 127.0.1.1
start lib_gpsd.py good $port 127.0.2.1
listens 127.0.1.1
listens 127.0.2.1
(
    sleep 3
    at 127.0.2.1
    kill -STOP "${fakes[0]}"
) &
# Without its name, a silent connection is given up after 5 s: too late for this check.
doctor --robot 0 --listen 7
kill -CONT "${fakes[0]}"
expect "another address" 0 "ok   robot 0, source gpsd:"
