#!/usr/bin/env bash
# A team whose records are on a disk that stalls for a second, and on one that is full: no control tick is late, what is
# missing is counted, and the files read. Exit code 1 if a bar is missed. Needs root, loop devices and fsfreeze.
#
#   bash tests/peers/record/disks.sh MURMURATE
set -euo pipefail
cd "$(dirname "$0")/../../.."
program=$(realpath "$1") work=$(mktemp -d) missed=0
mkdir "$work/disk"
undo() {
    fsfreeze --unfreeze "$work/disk" 2>/dev/null || true
    kill $(jobs -p) 2>/dev/null || true
    umount "$work/disk" 2>/dev/null || true
    rm -rf "$work"
}
trap undo EXIT

# Makes a file system of its own for records, of so many megabytes.
disk() { # MEGABYTES
    umount "$work/disk" 2>/dev/null || true
    rm -f "$work/image"
    truncate --size "$1M" "$work/image"
    mkfs.ext4 -q -m 0 -O ^has_journal "$work/image"
    mount -o loop "$work/image" "$work/disk"
}

# Number of writers of records that wait for the disk.
waiting() {
    local count=0 thread
    for thread in $(pgrep -f "^$program host $work/team.toml" | sed 's|.*|/proc/&/task|'); do
        count=$((count + $(grep -lsx record "$thread"/*/comm | sed 's|comm$|stat|' | xargs -r cat 2>/dev/null | grep -c ') D ')))
    done
    echo "$count"
}

# Runs three episodes with records on the disk; WHILE is run four seconds after the start.
team() { # NUMBER WHILE
    sed -e "s/^team = .*/team = $1/" -e "s/239\.255\.[0-9]*\.\([0-9]*\):[0-9]*/239.255.76.\1:$((42000 + $1))/" \
        teams/offboard.toml >"$work/team.toml"
    "$program" launch "$work/team.toml" --set episodes=3 --quiet --json --record "$work/disk/runs" \
        >"$work/report" 2>"$work/said" &
    local launch=$!
    sleep 4
    $2
    wait $launch || echo "launch has ended with $?: $(grep -m 1 -i 'record' "$work/said" || tail -n 1 "$work/said")"
}

# Prints counts of the report, and fails if a tick was late or an episode is missing.
judged() { # NAME
    python3 - "$1" "$work/report" <<'P' || missed=1
import json, sys
report = json.load(open(sys.argv[2]))
late = report["safety"]["late_tick"]
dropped = report.get("unwritten", {}).get("record_events", 0)
print(f"{sys.argv[1]}: {report['episodes']} episodes, {late} late ticks, {dropped} events not in the records")
sys.exit(late != 0 or report["episodes"] != 3)
P
}

stall() {
    fsfreeze --freeze "$work/disk"
    sleep 1
    blocked=$(waiting)
    fsfreeze --unfreeze "$work/disk"
    echo "after a second without the disk $blocked of 6 writers wait for it"
    [ "$blocked" -ge 5 ] || missed=1
}

disk 64
team 71 stall
judged "a stall of a second"
"$program" replay --host "$work/disk/runs" >"$work/replayed" || missed=1
echo "hosts that run again to the bit: $(grep -c 'equal, ' "$work/replayed") of 6"

disk 6
team 72 true
judged "a full disk"
"$program" record info "$work/disk/runs" >"$work/info" 2>&1 || true
read=$(grep -c '  holds ' "$work/info")
echo "records that read: $read of 6; free: $(df --output=avail "$work/disk" | tail -n 1) kB"
[ "$read" = 6 ] || missed=1
exit $missed
