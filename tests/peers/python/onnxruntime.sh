#!/usr/bin/env bash
# Policies of format 3 by the library onnxruntime of PyPI: the same successes as with the program's own engine, and a sentence for a
# library that is none.
#
#   onnxruntime.sh VENV PROGRAM    VENV has the package onnxruntime; PROGRAM was built with the feature onnxruntime
set -euo pipefail
cd "$(dirname "$0")/../../.."
library=$(find "$1" -name 'libonnxruntime.so.*' | head -1)
program=$2

has() { # TEXT WORD
    case $1 in *"$2"*) ;; *) printf 'not there: %s\n%s\n' "$2" "$1" >&2 && exit 1 ;; esac
}

for policy in field recurrent lidar wide hops; do
    file=tests/onnx/data/$policy.policy.toml
    own=$("$program" policy check "$file")
    theirs=$(ORT_DYLIB_PATH=$library "$program" policy check "$file")
    has "$own" 'rten 0.24.0'
    has "$theirs" 'onnxruntime of commit'
    printf '%s: %s; %s\n' "$policy" "$(grep ' us with' <<<"$own")" "$(grep ' us with' <<<"$theirs")"
done
run=(sim --scenario swap --policy tests/onnx/data/field.policy.toml --episodes 4 --repeats 1 --quiet --json)
first=$(ORT_DYLIB_PATH=$library "$program" "${run[@]}")
second=$(ORT_DYLIB_PATH=$library "$program" "${run[@]}")
trace='.*"trace_hash":"\([0-9a-f]*\)".*'
[ "$(sed "s/$trace/\1/" <<<"$first")" = "$(sed "s/$trace/\1/" <<<"$second")" ]
successes='.*"successes":\([0-9]*\).*'
own=$("$program" "${run[@]}")
[ "$(sed "s/$successes/\1/" <<<"$first")" -gt 0 ]
[ "$(sed "s/$successes/\1/" <<<"$first")" = "$(sed "s/$successes/\1/" <<<"$own")" ]
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
record=$folder/record
ORT_DYLIB_PATH=$library "$program" "${run[@]}" --record "$record" >/dev/null
has "$(ORT_DYLIB_PATH=$library "$program" replay "$record"/*.mcap)" equal
has "$(ORT_DYLIB_PATH=/nonexistent.so "$program" "${run[@]}" 2>&1 || true)" "ORT_DYLIB_PATH: '/nonexistent.so'"
has "$(ORT_DYLIB_PATH=README.md "$program" "${run[@]}" 2>&1 || true)" "ORT_DYLIB_PATH: 'README.md'"
echo 'onnxruntime: checks, runs twice alike, a replay, and two files that are no library'
