#!/usr/bin/env bash
# A rigid body without a pose costs itself: one of nobody costs no robot, one of a robot costs that robot alone.
source "$(dirname "$0")/lib_devices.sh"
port=27301
natnet_team $port
for scene in foreign_zero foreign_nan nearly_unit; do
    natnet $scene 3 0 "robot 0, source natnet:"
    expect $scene 0 "robot 1, source natnet:"
done
natnet foreign_zero 3 0 "rigid body 99"
[ "$(grep -c 'rigid body 99' <<<"$said")" = 1 ] || fail "more than a line about body 99" "$said"
natnet own_zero 3 1 "no reading of robot 0 in 3 s" "its rotation is all zero"
expect own_zero 1 "ok   robot 1, source natnet:"
natnet own_nan_at_times 4 0 "robot 0, source natnet" "its position is not finite"
expect own_nan_at_times 0 "ok   robot 1, source natnet"
