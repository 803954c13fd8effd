#!/usr/bin/env bash
# The fake Crazyflie before PyPI's cflib: full.sh PYTHON FAKE. The port 19850 of UDP has to be free.
set -euo pipefail
here=$(dirname "$0")
"$1" -c 'import cflib' || { echo "$1 has no cflib: pip install cflib==0.1.34" >&2; exit 1; }
# It ends with its input.
exec {input}> >("$2" 1 >/dev/null 2>&1)
sleep 0.5
"$1" "$here/cflib_client.py" udp://127.0.0.1:19850
