#!/bin/bash
# Emergency stops across hops among real processes: five hosts in a line on a channel with space, each of which hears its neighbours
# alone. Stops are given at stations that are drawn; a sniffer beside each host says when it says the stop on.
# Needs root, iproute2 and python3. Usage: mesh.sh MURMURATE [STOPS]
set -euo pipefail
program=$(realpath "$1")
stops=${2:-50}
work=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; "$program" lab down --name mesh >/dev/null 2>&1 || true; rm -rf "$work"' EXIT

{
    printf 'name = "mesh"\nstations = 5\nstatic_arp = true\n'
    printf '[radio]\nchannel = "ad-hoc"\nbasic_rate = "ofdm-6"\nrange_m = 30.0\nsense_m = 55.0\nnoise_loss = 0.05\n'
    for i in 0 1 2 3 4; do printf '[[station]]\nnumber = %s\nposition_m = [%s.0, 0.0]\n' $i $((25 * i)); done
} > "$work/lab.toml"
"$program" key new --out "$work/team.key" > /dev/null
{
    printf 'team = 77\nkey_file = "team.key"\nepisodes = 1\n'
    printf '[link.ad-hoc]\ninterface = "wlan0"\ngroup = "239.255.77.61:7761"\n'
    printf '[deployment]\nmode = "line"\nrobots = 5\nplacement = "drive"\nstepping = "seeded"\n'
    for i in 0 1 2 3 4; do
        printf '[[deployment.host]]\nname = "robot-%s"\nagents = [[%s]]\nsimulates = [%s]\n' $i $i $i
        [ $i != 0 ] || printf 'state_server = true\n'
    done
    printf '[[deployment.link]]\nname = "ad-hoc"\nmedium = "ad-hoc"\nmesh = true\n'
    printf 'carries = ["latent", "reading", "heartbeat", "mode", "stop"]\n'
} > "$work/team.toml"
cd "$work"
"$program" config check team.toml > /dev/null

# Prints for each datagram of this host with a stop that engages: host and time.
cat > sniff.py <<'END'
import socket, struct, time
s = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
s.bind(("wlan0", 0))
def number(body):
    size = {0xCC: 1, 0xCD: 2, 0xCE: 4, 0xCF: 8}.get(body[0])
    return (body[0], body[1:]) if size is None else (int.from_bytes(body[1:1 + size], "big"), body[1 + size:])
while True:
    frame, source = s.recvfrom(2000)
    at = time.monotonic()
    if source[2] != socket.PACKET_OUTGOING or frame[12:14] != b"\x08\x00" or frame[23] != 17:
        continue
    plain, block = frame[14 + 4 * (frame[14] & 15) + 8:], 14
    sender = struct.unpack_from("<H", plain, 4)[0]
    while block + 3 <= len(plain) - 16:
        content, length = plain[block], struct.unpack_from("<H", plain, block + 1)[0]
        body, block = plain[block + 3:block + 3 + length], block + 3 + length
        if content == 5 and sender < 5:
            # An array of two: the sender, and the latch, (3 x number + state) x 251 (docs/wire.md).
            _, rest = number(body[1:])
            latch, _ = number(rest)
            if latch // 251 % 3 == 2:
                print(sender, f"{at:.5f}", flush=True)
END
"$program" lab up lab.toml > /dev/null
for i in 0 1 2 3 4; do
    ip netns exec mesh$i python3 sniff.py > sniffed.$i &
    ip netns exec mesh$i "$program" host team.toml --host robot-$i --json > said.$i 2> log.$i &
done
sleep 5
cat > give.py <<'END'
import random, subprocess, sys, time
program, stops = sys.argv[1], int(sys.argv[2])
random.seed(1)
def first_after(begun):
    lines = [line.split() for host in range(5) for line in open(f"sniffed.{host}")]
    said = [(float(at), host) for host, at in lines if float(at) >= begun]
    return {host: at for at, host in sorted(said, reverse=True)}
def stop(station, *flags):
    subprocess.run(["ip", "netns", "exec", f"mesh{station}", program, "stop", "team.toml", *flags], capture_output=True)
results = []
for number in range(stops):
    station, begun = random.randrange(5), time.monotonic()
    stop(station, "--wait", "1")
    time.sleep(1.2)
    first = first_after(begun).values()
    results.append(1e3 * (max(first) - min(first)) if len(first) == 5 else None)
    # What ends a stop does not cross hops, so everyone is told.
    for station in range(5):
        stop(station, "--rearm", "--wait", "1")
    time.sleep(3.2)
done = [one for one in results if one is not None]
soon = sum(one <= 100 for one in done)
print(f"{len(results)} stops: {len(done)} reached all five, {soon} within 100 ms of the first, longest {max(done, default=0):.0f} ms")
sys.exit(len(done) != len(results) or soon < 0.9 * len(results))
END
python3 give.py "$program" "$stops"
