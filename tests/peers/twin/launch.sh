#!/usr/bin/env bash
# Records a team of five whose hosts are in network namespaces, behind a relay that delays and loses all that they say.
#
#   bash tests/peers/twin/launch.sh MURMURATE FOLDER [EPISODES] [DELAY_MS] [LOSS] [LAUNCH FLAG...]
#
# Needs root, `ip` and Python 3. Everything is removed at the end, also on Ctrl-C.
set -euo pipefail
here=$(realpath "$(dirname "$0")")
program=$(realpath "$1") folder=$2 episodes=${3:-64} delay=${4:-20} loss=${5:-0.16}
shift $(($# < 5 ? $# : 5))
source "$here/namespaces.sh"
work=$(mktemp -d)
launch=
end() {
    # The first signal ends the team well; its processes are in their namespaces until then.
    [ -z "$launch" ] || { kill "$launch" 2>/dev/null && wait "$launch" || true; }
    tw_remove
    rm -rf "$work"
}
trap end EXIT
trap 'exit 130' INT TERM

cp "$here/team.toml" "$work/team.toml"
"$program" key new --out "$work/team.key" >/dev/null 2>&1
tw_build robot-0 robot-1 robot-2 robot-3 robot-4 world
tw_relay "$delay" "$loss"
"$program" launch "$work/team.toml" --set "episodes=$episodes" --through "nice -n -15 ip netns exec tw-{host}" \
    --record "$folder" "$@" &
launch=$!
status=0
wait "$launch" || status=$?
launch=
exit $status
