"""A stand-in for an autopilot with PX4 or ArduPilot, whose frames, signatures and types are those of pymavlink.

    python3 autopilot.py PORT [--firmware px4|ardupilot] [--vehicle rover|copter] [--system N] [--at EAST NORTH]
                         [--heading RAD] [--key HEX] [--one] [--latitude DEG] [--longitude DEG] [--log FILE]

It sends to UDP port PORT of this machine, as an autopilot does to its onboard computer. It is no PX4 and no ArduPilot:
it keeps the rules that their documentation states. PX4 enters OFFBOARD only while setpoints arrive, at 2 Hz at the
least, and leaves it COM_OF_LOSS_T after the last one; ArduPilot's rover stops 3 s after the last one. Its state is
exact, its rover turns at 2 rad/s at the most, and its copter climbs at once as fast as it is told.

Lines on its standard input: `mode NUMBER` (a pilot's change of the custom mode), `arm`, `disarm`, `fix N`, `battery N`,
`halt S` (it is silent for so long), `restart`, `double` (all is sent twice from now on), `lie` (numbers that cannot
be), `unsigned` (it signs no more), `drop N` (N of 100 datagrams are lost each way). The log has a JSON object for each
setpoint, command and state of mode and arming that has changed, with the time of the monotonic clock [s].
"""

import argparse
import json
import math
import os
import random
import select
import sys
import time

os.environ.setdefault("MAVLINK20", "1")
from pymavlink import mavutil  # noqa: E402
from pymavlink.dialects.v20 import development as mav  # noqa: E402

STEP_S = 0.01
OFFBOARD, PX4_HOLD, PX4_LAND, PX4_MANUAL = 6 << 16, 4 << 16 | 3 << 24, 4 << 16 | 6 << 24, 1 << 16
# Parameters: PX4 puts the bytes of whole numbers into the field of a float.
PARAMETERS = {
    "px4": {"COM_OF_LOSS_T": (1.0, 9), "COM_OBL_RC_ACT": (5, 6), "COM_RC_OVERRIDE": (1, 6)},
    "ardupilot": {"FS_GCS_ENABLE": (1.0, 2), "FS_ACTION": (2.0, 2), "FS_TIMEOUT": (1.5, 9), "GUID_TIMEOUT": (3.0, 9),
                  "FS_GCS_TIMEOUT": (5.0, 9)},
}


class Autopilot:
    def __init__(self, flags):
        self.flags = flags
        self.px4, self.copter = flags.firmware == "px4", flags.vehicle == "copter"
        self.link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{flags.port}", source_system=flags.system,
                                               source_component=1, dialect="development", force_mavlink1=flags.one)
        if flags.key:
            self.sign(bytes.fromhex(flags.key))
        self.log = open(flags.log, "a", buffering=1) if flags.log else None
        self.own = OFFBOARD if self.px4 else 4 if self.copter else 15
        self.land = PX4_LAND if self.px4 else 9
        self.mode = PX4_MANUAL if self.px4 else 0
        self.armed, self.status = False, mav.MAV_STATE_STANDBY
        self.east, self.north = flags.at
        self.yaw = math.pi / 2 - flags.heading
        self.up = self.vup = self.vn = self.ve = self.rate = 0.0
        self.climbs = None
        self.setpoint, self.set_at, self.stream = None, -1e9, []
        self.fix, self.battery = 6, 87
        self.boot = time.monotonic()
        self.intervals = {0: 1.0, 30: 0.1, 32: 0.1, 33: 0.2, 24: 0.2, 1: 1.0, 147: 1.0, 245: 1.0}
        self.due = {}
        self.silent_until, self.twice, self.lies, self.drop = 0.0, False, False, 0
        self.random = random.Random(1)

    def sign(self, key):
        self.link.setup_signing(key, sign_outgoing=True, allow_unsigned_callback=lambda *_: False)

    def note(self, **what):
        if self.log:
            self.log.write(json.dumps({"at": time.monotonic(), **what}) + "\n")

    def boot_ms(self):
        return int((time.monotonic() - self.boot) * 1000)

    def change(self, mode=None, armed=None):
        if mode is not None and mode != self.mode:
            self.mode = mode
            self.note(mode=mode)
            self.due[436] = 0.0
            if not self.px4:
                self.due[0] = 0.0  # ArduPilot says a heartbeat at each change.
        if armed is not None and armed != self.armed:
            self.armed = armed
            self.status = mav.MAV_STATE_ACTIVE if armed else mav.MAV_STATE_STANDBY
            self.note(armed=armed)
            self.due[0] = 0.0

    # Input

    def receive(self):
        while True:
            message = self.link.recv_msg()
            if message is None:
                return
            if self.drop and self.random.randrange(100) < self.drop:
                continue
            kind = message.get_type()
            if kind == "BAD_DATA" or getattr(message, "target_system", self.flags.system) != self.flags.system:
                self.note(refused=kind)
            elif kind == "COMMAND_LONG":
                self.command(message)
            elif kind == "SET_POSITION_TARGET_LOCAL_NED":
                self.target(message)
            elif kind == "PARAM_REQUEST_READ":
                self.parameter(message.param_id)
            elif kind == "HEARTBEAT":
                self.note(heartbeat=message.get_srcComponent())

    def target(self, message):
        now = time.monotonic()
        self.stream = [at for at in self.stream if now - at < 1.0] + [now]
        self.note(setpoint=[message.vx, message.vy, message.vz, message.yaw_rate], mask=message.type_mask,
                  frame=message.coordinate_frame)
        if all(math.isfinite(v) for v in (message.vx, message.vy, message.vz, message.yaw_rate)):
            self.setpoint, self.set_at = message, now

    def command(self, message):
        result = mav.MAV_RESULT_ACCEPTED
        if message.command == mav.MAV_CMD_DO_SET_MODE:
            result = self.ask_mode(int(message.param2), int(message.param3))
        elif message.command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
            self.note(ask_arm=message.param1, force=message.param2)
            on_ground = self.up < 0.05
            if message.param1 < 0.5 and not on_ground and message.param2 != 21196:
                result = mav.MAV_RESULT_DENIED
            else:
                self.change(armed=message.param1 > 0.5)
        elif message.command == mav.MAV_CMD_NAV_TAKEOFF:
            self.note(ask_takeoff=message.param7)
            if self.armed and self.mode == self.own and not self.px4:
                self.climbs = message.param7
            else:
                result = mav.MAV_RESULT_DENIED
        elif message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
            known = int(message.param1) in (*self.intervals, 436 if self.px4 else -1)
            if known:
                self.intervals[int(message.param1)] = message.param2 * 1e-6
            else:
                result = mav.MAV_RESULT_DENIED
        elif message.command == mav.MAV_CMD_REQUEST_MESSAGE and int(message.param1) == 49:
            latitude, longitude = self.flags.latitude, self.flags.longitude
            self.send(mav.MAVLink_gps_global_origin_message(round(latitude * 1e7), round(longitude * 1e7), 12000))
        else:
            result = mav.MAV_RESULT_UNSUPPORTED
        self.send(mav.MAVLink_command_ack_message(message.command, result))

    def ask_mode(self, main, sub):
        mode = main << 16 | sub << 24 if self.px4 else main
        self.note(ask_mode=mode, setpoints=len(self.stream))
        if mode == self.own and self.px4 and len(self.stream) < 3:
            return mav.MAV_RESULT_TEMPORARILY_REJECTED
        if mode not in (self.own, self.land):
            return mav.MAV_RESULT_DENIED
        self.change(mode=mode)
        return mav.MAV_RESULT_ACCEPTED

    def parameter(self, name):
        known = PARAMETERS[self.flags.firmware].get(name)
        if known:
            value, kind = known
            if self.px4 and kind == 6:
                import struct

                value = struct.unpack("<f", struct.pack("<i", value))[0]
            self.send(mav.MAVLink_param_value_message(name.encode(), value, kind, 1, 65535))

    def line(self, line):
        word, *rest = line.split()
        number = float(rest[0]) if rest else 0.0
        if word == "mode":
            self.change(mode=int(number))
        elif word in ("arm", "disarm"):
            self.change(armed=word == "arm")
        elif word == "halt":
            self.silent_until = time.monotonic() + number
        elif word == "restart":
            self.boot = time.monotonic()
            self.change(mode=PX4_MANUAL if self.px4 else 0, armed=False)
        elif word == "double":
            self.twice = True
        elif word == "lie":
            self.lies = True
        elif word == "unsigned":
            self.link.mav.signing.sign_outgoing = False
        elif word in ("fix", "battery", "drop"):
            setattr(self, word, int(number))

    # Motion

    def step(self, dt):
        now = time.monotonic()
        age = now - self.set_at
        loss = 1.0 if self.px4 else 3.0
        if self.px4 and self.mode == OFFBOARD and age > loss and self.armed:
            self.change(mode=PX4_HOLD)
        live = self.setpoint if self.armed and self.mode == self.own and age <= loss else None
        self.vn = self.ve = self.rate = self.vup = 0.0
        if live is not None and self.climbs is None and (not self.copter or self.up > 0.05 or live.vz < 0):
            self.follow(live, dt)
        if self.climbs is not None:
            self.vup = min(1.0, (self.climbs - self.up) / dt)
            if self.climbs - self.up < 0.01 or not self.armed:
                self.climbs = None
        if self.mode == self.land and self.armed:
            self.climbs, self.vup = None, -0.5
            if self.up <= 0.01:
                self.change(armed=False)
        if self.copter and not self.armed and self.up > 0:
            self.vup = -3.0
        self.north += self.vn * dt
        self.east += self.ve * dt
        self.up = max(0.0, self.up + self.vup * dt) if self.copter else 0.0
        self.yaw = (self.yaw + self.rate * dt + math.pi) % (2 * math.pi) - math.pi

    def follow(self, live, dt):
        if live.coordinate_frame == mav.MAV_FRAME_BODY_NED:
            self.rate = max(-2.0, min(2.0, live.yaw_rate))
            self.vn, self.ve = live.vx * math.cos(self.yaw), live.vx * math.sin(self.yaw)
        elif self.copter:
            self.vn, self.ve, self.vup = live.vx, live.vy, -live.vz
        else:
            # It turns to where it is to go, and drives ahead meanwhile as far as that is ahead.
            speed = math.hypot(live.vx, live.vy)
            if speed > 0.01:
                off = (math.atan2(live.vy, live.vx) - self.yaw + math.pi) % (2 * math.pi) - math.pi
                self.rate = max(-2.0, min(2.0, off / dt))
                ahead = speed * max(0.0, math.cos(off))
                self.vn, self.ve = ahead * math.cos(self.yaw), ahead * math.sin(self.yaw)

    # Output

    def send(self, message):
        if time.monotonic() < self.silent_until or (self.drop and self.random.randrange(100) < self.drop):
            return
        self.link.mav.send(message)
        if self.twice:
            self.link.mav.seq = (self.link.mav.seq - 1) % 256
            self.link.mav.send(message)

    def report(self):
        now = time.monotonic()
        for number, interval in list(self.intervals.items()):
            if interval > 0 and now >= self.due.get(number, 0.0):
                self.due[number] = now + interval
                message = self.message(number)
                if message is not None:
                    self.send(message)

    def message(self, number):
        boot, odd = self.boot_ms(), math.nan if self.lies else 0.0
        north_e7 = round((self.flags.latitude + self.north / 111_267.5) * 1e7)
        metre = 111_320.0 * math.cos(math.radians(self.flags.latitude)) * 1.00155
        east_e7 = round((self.flags.longitude + self.east / metre) * 1e7)
        if number == 0:
            kind = (mav.MAV_TYPE_QUADROTOR if self.copter else mav.MAV_TYPE_GROUND_ROVER)
            base = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mav.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
            firmware = mav.MAV_AUTOPILOT_PX4 if self.px4 else mav.MAV_AUTOPILOT_ARDUPILOTMEGA
            return mav.MAVLink_heartbeat_message(kind, firmware, base, self.mode, self.status, 3)
        if number == 436:
            return mav.MAVLink_current_mode_message(0, self.mode, 0)
        if number == 30:
            return mav.MAVLink_attitude_message(boot, 0, 0, self.yaw + odd, 0, 0, self.rate)
        if number == 32:
            return mav.MAVLink_local_position_ned_message(boot, self.north + odd, self.east, -self.up, self.vn, self.ve,
                                                          -self.vup)
        if number == 33:
            heading = round(math.degrees(self.yaw) % 360 * 100) % 36000
            latitude = 2_000_000_000 if self.lies else north_e7
            return mav.MAVLink_global_position_int_message(boot, latitude, east_e7, 12000, round(self.up * 1000),
                                                           round(self.vn * 100), round(self.ve * 100),
                                                           round(-self.vup * 100), heading)
        if number == 24:
            return mav.MAVLink_gps_raw_int_message(boot * 1000, self.fix, north_e7, east_e7, 12000, 50, 80, 0, 0, 22)
        if number == 1:
            return mav.MAVLink_sys_status_message(0, 0, 0, 100, 12_000, 100, self.battery, 0, 0, 0, 0, 0, 0)
        if number == 147:
            percent = 120 if self.lies else self.battery
            return mav.MAVLink_battery_status_message(0, 0, 1, 2500, [4000] * 10, 100, -1, -1, percent)
        if number == 245:
            state = mav.MAV_LANDED_STATE_IN_AIR if self.up > 0.05 else mav.MAV_LANDED_STATE_ON_GROUND
            return mav.MAVLink_extended_sys_state_message(0, state)
        return None

    def run(self):
        last, typed = time.monotonic(), b""
        while True:
            reads = [self.link.port.fileno(), sys.stdin.fileno()] if sys.stdin else [self.link.port.fileno()]
            ready, _, _ = select.select(reads, [], [], STEP_S)
            if sys.stdin and sys.stdin.fileno() in ready:
                read = os.read(sys.stdin.fileno(), 4096)
                if not read:
                    return
                *lines, typed = (typed + read).split(b"\n")
                for line in filter(None, lines):
                    self.line(line.decode())
            self.receive()
            now = time.monotonic()
            self.step(now - last)
            last = now
            self.report()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("port", type=int)
    parser.add_argument("--firmware", choices=["px4", "ardupilot"], default="px4")
    parser.add_argument("--vehicle", choices=["rover", "copter"], default="rover")
    parser.add_argument("--system", type=int, default=1)
    parser.add_argument("--at", type=float, nargs=2, default=[0.0, 0.0])
    parser.add_argument("--heading", type=float, default=0.0)
    parser.add_argument("--key")
    parser.add_argument("--one", action="store_true")
    parser.add_argument("--latitude", type=float, default=52.2053)
    parser.add_argument("--longitude", type=float, default=0.1218)
    parser.add_argument("--log")
    Autopilot(parser.parse_args()).run()


if __name__ == "__main__":
    main()
