"""A gpsd that plays a scene to each client: lib_gpsd.py SCENE PORT [ADDRESS]

Reports have the fields of gpsd 3.25. The receiver stands at the origin of the teams of these cases.
"""

import datetime
import json
import socket
import sys
import threading
import time

scene, port = sys.argv[1], int(sys.argv[2])
BEGAN = datetime.datetime(2026, 11, 22, 12)


def stamp(seconds, began=BEGAN):
    return (began + datetime.timedelta(seconds=seconds)).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"


def tpv(seconds, **other):
    report = {"class": "TPV", "device": "/dev/ttyACM0", "mode": 3, "status": 3, "time": stamp(seconds), "lat": 52.2053}
    report |= {"lon": 0.1218, "altHAE": 60.0, "track": 90.0, "speed": 0.0, "eph": 11.4}
    return {name: value for name, value in (report | other).items() if value is not None}


def leap(tenth):
    """Ten reports a second over a leap second: 23:59:58 to 23:59:60.9, then the next day."""
    if tenth < 20:
        return f"2026-12-31T23:59:{58 + tenth / 10:06.3f}Z"
    if tenth < 30:
        return f"2026-12-31T23:59:{60 + (tenth - 20) / 10:06.3f}Z"
    return stamp((tenth - 30) / 10, datetime.datetime(2027, 1, 1))


def reports(tenth):
    """The reports of one tenth of a second."""
    now = tenth / 10
    match scene:
        case "no_track":
            return [tpv(now, speed=0.6, track=None)]
        case "no_speed":
            return [tpv(now, speed=None, track=None)]
        case "stale":
            return [tpv(now) if tenth < 20 else {"class": "TPV", "device": "/dev/ttyACM0", "mode": 1}]
        case "frozen":
            return [tpv(min(now, 2.0))]
        case "far":
            return [tpv(now, lat=0.0, lon=0.0)]
        case "no_rtk":
            return [tpv(now, status=1)]
        case "no_time":
            return [tpv(now, time=None)]
        case "sky":
            return [{"class": "SKY", "device": "/dev/ttyACM0", "satellites": []}]
        case "none":
            return [{"class": "DEVICES", "devices": []}] if tenth == 0 else []
        case "two":
            return [tpv(now), tpv(now + 0.05, device="/dev/ttyUSB1", lat=52.20531)]
        case "leap":
            return [tpv(0, time=leap(tenth))]
        case "clock_back":
            return [tpv(now - (0.5 if tenth >= 30 else 0.0))]
    return [tpv(now)]


def serve(client):
    def send(report):
        client.sendall(json.dumps(report).encode() + b"\r\n")

    try:
        send({"class": "VERSION", "release": "3.25", "rev": "3.25", "proto_major": 3, "proto_minor": 15})
        client.recv(4096)
        began, tenth = time.monotonic(), 0
        while True:
            time.sleep(max(0.0, began + tenth / 10 - time.monotonic()))
            for report in reports(tenth):
                send(report)
            tenth += 1
    except OSError:
        client.close()


listener = socket.socket()
listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
listener.bind((sys.argv[3] if len(sys.argv) > 3 else "127.0.0.1", port))
listener.listen(4)
while True:
    threading.Thread(target=serve, args=(listener.accept()[0],), daemon=True).start()
