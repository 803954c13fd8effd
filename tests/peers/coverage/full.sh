#!/usr/bin/env bash
# The baselines of coverage beside those of CoverageControl, on 20 worlds that it draws: a mean that differs by more than
# 2 % is a failure. `full.sh PYTHON [FOLDER]`: PYTHON makes a virtual environment for the library (from PyPI, GPL-3, only
# run here); FOLDER keeps the worlds, and is used again if it has some.
set -euo pipefail
root=$(cd "$(dirname "$0")/../../.." && pwd)
python=$1
folder=${2:-$root/target/coverage}
mkdir -p "$folder"
if [ ! -e "$folder/worlds/done" ]; then
    [ -e "$folder/venv/bin/python" ] || "$python" -m venv "$folder/venv"
    "$folder/venv/bin/pip" install --quiet coverage-control==1.3.1 numpy
    "$folder/venv/bin/python" "$root/tests/peers/coverage/export.py" --out "$folder/worlds" --worlds 20 --steps 600
    touch "$folder/worlds/done"
fi
cd "$root"
cargo run --release --quiet --package murmurate-tasks --example coverage -- "$folder/worlds" --within 0.02
