#!/usr/bin/env bash
# Crazyflies: the fake one before PyPI's cflib, then six of them flown by the program, and the commands of docs/crazyflie.md.
#
#   full.sh PYTHON EXAMPLES [MURMURATE]
#
# EXAMPLES is the folder of `fake_crazyflie` and `natnet_server`; PYTHON has cflib, mcap and msgpack. Without the program, the first
# alone. The ports 19850 to 19855 of UDP have to be free. Exit code 1 if a bar is missed.
set -euo pipefail
here=$(dirname "$0") missed=0
"$1" -c 'import cflib' || { echo "$1 has no cflib: pip install cflib==0.1.34" >&2; exit 1; }
# It ends with its input.
exec {input}> >("$2/fake_crazyflie" 1 >/dev/null 2>&1)
sleep 0.5
"$1" "$here/cflib_client.py" udp://127.0.0.1:19850
exec {input}>&-
[ $# -gt 2 ] || exit 0
sleep 0.5
"$1" "$here/flights.py" "$3" "$2" || missed=1
"$1" "$here/page.py" "$3" "$2" || missed=1
exit "$missed"
