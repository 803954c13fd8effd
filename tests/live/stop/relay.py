#!/usr/bin/env python3
"""A relay between two networks, without the key: passes all frames on, or delays motor commands.

Run with the names of its two interfaces and the version of the wire; told what to do by lines on standard input:
  pass         everything goes on at once
  hold         motor commands from the first interface are kept; all else goes on
  hold-bare    the same, but those with a piggybacked link report go on
  release MS   what was kept for longer than so many milliseconds goes on now; the answer is how many frames that are
  jitter MS    every frame is delayed by a random time of up to so many milliseconds
Each command is answered by a line with the number of frames that are kept."""
import heapq, random, select, socket, sys, time

MOTOR_COMMAND, REPORTS = 2, (0x80, 0x84)
VERSION = int(sys.argv[3])


def blocks(frame):
    """Contents of the blocks of a datagram of the team; empty for any other frame."""
    if frame[12:14] != b"\x08\x00" or frame[23] != 17:
        return []
    udp = 14 + 4 * (frame[14] & 15)
    payload = frame[udp + 8:udp + int.from_bytes(frame[udp + 4:udp + 6], "big")]
    if len(payload) < 30 or payload[0] != VERSION:
        return []
    held, at, end = [], 14, len(payload) - 16
    while at + 3 <= end:
        held.append(payload[at])
        at += 3 + int.from_bytes(payload[at + 1:at + 3], "little")
    return held


def kept_back(frame, hold):
    held = blocks(frame)
    bare = hold == "hold" or not any(block in REPORTS for block in held)
    return hold != "pass" and held[:1] == [MOTOR_COMMAND] and bare


def whole(frame):
    """The frame with no UDP checksum, which the sender's kernel has left to hardware that is not there."""
    if frame[12:14] == b"\x08\x00" and frame[23] == 17:
        udp = 14 + 4 * (frame[14] & 15)
        return frame[:udp + 6] + b"\0\0" + frame[udp + 8:]
    return frame


sides = []
for name in sys.argv[1:3]:
    side = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
    side.bind((name, 0))
    side.setblocking(False)
    sides.append(side)
kept, flying, count, hold, jitter, line = [], [], 0, "pass", 0.0, b""
print("ready", flush=True)
while True:
    wait = max(0.0, flying[0][0] - time.monotonic()) if flying else None
    readable, _, _ = select.select([sys.stdin.buffer, *sides], [], [], wait)
    for at, side in enumerate(sides):
        while side in readable:
            try:
                frame, about = side.recvfrom(2048)
            except BlockingIOError:
                break
            if about[2] == socket.PACKET_OUTGOING:
                continue
            frame = whole(frame)
            if at == 0 and kept_back(frame, hold):
                kept.append((time.monotonic(), frame))
                continue
            count += 1
            heapq.heappush(flying, (time.monotonic() + random.uniform(0, jitter), count, 1 - at, frame))
    while flying and flying[0][0] <= time.monotonic():
        _, _, to, frame = heapq.heappop(flying)
        sides[to].send(frame)
    if sys.stdin.buffer in readable:
        read = sys.stdin.buffer.raw.read(4096)
        if not read:
            sys.exit(0)
        *commands, line = (line + read).split(b"\n")
        for command in commands:
            word, *rest = command.decode().split()
            if word == "release":
                until = time.monotonic() - float(rest[0]) / 1e3
                old = [frame for at, frame in kept if at <= until]
                kept = [(at, frame) for at, frame in kept if at > until]
                for frame in old:
                    sides[1].send(frame)
                print(len(old), flush=True)
            else:
                hold = word if word.startswith("hold") else "pass"
                jitter = float(rest[0]) / 1e3 if word == "jitter" else 0.0
                print(len(kept), flush=True)
