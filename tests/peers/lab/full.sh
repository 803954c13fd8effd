#!/usr/bin/env bash
# How true the lab is: real time beside virtual time and beside Bianchi's model, and the load that this machine carries.
#
#   tests/peers/lab/full.sh PROGRAM        10 minutes, root, /dev/net/tun; SECONDS_EACH (5)
#
# A row that misses a bar says NO; the last part looks for the load at which that happens.
set -euo pipefail
program=${1:?the program to measure}
seconds=${SECONDS_EACH:-5}
echo "== 5 and 10 stations, 30 to 90 % of saturation, and saturation itself"
"$program" lab check --seconds "$seconds" || echo "-- not every bar is met"
echo
echo "== the load that this machine carries: multicast at the rate of unicast, more and more receivers"
"$program" lab check --preset wifi-n --fast-multicast --casts multicast --stations 5,10,20,40,80 --loads 30,60,90 \
    --seconds "$seconds" || echo "-- the rows with NO are beyond it"
