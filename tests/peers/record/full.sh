#!/usr/bin/env bash
# What records of real teams show: every host of every mode runs again to the bit, with a key and without, after a kill and
# after a stop; clocks that differ are found; hosts that are killed at random moments lose at most a quarter of a second.
# Exit code 1 if a bar is missed.
#
#   bash tests/peers/record/full.sh PYTHON MURMURATE [EPISODES] [KILLS]
#
# PYTHON has mcap and mcap-protobuf-support.
set -euo pipefail
cd "$(dirname "$0")/../../.."
python=$1 program=$(realpath "$2") episodes=${3:-4} kills=${4:-200} missed=0
work=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; rm -rf "$work"' EXIT
"$program" key new --out "$work/team.key" >/dev/null 2>&1

# Copies a team file with groups of its own on loopback.
team() { # FILE NUMBER
    sed -e "s/^team = .*/team = $2/" -e "s/239\.255\.[0-9]*\.\([0-9]*\):[0-9]*/239.255.76.\1:$((41000 + $2))/" "$1" >"$work/$2.toml"
    echo "$work/$2.toml"
}

verify() { # NAME FOLDER [FLAG...]
    local name=$1 folder=$2 said
    shift 2
    if said=$("$program" replay --host "$folder" "$@" 2>/dev/null); then
        echo "$name: $(grep -c 'equal, ' <<<"$said") hosts run again to the bit"
    else
        echo "$name: DIFFERS"
        echo "$said"
        missed=1
    fi
}

number=100
for mode in centralized offboard onboard-infra onboard-adhoc; do
    for key in "" "$work/team.key"; do
        number=$((number + 1))
        name="$mode${key:+ with a key}"
        flags=(--set "episodes=$episodes" ${key:+--key-file "$key"})
        "$program" launch "$(team teams/$mode.toml $number)" "${flags[@]}" --quiet --json --record "$work/$number" \
            >/dev/null 2>&1 || echo "$name: launch has failed"
        verify "$name" "$work/$number" ${key:+--key-file "$key"}
    done
done

# A host is killed and started again; a stop in the middle, with a re-arm and a resume.
for case in kill stop; do
    number=$((number + 1))
    file=$(team teams/offboard.toml $number)
    "$program" launch "$file" --set episodes=3 --quiet --json --record "$work/$number" >/dev/null 2>&1 &
    launch=$!
    sleep 6
    if [ $case = kill ]; then
        pkill -9 -f "host $file .*agent-2" || echo "no host to kill"
    else
        "$program" stop "$file" >/dev/null 2>&1
        sleep 1
        "$program" stop "$file" --rearm >/dev/null 2>&1
        "$program" resume "$file" >/dev/null 2>&1
    fi
    wait $launch || echo "$case: launch has ended with $?"
    verify "after a $case" "$work/$number"
done

if [ "$(id -u)" = 0 ] && ls /usr/lib/*/faketime/libfaketimeMT.so.1 >/dev/null 2>&1; then
    bash tests/peers/record/clocks.sh "$program" || missed=1
else
    echo "skipped: clocks of namespaces need root and Debian's faketime"
fi

if [ "$(id -u)" = 0 ] && command -v fsfreeze mkfs.ext4 >/dev/null; then
    bash tests/peers/record/disks.sh "$program" || missed=1
else
    echo "skipped: disks that stall or are full need root, fsfreeze and mkfs.ext4"
fi

number=$((number + 1))
"$python" tests/peers/record/kills.py "$program" "$(team teams/offboard.toml $number)" "$work/killed" "$kills" || missed=1
exit $missed
