#!/usr/bin/env bash
# Two bases with one namespace would both be driven: doctor says so by the publishers and subscribers that DDS counts.
source "$(dirname "$0")/lib_devices.sh"
[ "${INSIDE:-}" ] || INSIDE=1 exec unshare -n bash "$here/$(basename "$0")" "$@"
ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo || fail "no namespace: is this root?"
ros_team
start lib_ros.py good /r0
start lib_ros.py good /r0
sleep 2
check "two robots" --robot 0 5 1 "2 publishers of /r0/odom, 2 subscribers of /r0/cmd_vel: two robots have one namespace; both would be driven"
