#!/usr/bin/env bash
# A flipped bit in a record, a hole, zeros at its end: every command names the damage, and no wrong number is exported.
. "$(dirname "$0")/lib_records.sh"
record 1014
try "$program" record export "$world" --trajectories all.csv
[ $code = 0 ] || fail "export of the whole record: exit $code $said"
for kind in flip hole zeros cut metadata attachment; do
    damage $kind "$world" $kind.mcap
    try "$program" record info $kind.mcap
    [ $code = 1 ] || fail "$kind: info exits with $code: $said"
    grep -Eq 'DAMAGED|cut' <<<"$said" && grep -q 'bytes [0-9]* to [0-9]*' <<<"$said" || fail "$kind: info says $said"
    ! grep -q ' whole' <<<"$said" || fail "$kind: info says whole"
    try "$program" record export $kind.mcap --trajectories $kind.csv
    [ $code = 1 ] && grep -q 'bytes [0-9]* to [0-9]*' <<<"$said" || fail "$kind: export exits with $code: $said"
    # Time, robot and all numbers of each row are those of the whole record; most rows are there.
    "$python" - all.csv $kind.csv $kind <<'PY' || fail "$kind: rows"
import csv, sys
rows = lambda path: [tuple(row[2:]) for row in csv.reader(open(path))]
whole, some, kind = rows(sys.argv[1]), rows(sys.argv[2]), sys.argv[3]
assert set(some) <= set(whole), set(some) - set(whole)
assert len(some) > len(whole) * (0.8 if kind not in ("zeros", "cut") else 0.3), (len(some), len(whole))
assert (len(some) < len(whole)) == (kind not in ("metadata", "attachment")), (len(some), len(whole))
PY
done
try "$program" replay flip.mcap
[ $code = 1 ] && grep -q 'the file is damaged' <<<"$said" && ! grep -q DIFFERS <<<"$said" || fail "replay: $code $said"
try "$program" record repair flip.mcap
[ $code = 1 ] && grep -q 'checksum is wrong' <<<"$said" && [ -e flip.mcap.cut ] || fail "repair: $code $said"
try "$program" record info flip.mcap
[ $code = 0 ] && grep -q whole <<<"$said" || fail "info after the repair: $code $said"
# What is damaged for another reader, too, is what is left out.
"$python" - hole.mcap <<'PY' || fail "another reader finds other damage"
import sys
from mcap.exceptions import McapError
from mcap.reader import make_reader
try:
    list(make_reader(open(sys.argv[1], "rb"), validate_crcs=True).iter_messages())
    sys.exit("no damage")
except (McapError, ValueError, UnicodeDecodeError):
    pass
PY
