#!/usr/bin/env python3
"""Relay of Ethernet frames between interfaces, with a fixed delay and independent loss for each receiver.

    relay.py DELAY_MS LOSS SEED INTERFACE...

A frame that arrives on one interface leaves on all others. UDP over IPv4, what a team says, is delayed and lost; all else
(address resolution, group membership) passes at once. Prints 'ready' once all interfaces are open. Ends on SIGTERM, and
prints how many copies it has carried and lost. Linux, as root (AF_PACKET).
"""

import heapq
import random
import select
import signal
import socket
import sys
import time

ETH_P_ALL = 3
PACKET_OUTGOING = 4


def payload(frame):
    """Whether the frame is UDP over IPv4."""
    return len(frame) > 34 and frame[12:14] == b"\x08\x00" and frame[23] == 17


def without_checksum(frame):
    """The frame without its UDP checksum, which the sending kernel leaves to a network card that is not there."""
    at = 14 + 4 * (frame[14] & 15) + 6
    return frame[:at] + b"\x00\x00" + frame[at + 2 :]


def main():
    delay, loss, seed = float(sys.argv[1]) / 1000, float(sys.argv[2]), sys.argv[3]
    draw, ports = random.Random(seed), []
    for interface in sys.argv[4:]:
        port = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_ALL))
        port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        port.bind((interface, 0))
        port.setblocking(False)
        ports.append(port)
    under_way, number, carried, lost = [], 0, 0, 0

    def end(*_):
        print(f"{carried} copies carried, {lost} lost", flush=True)
        sys.exit(0)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    print("ready", flush=True)
    while True:
        wait = max(0.0, under_way[0][0] - time.monotonic()) if under_way else None
        readable, _, _ = select.select(ports, [], [], wait)
        now = time.monotonic()
        for port in readable:
            while True:
                try:
                    frame, (_, _, kind, *_) = port.recvfrom(2048)
                except BlockingIOError:
                    break
                if kind == PACKET_OUTGOING:
                    continue
                others = [other for other in ports if other is not port]
                if not payload(frame):
                    for other in others:
                        other.send(frame)
                    continue
                frame = without_checksum(frame)
                for other in others:
                    if draw.random() < loss:
                        lost += 1
                        continue
                    number += 1
                    heapq.heappush(under_way, (now + delay, number, other, frame))
        now = time.monotonic()
        while under_way and under_way[0][0] <= now:
            _, _, other, frame = heapq.heappop(under_way)
            other.send(frame)
            carried += 1


main()
