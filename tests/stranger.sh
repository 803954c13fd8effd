#!/usr/bin/env bash
# Builds the crate in tests/stranger/, which is no part of this one, and runs what it adds through the command line.
#
#   bash tests/stranger.sh          the profile of the tests, in the same target folder
set -euo pipefail
cd "$(dirname "$0")/stranger"

export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$PWD/../../target}
# The same versions as the crate itself, so that what is built is used again.
cp ../../Cargo.lock Cargo.lock
cargo build --quiet
program=$CARGO_TARGET_DIR/debug/stranger

has() { # TEXT WORD...: refuses a text that lacks one of the words
    local text=$1 word
    shift
    for word in "$@"; do
        case $text in *"$word"*) ;; *) printf 'not there: %s\n%s\n' "$word" "$text" >&2 && exit 1 ;; esac
    done
}

has "$("$program" sim --help)" round give-way glide passage orca rigid
has "$("$program" train --help)" round passage
own=(sim --mode offboard --scenario round --policy give-way --plant glide)
result=$("$program" "${own[@]}" --episodes 2 --repeats 1 --quiet --json)
has "$result" '"scenario":"round"' '"policy":"give-way"' '"successes":2'
# Each also with what this crate has.
has "$("$program" sim --scenario round --episodes 1 --repeats 1 --quiet)" 'policy orca' '1 of 1'
has "$("$program" sim --plant glide --policy give-way --robots 3 --episodes 1 --repeats 1 --quiet)" 'scenario passage'
# A wrong name is refused with all that there are.
has "$("$program" sim --scenario square --quiet 2>&1 || true)" square round passage

team=$(mktemp -d)
trap 'rm -rf "$team"' EXIT
cat >"$team/team.toml" <<'TOML'
team = 77
mode = "centralized"
scenario = "round"
policy = "give-way"
plant = "glide"
robots = 3
episodes = 1
TOML
has "$("$program" config check "$team/team.toml" --interface lo 2>/dev/null)" sound
has "$("$program" launch "$team/team.toml" --interface lo --json --quiet 2>/dev/null)" '"scenario":"round"' '"successes":1'

"$program" study delay --scenario round --policy give-way --layouts 1 --repeats 1 --delays-ms 0 --losses 0 \
    --out "$team/study" --quiet >/dev/null
"$program" train round --steps 20000 --out "$team/trained" --quiet >/dev/null
has "$("$program" sim --scenario round --policy "$team/trained/policy.safetensors" --episodes 1 --repeats 1 --quiet)" \
    'scenario round'
echo "a scenario, a policy and a plant from another crate: sim, launch, study and train have them"
