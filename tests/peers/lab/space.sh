#!/bin/bash
# Real programs on a channel with space: three stations in a line, of which the outer ones are hidden from each other. Datagrams of
# both to the middle beside the same line where all sense each other; and babeld of Debian, which finds the way over the middle.
# Needs root, iproute2, python3, and babeld for its part. Usage: space.sh MURMURATE
set -euo pipefail
program=$(realpath "$1")
work=$(mktemp -d)
trap '"$program" lab down --name space >/dev/null 2>&1 || true; rm -rf "$work"' EXIT
failed=0
say() { printf '%-72s %s\n' "$1" "$2"; }
must() { # text, value, condition of awk on the value
    if awk -v x="$2" "BEGIN { exit !($3) }"; then say "$1" "$2"; else say "$1" "$2 FAILED: $3"; failed=1; fi
}

lab() { # range and sense [m], and more lines of the radio
    cat > "$work/lab.toml" <<END
name = "space"
stations = 3
static_arp = true
ipv6 = true
[radio]
channel = "ad-hoc"
basic_rate = "ofdm-6"
range_m = $1
sense_m = $2
$3
[[station]]
number = 0
position_m = [0.0, 0.0]
[[station]]
number = 1
position_m = [25.0, 0.0]
[[station]]
number = 2
position_m = [50.0, 0.0]
END
}

# Both outer stations send 400 broadcasts of 200 bytes a second for 5 s; prints the share that the middle one gets.
cat > "$work/load.py" <<'END'
import os, random, socket, sys, time
station, seconds = int(os.environ["LAB_STATION"]), 5.0
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
begin = time.monotonic() + 1.0
if station == 1:
    s.bind(("", 9999))
    s.settimeout(0.1)
    got = 0
    while time.monotonic() < begin + seconds + 1.0:
        try:
            s.recv(999)
            got += 1
        except TimeoutError:
            pass
    print("got", got, flush=True)
else:
    random.seed(station)
    at, sent = begin, 0
    while at < begin + seconds:
        time.sleep(max(0.0, at - time.monotonic()))
        s.sendto(bytes(200), ("10.77.0.255", 9999))
        sent += 1
        at += random.expovariate(400.0)
    print("sent", sent, flush=True)
END
cat > "$work/echo.py" <<'END'
import socket, sys
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.bind((sys.argv[1], 9998))
while True:
    data, source = s.recvfrom(999)
    s.sendto(data, source)
END
cat > "$work/ask.py" <<'END'
import socket, sys, time
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.settimeout(0.5)
answered = 0
for number in range(20):
    try:
        s.sendto(bytes([number]), (sys.argv[1], 9998))
        answered += s.recv(9) == bytes([number])
    except OSError:
        pass
    time.sleep(0.1)
print(answered)
END
share() {
    "$program" lab run "$work/lab.toml" --seconds 9 -- python3 "$work/load.py" > "$work/out" 2>&1
    awk '/got [0-9]+$/ { got = $NF } /sent [0-9]+$/ { sent += $NF } END { printf "%.4f", got / sent }' "$work/out"
}
lab 30.0 55.0 ""
near=$(share)
lab 30.0 30.0 ""
hidden=$(share)
must "broadcasts of both ends at the middle, all sense each other" "$near" "x > 0.95"
must "the same, hidden from each other" "$hidden" "x < $near - 0.05 && x > 0.6"

if command -v babeld > /dev/null; then
    "$program" lab up "$work/lab.toml" > /dev/null
    for i in 0 1 2; do
        ip netns exec "space$i" sysctl -qw net.ipv4.ip_forward=1 net.ipv6.conf.all.forwarding=1 net.ipv4.conf.all.send_redirects=0 \
            net.ipv4.conf.wlan0.send_redirects=0
        ip -n "space$i" route del 10.77.0.0/24 dev wlan0
    done
    refused=0
    ip -n space0 route get 10.77.0.3 > /dev/null 2>&1 || refused=1
    must "no way from one end to the other without routing" "$refused" "x == 1"
    for i in 0 1 2; do
        ip netns exec "space$i" babeld -I "$work/$i.pid" -S "$work/$i.state" -L "$work/$i.log" -h 1 -H 1 \
            -C 'default type wireless' -C 'redistribute local ip 10.77.0.0/24' -C 'redistribute local deny' wlan0 &
    done
    began=$(date +%s.%N)
    found=none
    for _ in $(seq 300); do
        if ip -n space0 route get 10.77.0.3 2>/dev/null | grep -q 'via 10.77.0.2'; then
            found=$(awk -v a="$began" -v b="$(date +%s.%N)" 'BEGIN { printf "%.1f", b - a }')
            break
        fi
        sleep 0.1
    done
    must "babeld finds the way over the middle after [s]" "$found" "x != \"none\" && x < 20"
    sleep 2
    ip netns exec space2 python3 "$work/echo.py" 10.77.0.3 &
    echo=$!
    answered=$(ip netns exec space0 python3 "$work/ask.py" 10.77.0.3)
    must "of 20 datagrams over two hops are answered" "$answered" "x >= 18"
    kill $echo
    for i in 0 1 2; do kill "$(cat "$work/$i.pid")" || true; done
    wait || true
    "$program" lab down --name space > /dev/null
else
    say "babeld is not installed" "skipped"
fi
exit $failed
