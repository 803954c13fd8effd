#!/usr/bin/env bash
# What stand-in autopilots show: the stand-in before MAVSDK, our driver before MAVSDK's autopilot, frames before pymavlink, rovers and
# copters in teams, the commands of docs/mavlink.md. Prints figures; exit code 1 if a bar is missed.
#
#   bash tests/peers/mavlink/full.sh PYTHON MURMURATE
#
# PYTHON has pymavlink and mavsdk (>= 4).
set -euo pipefail
cd "$(dirname "$0")"
python=$1 program=$(cd "$OLDPWD" && realpath "$2") missed=0
"$python" accepted.py || missed=1
"$python" server.py "$program" || missed=1
"$python" rovers.py "$program" || missed=1
"$python" copters.py "$program" || missed=1
"$python" page.py "$program" || missed=1
exit "$missed"
