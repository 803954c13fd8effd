#!/usr/bin/env bash
# A robot boots, and its service starts before its interface or address is there. Expected: it waits, says so once, and is in
# the team soon after the interface is fit. What a person has to mend is refused at once, with exit code 2.
#
#   bash 03-boot-before-address.sh MURMURATE PYTHON
set -uo pipefail
murmurate=$1
source "$(dirname "${BASH_SOURCE[0]}")/lib_network.sh"
cd "$CASE_WORK" || exit 1
machines

# Starts robot 0 in a state, checks that it waits and why, makes the interface fit, and checks that it begins.
boots() { # NAME WHY FIT: a function that makes the interface fit
    rm -f robot-0.out robot-0.log
    host 0 robot-0
    local pid=${hosts[-1]}
    within 10 said robot-0 "waiting up to" || fail "$1: it does not say that it waits"
    said robot-0 "$2" || fail "$1: it does not say why: $2"
    kill -0 "$pid" 2>/dev/null || fail "$1: it has ended"
    "$3"
    within 8 ready robot-0 || fail "$1: it has not begun 8 s after the interface was fit"
    [ "$(grep -c "waiting up to" robot-0.log)" -eq 1 ] || fail "$1: it says more than once that it waits"
    kill "$pid"
    wait "$pid"
    ip -n "$tag-0" link del w0
}

nothing() { :; }
addressed() { address 0 10.74.0.10/24; }
raised() { up 0; }
made() { interface 0; address 0 10.74.0.10/24; up 0; }

team <<<'interface = "w0"'
interface 0; addressed
boots "down" "is down" raised
boots "not there yet" "no network interface 'w0'" made
interface 0; up 0
boots "up, without an IPv4 address" "no IPv4 address" addressed
team <<<'interface = "auto"'
interface 0; addressed
boots "auto, down" "'auto' finds 0 interfaces" raised

team <<<'interface = "w0"
group = "[ff02::4d75]:7700"'
interface 0
up 0
# Duplicate address detection takes a second or two.
boots "a tentative IPv6 address" "w0" nothing

team <<'END'
interface = "w0"
transport = "unicast"
[link.infra.peers]
robot-0 = "10.74.0.10:7700"
robot-1 = "10.74.0.11:7700"
pc = "10.74.0.12:7700"
END
interface 0; up 0
boots "unicast, without an address" "no IPv4 address" addressed

# Ctrl-C while it waits. A shell starts background processes with Ctrl-C ignored, so Python passes it on.
rm -f robot-0.log
"$2" - "$murmurate" "$tag-0" <<'END' || fail "Ctrl-C while it waits does not end it with exit code 130"
import signal, subprocess, sys
command = ["ip", "netns", "exec", sys.argv[2], sys.argv[1], "host", "team.toml", "--host", "robot-0"]
host = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
while "waiting up to" not in (line := host.stderr.readline()):
    assert line, "it has ended"
host.send_signal(signal.SIGINT)
sys.exit(0 if host.wait(timeout=5) == 130 else 1)
END

# For a person: a bad field.
team <<<'interface = "w0"
group = "10.74.0.1:7700"'
on 0 "$murmurate" host team.toml --host robot-0 >/dev/null 2>refused.log
code=$?
[ $code -eq 2 ] || fail "a group that is none: exit code $code, not 2"
echo "all wait, and begin when the interface is fit"
