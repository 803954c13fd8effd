#!/usr/bin/env bash
# What a twin of a real run shows: 64 episodes behind a relay that delays by 20 ms and loses 16 %, with a lag of 0.5 s. Everything
# is fitted from nothing on the first 32 and predicted for the other 32; a model without lag is refuted. Exit code 1 if a bar is
# missed.
#
#   bash tests/peers/twin/full.sh MURMURATE [EPISODES] [FOLDER]
#
# FOLDER keeps the records and the reports. Needs root, `ip` and Python 3.
set -euo pipefail
here=$(realpath "$(dirname "$0")")
program=$(realpath "$1") episodes=${2:-64} folder=${3:-} missed=0
if [ -z "$folder" ]; then
    folder=$(mktemp -d)
    trap 'rm -rf "$folder"' EXIT
fi
trap 'exit 130' INT TERM
bash "$here/launch.sh" "$program" "$folder/run" "$episodes" 20 0.16 --quiet
"$program" study twin "$folder/run" --out "$folder/twin" || missed=1
python3 "$here/known.py" "$folder/twin/rows.json" 0.5 20 16 || missed=1
echo
echo "control: a model without lag"
if "$program" study twin "$folder/run" --given lag_s=0 --out "$folder/without-lag"; then
    echo "the model without lag is NOT refuted"
    missed=1
fi
exit $missed
