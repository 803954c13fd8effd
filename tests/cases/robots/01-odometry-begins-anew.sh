#!/usr/bin/env bash
# The odometry of a ROS 2 robot counts from zero again in mid-run, as after a power cycle of its base. Expected: the robot
# stands, its log line says why, no episode is a success and no robots meet before somebody says where it is; after
# `murmurate place` the team goes on. Like ROBOTIS-GIT/turtlebot3#750 and #880, AutonomyLab/create_robot#62.
set -uo pipefail
here=$(dirname "$(realpath "$0")") program=$1 python=$2
. "$here/lib_ros.sh"
own_network "$@"
cd "${CASE_WORK:?}"
cp "$here/lib_odometry_robots.py" .
cat > team.toml <<'TOML'
team = 76
scenario = "swap"
policy = "orca"
episodes = 40
wall_radius_m = 0.16
[safety]
own_state_s = 0.4
late_tick_s = 0.5
[link.air]
interface = "lo"
group = "239.255.77.76:7776"
[deployment]
mode = "ros"
robots = 2
placement = "drive"
stepping = "seeded"
[deployment.body]
drive = "holonomic"
heading = "free"
[[deployment.host]]
name = "robots"
agents = [[0], [1]]
actuates = [0, 1]
localizes = [0, 1]
driver = { name = "ros2", interface = "lo", speed_m_s = 0.5, robot.0.namespace = "/r0", robot.1.namespace = "/r1" }
source = { name = "odometry", robot.0 = { origin_m = [-0.8, 0.0] }, robot.1 = { origin_m = [0.8, 0.0], yaw_rad = 3.14159265 } }
[[deployment.host]]
name = "pc"
state_server = true
[[deployment.link]]
name = "air"
carries = ["reading", "heartbeat", "mode", "stop"]
TOML
fail() { echo "$1"; tail -n 5 robots.log pc.log true.txt 2>/dev/null; exit 1; }
trap 'kill $(jobs -p) 2>/dev/null' EXIT
"$python" lib_odometry_robots.py 4 > true.txt 2> robots.err &
"$program" host team.toml --host pc --json > pc.txt 2> pc.log &
"$program" host team.toml --host robots --json > robots.txt 2> robots.log &
for _ in $(seq 600); do grep -q RESET true.txt && break; sleep 0.1; done
grep -q RESET true.txt || fail "the robots have not driven"
episodes=$(grep -c '"event":"episode"' pc.txt)
for _ in $(seq 100); do grep -q "robot 0 stands: its odometry has jumped" robots.log && break; sleep 0.1; done
grep -q "robot 0 stands: its odometry has jumped" robots.log || fail "no line says that the odometry has jumped"
sleep 6
tail -n +$((episodes + 1)) <(grep '"event":"episode"' pc.txt) | grep -q '"verdict":"success"' && fail "an episode is a success"
# Columns: AT, time, x, y and heading of robot 0, its speed, distance of the two, speed of robot 1.
tail -n 20 true.txt | awk '$1 == "AT" && ($6 > 0 || $8 > 0) { moves = 1 } END { exit !moves }' && fail "a robot moves"
sed -n '/RESET/,$p' true.txt | awk '$1 == "AT" && $7 < 0.32 { near = 1 } END { exit !near }' && fail "the robots met"
read -r _ _ x y heading _ < <(grep '^AT' true.txt | tail -n 1)
"$program" place team.toml --robot 0 --at "$x" "$y" --heading "$heading" || fail "it was not placed"
goals=$(grep -c '"verdict":"success"' pc.txt)
for _ in $(seq 400); do [ "$(grep -c '"verdict":"success"' pc.txt)" -gt "$goals" ] && break; sleep 0.1; done
[ "$(grep -c '"verdict":"success"' pc.txt)" -gt "$goals" ] || fail "the team does not go on after place"
