#!/usr/bin/env bash
# What five ROS 2 robots made of rclpy show: episodes of the tutorial and of the mixed team, the team as ROS messages, the
# velocity that a robot applies after something has died, such as its scanner, and forged packets at its DDS processes.
# Prints figures; exit code 1 if a bar is missed.
#
#   bash tests/peers/ros2/full.sh PYTHON MURMURATE [EPISODES] [MOMENTS]
#
# PYTHON has rclpy as in docs/ros2.md, and ros-sensor-msgs==5.5.1.
set -euo pipefail
cd "$(dirname "$0")/../../.."
python=$1 program=$2 episodes=${3:-64} moments=${4:-20} missed=0

robots= watcher=
trap 'kill $robots $watcher 2>/dev/null || true' EXIT

crosses() { # TEAM EPISODES LEAST START...: runs a team with these robots
    local team=$1 count=$2 least=$3
    shift 3
    "$python" examples/ros2_robots.py "$@" &
    robots=$!
    sleep 4
    successes=$("$program" launch "$team" --set episodes="$count" --json --quiet 2>/tmp/murmurate-hosts.log |
        grep -o '"successes":[0-9]*' | head -1 | grep -o '[0-9]*$')
    grep abandoned /tmp/murmurate-hosts.log && missed=1
    kill "$robots" && wait "$robots" 2>/dev/null || true
    echo "$team: $successes of $count episodes succeeded, bar $least"
    [ "$successes" -ge "$least" ] || missed=1
}

"$python" tests/peers/ros2/listen.py 40 >/tmp/murmurate-listen.txt &
watcher=$!
crosses teams/ros2.toml "$episodes" $((episodes * 61 / 64)) /r0=-1.2,-2 /r1=-0.6,-2 /r2=0,-2 /r3=0.6,-2 /r4=1.2,-2
wait "$watcher" || missed=1
cat /tmp/murmurate-listen.txt
crosses teams/mixed.toml 16 14 /r0=-1.2,-2 /r1=-0.6,-2 /r2=0,-2
for case in kill halt freeze lost stamp odometry gps fused scan scans; do
    "$python" tests/peers/ros2/freezes.py "$program" "$case" "$moments" || missed=1
done
"$python" tests/peers/ros2/doctor.py "$program" || missed=1
for _ in 1 2 3; do
    "$python" tests/peers/ros2/hostile.py "$program" 20000 || missed=1
done
exit "$missed"
