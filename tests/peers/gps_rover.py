"""A rover without odometry whose position is told by a satellite receiver behind a real gpsd.

    python3 gps_rover.py rover --log FILE --port GPSD_PORT X Y               the rover, its receiver and its gpsd
    python3 gps_rover.py receiver --port GPSD_PORT                           the receiver and its gpsd, on another robot
    python3 gps_rover.py drive GPSD_PORT                                     its program for the driver `program`

The rover moves at the commanded velocity of the world frame, as an autopilot with a compass does, until the command has
expired. Its receiver writes NMEA (GGA, RMC, GST; RTK fixed) of where the rover is now to a pseudo terminal ten times a
second, and gpsd reads it as a serial port. The log has a line for each step: time [s], speed [m/s]. A receiver on another
robot is told by datagrams of JSON where that is: x, y, vx, vy. SIGUSR1 halts gpsd (SIGSTOP), SIGUSR2 lets it go on. Root,
apt: gpsd.
"""

import argparse
import json
import math
import os
import pty
import select
import signal
import socket
import subprocess
import sys
import time
import tty

PERIOD_S, FIX_S = 0.02, 0.1
# Origin of the team's frame: the default of teams/rtk.toml.
LATITUDE_DEG, LONGITUDE_DEG = 52.2053, 0.1218


def here(port):
    """Where the rover takes datagrams: the UDP port with the number of its gpsd's TCP port."""
    return ("127.0.0.1", port)


def sentence(text):
    """An NMEA sentence with its checksum."""
    checksum = 0
    for byte in text.encode():
        checksum ^= byte
    return f"${text}*{checksum:02X}\r\n"


def degrees(value, digits):
    """Degrees and minutes, as NMEA writes them."""
    return f"{int(value):0{digits}d}{(value - int(value)) * 60:010.7f}"


def nmea(x, y, vx, vy):
    """What an RTK receiver at this place [m] with this velocity [m/s] writes now."""
    # Radii of curvature of WGS 84 at the origin [m]: exact enough for some metres around it.
    sin = math.sin(math.radians(LATITUDE_DEG))
    bend = 1 - 0.00669437999014 * sin * sin
    meridian, normal = 6378137 * (1 - 0.00669437999014) / bend**1.5, 6378137 / math.sqrt(bend)
    latitude = LATITUDE_DEG + math.degrees(y / meridian)
    longitude = LONGITUDE_DEG + math.degrees(x / normal / math.cos(math.radians(LATITUDE_DEG)))
    now = time.time()
    clock = time.strftime("%H%M%S", time.gmtime(now)) + f"{now % 1:.2f}"[1:]
    place = f"{degrees(latitude, 2)},N,{degrees(longitude, 3)},E"
    knots, course = math.hypot(vx, vy) / 0.514444, math.degrees(math.atan2(vx, vy)) % 360
    return (
        sentence(f"GNGGA,{clock},{place},4,20,0.6,12.0,M,46.0,M,1.0,0001")
        + sentence(f"GNRMC,{clock},A,{place},{knots:.3f},{course:.1f},{time.strftime('%d%m%y', time.gmtime(now))},,,R")
        + sentence(f"GNGST,{clock},0.02,0.01,0.01,0.0,0.010,0.010,0.015")
    )


def drive(port):
    """Hands each command of the host to the rover."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for line in sys.stdin:
        link.sendto(line.encode(), here(port))


class Receiver:
    """A receiver on a pseudo terminal, and the gpsd that reads it."""

    def __init__(self, port):
        self.out, slave = pty.openpty()
        tty.setraw(slave)
        # gpsd gives up root before it opens the terminal.
        os.chmod(os.ttyname(slave), 0o666)
        os.set_blocking(self.out, False)
        command = ["gpsd", "-N", "-n", "-b", "-S", str(port), os.ttyname(slave)]
        self.gpsd = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        self.fix_at = time.monotonic()
        signal.signal(signal.SIGUSR1, lambda *_: self.gpsd.send_signal(signal.SIGSTOP))
        signal.signal(signal.SIGUSR2, lambda *_: self.gpsd.send_signal(signal.SIGCONT))
        signal.signal(signal.SIGTERM, lambda *_: sys.exit())

    def measure(self, now, *motion):
        if now < self.fix_at:
            return
        self.fix_at = max(self.fix_at + FIX_S, now)
        try:
            os.write(self.out, nmea(*motion).encode())
        except BlockingIOError:
            # The halted gpsd reads nothing: a serial port loses bytes as well.
            pass

    def close(self):
        self.gpsd.kill()
        self.gpsd.wait()


def run(port, log, x=None, y=None):
    """Moves a rover from this start, or, without one, takes its motion from datagrams."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(here(port))
    receiver = Receiver(port)
    vx, vy, until, step_at = 0.0, 0.0, 0.0, time.monotonic()
    try:
        while True:
            if select.select([link], [], [], max(0.0, step_at - time.monotonic()))[0]:
                told = json.loads(link.recv(4096))
                x, y = told.get("x", x), told.get("y", y)
                vx, vy, until = told["vx"], told["vy"], time.monotonic() + told.get("for_s", 0.0)
            now = time.monotonic()
            if now < step_at:
                continue
            step_at += PERIOD_S
            if log:
                vx, vy = (vx, vy) if now < until else (0.0, 0.0)
                x, y = x + PERIOD_S * vx, y + PERIOD_S * vy
                log.write(f"{now:.4f} {math.hypot(vx, vy):.4f}\n")
                log.flush()
            if x is not None:
                receiver.measure(now, x, y, vx, vy)
    finally:
        receiver.close()


def main():
    parser = argparse.ArgumentParser()
    roles = parser.add_subparsers(dest="role", required=True)
    roles.add_parser("drive").add_argument("port", type=int)
    rover, receiver = roles.add_parser("rover"), roles.add_parser("receiver")
    for role in (rover, receiver):
        role.add_argument("--port", type=int, required=True)
    rover.add_argument("--log", required=True)
    rover.add_argument("x", type=float)
    rover.add_argument("y", type=float)
    options = parser.parse_args()
    if options.role == "drive":
        drive(options.port)
    elif options.role == "receiver":
        run(options.port, None)
    else:
        with open(options.log, "w") as log:
            run(options.port, log, options.x, options.y)


if __name__ == "__main__":
    main()
