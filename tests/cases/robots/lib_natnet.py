"""A NatNet server (bitstream 4.1) that plays a scene: lib_natnet.py SCENE DATA_PORT COMMAND_PORT GROUP

Robots 0 and 1 stand still. A scene says what is wrong with the tracker, with one of their bodies or with another one.
"""

import math
import select
import socket
import struct
import sys
import time

scene, data_port, command_port, group = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
HOST, NAN, UNIT, ZERO = "127.0.0.1", math.nan, (0, 0, 0, 1), (0, 0, 0, 0)
PLACES = {1: (-1.0, 0.1, 1.0), 2: (1.0, 0.1, 1.0)}  # y is up


def body(number, place=None, rotation=UNIT, tracked=1):
    return struct.pack("<i3f4ffh", number, *(place or PLACES[number]), *rotation, 2e-4, tracked)


def bodies(now):
    """The bodies of a frame `now` seconds into the scene; None for no frame."""
    first, second = body(1), body(2)
    match scene:
        case "foreign_zero":
            return [first, second, body(99, (0, 0, 0), ZERO)]
        case "foreign_nan":
            return [body(99, (NAN, NAN, NAN)), first, second]
        case "own_zero":
            return [body(1, rotation=ZERO), second]
        case "nearly_unit":
            return [body(1, rotation=(0, 0, 0, 0.99)), second]
        case "own_nan_at_times":
            return [body(1, (NAN, 0, 0)) if int(now * 100) % 100 == 50 else first, second]
        case "freeze":
            return [first, second] if now < 2.5 else None
        case "lost_tail":
            return [first, body(2, tracked=now < 2.5)]
        case "millimetres":
            return [body(n, tuple(1000 * x for x in place)) for n, place in PLACES.items()]
        case "no_bodies":
            return []
        case "unicast" | "old":
            return None
    return [first, second]


NAMES = {
    "blank": [("robot-0 ", 1), ("robot-1", 2)],
    "capital": [("Robot-0", 1), ("robot-1", 2)],
    "one_body": [("robot-0", 1), ("robot-1", 1)],
    "twice": [("robot-0", 1), ("robot-0", 7), ("robot-1", 2)],
}


def section(count=0, content=b""):
    return struct.pack("<ii", count, len(content)) + content


def message(number, content):
    return struct.pack("<HH", number, len(content)) + content


def frame(number, stamp, all_bodies):
    content = struct.pack("<i", number) + 2 * section() + section(len(all_bodies), b"".join(all_bodies))
    content += 5 * section() + struct.pack("<iid3Qiihi", 0, 0, stamp, 0, 0, 0, int(stamp), 0, 0, 0)
    return message(7, content)


def model():
    content, names = b"", NAMES.get(scene, [("robot-0", 1), ("robot-1", 2)])
    for name, number in names:
        definition = name.encode() + b"\0" + struct.pack("<ii3fi", number, -1, 0, 0, 0, 0)
        content += struct.pack("<ii", 1, len(definition)) + definition
    return message(5, struct.pack("<i", len(names)) + content)


def description():
    version = [2, 10, 0, 0] if scene == "old" else [4, 1, 0, 0]
    connection = struct.pack("<QHB", 10_000_000, data_port, scene != "unicast") + socket.inet_aton(group)
    return message(1, b"Motive".ljust(256, b"\0") + bytes([3, 1, 0, 0] + version) + connection)


def open_socket(port):
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    opened.bind((HOST, port))
    opened.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(HOST))
    opened.setblocking(False)
    return opened


command, data = open_socket(command_port), open_socket(data_port)
began, heard = time.monotonic(), None
number, due = 0, began
while True:
    if select.select([command], [], [], max(0.0, due - time.monotonic()))[0]:
        try:
            request, client = command.recvfrom(4096)
        except OSError:
            continue
        heard = heard or time.monotonic()  # the scene begins with its first client
        match struct.unpack("<H", request[:2])[0]:
            case 0:
                command.sendto(description(), client)
            case 4:
                command.sendto(model(), client)
    if time.monotonic() >= due:
        due, number = due + 0.01, number + 1
        now = time.monotonic() - (heard or time.monotonic())
        all_bodies = bodies(now)
        if all_bodies is not None:
            stamp = 1000.0 + (min(now, 2.0) if scene == "frozen_stamp" else time.monotonic() - began)
            data.sendto(frame(number, stamp, all_bodies), (group, data_port))
