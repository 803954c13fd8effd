#!/usr/bin/env bash
# Odometry whose orientation is all zero, or not of unit length, is named with its topic, and is no fault of the network.
source "$(dirname "$0")/lib_devices.sh"
[ "${INSIDE:-}" ] || INSIDE=1 exec unshare -n bash "$here/$(basename "$0")" "$@"
ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo || fail "no namespace: is this root?"
ros_team
look() { # SCENE CODE WORD...
    start lib_ros.py "$1" /r0
    sleep 2
    check "$1" --robot 0 4 "${@:2}"
    ! grep -q "no odometry is heard" <<<"$said" || fail "$1: the network is blamed" "$said"
}
look zero 1 "robot 0, driver ros2" "/r0/odom: its orientation is all zero; correct its sender"
look half 1 "robot 0, driver ros2" "/r0/odom" "its orientation is not a unit quaternion; correct its sender"
look nan 1 "robot 0, driver ros2" "/r0/odom" "correct its sender"
look good 0 "robot 0, driver ros2: ready"
