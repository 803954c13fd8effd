#!/usr/bin/env bash
# An empty, zeroed, foreign or merged file in a team's folder is named and left out; a record that is there twice counts once.
. "$(dirname "$0")/lib_records.sh"
record 1017
try "$program" record merge team -o merged.mcap
[ $code = 0 ] || fail "merge: $code $said"
for kind in empty zeroed foreign merged; do
    [ $kind = merged ] && cp merged.mcap bad.mcap || damage $kind "$world" bad.mcap
    rm -rf mixed && cp -r team mixed && cp bad.mcap mixed/a-bad.mcap
    try "$program" record merge mixed -o again.mcap
    [ $code = 1 ] && grep -q 'left out.*a-bad.mcap' <<<"$said" || fail "$kind: merge: $code $said"
    try "$program" replay mixed
    [ $code = 1 ] && [ "$(grep -c 'equal, ' <<<"$said")" = 4 ] && grep -q a-bad.mcap <<<"$said" || fail "$kind: replay: $code $said"
    try "$program" record info mixed
    grep -q a-bad.mcap <<<"$said" && [ "$(grep -c '  holds .* whole' <<<"$said")" -ge 4 ] || fail "$kind: info: $code $said"
    rm -f bad.mcap
done
damage empty "$world" empty.mcap
try "$program" record info empty.mcap
[ $code = 1 ] && grep -q 'empty: nothing was written' <<<"$said" || fail "info of 0 bytes: $code $said"
cp "$world" team/twice.mcap
try "$program" replay team
[ $code = 0 ] && [ "$(grep -c 'equal, ' <<<"$said")" = 4 ] && grep -q 'counts once' <<<"$said" || fail "twice: $code $said"
