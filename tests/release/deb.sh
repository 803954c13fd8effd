#!/usr/bin/env bash
# The Debian package in a clean root without Rust: installed, upgraded, removed and purged, while a team of five robots runs.
#
#   tests/release/deb.sh OLD.deb NEW.deb [FOLDER FOR ROOTS]       (root, apt: debootstrap iproute2)
set -euo pipefail
old=$(realpath "$1") new=$(realpath "$2")
ROOTS=$(realpath -m "${3:-target/roots}") SPACE=murmurate-release-$$
. "$(dirname "$0")/root.sh"
root=$ROOTS/deb
base bare ca-certificates
fresh bare deb
end() {
    forget deb
    ip netns del "$SPACE" 2>/dev/null || true
}
trap end EXIT
ip netns add "$SPACE"
ip -n "$SPACE" link set lo up
cp "$old" "$root/old.deb"
cp "$new" "$root/new.deb"
for absent in cargo rustc python3 cc; do
    ! in_root deb sh -c "command -v $absent" || fail "the root has $absent"
done

# Waits until the file has at least so many lines that match: wait_for NUMBER PATTERN FILE SECONDS
wait_for() {
    for _ in $(seq $(($4 * 10))); do
        [ "$(grep -c "$2" "$3" || true)" -ge "$1" ] && return
        sleep 0.1
    done
    tail -5 "$3"
    fail "after $4 s no $1 lines with '$2'"
}
episodes() { grep -c '^episode [0-9]* of [0-9]*: ' "$1" || true; }

echo "== a bare machine: from the package to a team of five robots"
began=$(date +%s.%N)
in_root deb dpkg --install /old.deb >"$root/install.log" 2>&1 || { cat "$root/install.log"; fail "it does not install"; }
in_root deb murmurate launch /usr/share/murmurate/teams/offboard.toml --set episodes=1 | tee "$root/first.log"
took=$(echo "$(date +%s.%N) - $began" | bc)
echo "package to the end of the first episode: $took s"
[ "$(echo "$took < 60" | bc)" = 1 ] || fail "more than 60 s"
grep -q '^ *success' "$root/first.log" || fail "no table"

echo "== what the package brings"
in_root deb murmurate --version
in_root deb getent passwd murmurate
for file in /lib/systemd/system/murmurate@.service /usr/share/man/man1/murmurate.1.gz /usr/share/man/man1/murmurate-host.1.gz \
    /usr/share/bash-completion/completions/murmurate /usr/share/zsh/vendor-completions/_murmurate \
    /usr/share/doc/murmurate/copyright /usr/share/doc/murmurate/THIRD-PARTY.txt.gz /usr/share/murmurate/policies/passage.safetensors; do
    [ -e "$root$file" ] || fail "no $file"
done
in_root deb bash -n /usr/share/bash-completion/completions/murmurate
# By the user of the service, whose state and keys these are.
in_root deb sh -c 'cp /usr/share/murmurate/teams/offboard.toml /etc/murmurate/team.toml
    murmurate key new --out /etc/murmurate/team.key && chown murmurate:murmurate /etc/murmurate/team.key
    echo kept >/var/lib/murmurate/2.roster'
as_user() { in_root deb setpriv --reuid murmurate --regid murmurate --init-groups "$@"; }
as_user murmurate doctor /etc/murmurate/team.toml --key-file /etc/murmurate/team.key --host world --listen 0
kept() { (cd "$root" && stat --format '%n %U %G %a' etc/murmurate etc/murmurate/* var/lib/murmurate var/lib/murmurate/* &&
    sha256sum etc/murmurate/* var/lib/murmurate/*); }
before=$(kept)

echo "== an upgrade while a team runs"
log=$root/team.log
in_root deb murmurate launch /usr/share/murmurate/teams/offboard.toml --set episodes=400 >"$log" 2>&1 &
wait_for 1 '^episode ' "$log" 30
in_root deb dpkg --install /new.deb
[ "$before" = "$(kept)" ] || fail "the upgrade has changed team file, key or state"
at=$(episodes "$log")
wait_for $((at + 2)) '^episode ' "$log" 60
! grep -qi 'abort\|warning: the process' "$log" || fail "the upgrade has disturbed the team"
echo "undisturbed: $(episodes "$log") episodes, none aborted"
agents() { pgrep -f 'murmurate host.* agent-2|murmurate .*--host agent-2' || true; }
mapped() { readlink "/proc/$(agents | head -1)/exe"; }
echo "robot 2 runs $(mapped)"
kill -9 "$(agents | head -1)"
wait_for 1 "the process 'agent-2' is back" "$log" 30
echo "after its end it runs $(mapped)"
grep "agent-2" "$log"

echo "== a removal while a team runs"
in_root deb dpkg --remove murmurate
[ ! -e "$root/usr/bin/murmurate" ] || fail "the program is there"
[ "$before" = "$(kept)" ] || fail "the removal has changed team file, key or state"
at=$(episodes "$log")
wait_for $((at + 2)) '^episode ' "$log" 60
echo "undisturbed: $(episodes "$log") episodes"

echo "== a purge while a team runs"
in_root deb dpkg --purge murmurate
[ ! -e "$root/etc/murmurate" ] && [ ! -e "$root/var/lib/murmurate" ] || fail "a purge leaves team file, key or state"
at=$(episodes "$log")
wait_for $((at + 1)) '^episode ' "$log" 60
kill -9 "$(agents | head -1)"
wait_for 2 "agent-2' has failed" "$log" 30
tail -3 "$log"
in_root deb dpkg --install /old.deb >/dev/null 2>&1 || fail "it does not install again"
echo "the package is as it should be"
