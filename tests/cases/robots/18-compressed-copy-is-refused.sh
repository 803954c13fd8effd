#!/usr/bin/env bash
# Copies of a record with zstd or lz4 chunks, as the mcap command line makes them: read by every command, and equal.
. "$(dirname "$0")/lib_records.sh"
record 1018
"$program" record export "$world" --trajectories all.csv || fail "export"
for kind in zstd lz4; do
    damage $kind "$world" $kind.mcap
    try "$program" record info $kind.mcap
    [ $code = 0 ] && grep -q whole <<<"$said" || fail "$kind: info: $code $said"
    try "$program" replay $kind.mcap
    [ $code = 0 ] && grep -q 'equal, ' <<<"$said" || fail "$kind: replay: $code $said"
    try "$program" record export $kind.mcap --trajectories $kind.csv
    [ $code = 0 ] && cmp -s all.csv $kind.csv || fail "$kind: export: $code $said"
    rm -rf mixed && cp -r team mixed && rm "mixed/$(basename "$world")" && cp $kind.mcap mixed/
    try "$program" record merge mixed -o m.mcap
    [ $code = 0 ] || fail "$kind: merge: $code $said"
done
