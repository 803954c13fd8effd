"""The driver before MAVSDK's own autopilot (ActionServer, TelemetryServer): modes, arming, a pilot who takes over.

    python3 server.py MURMURATE

MAVSDK's autopilot calls itself neither PX4 nor ArduPilot (autopilot 0, type 0), with the modes of PX4. A relay puts 12 (PX4) and 10
(rover) into its heartbeats, and passes all else on as it is. PYTHON has pymavlink and mavsdk (>= 4). Exit code 1 if a bar is missed.
"""

import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

os.environ.setdefault("MAVLINK20", "1")
from mavsdk import ComponentType, Configuration, Mavsdk  # noqa: E402
from mavsdk.plugins.action_server import ActionServer, AllowableFlightModes, FlightMode  # noqa: E402
from mavsdk.plugins.telemetry_server import (  # noqa: E402
    PositionNed,
    PositionVelocityNed,
    TelemetryServer,
    VelocityNed,
)
from pymavlink.dialects.v20 import common as mav  # noqa: E402
from teams import missed, program_of, team_file, wait  # noqa: E402

SERVER, PORT = 14_781, 14_771


class Relay(threading.Thread):
    """Passes datagrams between MAVSDK's autopilot and the driver, and notes what the driver sends."""

    def __init__(self):
        super().__init__(daemon=True)
        self.server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.server.bind(("127.0.0.1", SERVER))
        self.driver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.driver.connect(("127.0.0.1", PORT))
        self.back = None
        self.setpoints, self.commands, self.changed, self.mode = [], [], None, None

    def run(self):
        threading.Thread(target=self.answers, daemon=True).start()
        parser, out = mav.MAVLink(None), mav.MAVLink(None, srcSystem=1, srcComponent=1)
        while True:
            data, self.back = self.server.recvfrom(2048)
            for message in parser.parse_buffer(data) or []:
                if message.get_type() == "HEARTBEAT":
                    message.autopilot, message.type = mav.MAV_AUTOPILOT_PX4, mav.MAV_TYPE_GROUND_ROVER
                    if self.mode not in (None, message.custom_mode):
                        self.changed = time.monotonic()
                    self.mode = message.custom_mode
                    data = message.pack(out)
                    out.seq = (out.seq + 1) % 256
                try:
                    self.driver.send(data if message.get_type() == "HEARTBEAT" else message.get_msgbuf())
                except ConnectionRefusedError:
                    pass

    def answers(self):
        parser = mav.MAVLink(None)
        while True:
            try:
                data = self.driver.recv(2048)
            except ConnectionRefusedError:
                continue
            for message in parser.parse_buffer(data) or []:
                if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
                    self.setpoints.append(time.monotonic())
                elif message.get_type() == "COMMAND_LONG":
                    self.commands.append(message.command)
            if self.back:
                self.server.sendto(data, self.back)


def main():
    program, folder = program_of(sys.argv), Path(os.environ.get("TMPDIR", "/tmp"))
    relay = Relay()
    relay.start()
    autopilot = Mavsdk(Configuration.create_with_component_type(ComponentType.AUTOPILOT))
    autopilot.add_any_connection(f"udpout://127.0.0.1:{SERVER}")
    component = autopilot.server_component(0)
    action, telemetry = ActionServer(component), TelemetryServer(component)
    action.set_armable(True, True)
    action.set_disarmable(True, True)
    action.set_allowable_flight_modes(AllowableFlightModes(True, True, True))
    armed, modes = [], []
    action.subscribe_arm_disarm(lambda *said: armed.append((time.monotonic(), said)))
    action.subscribe_flight_mode_change(lambda *said: modes.append((time.monotonic(), said)))

    def publish():
        while host.poll() is None:
            still = PositionVelocityNed(PositionNed(0.0, 0.0, 0.0), VelocityNed(0.0, 0.0, 0.0))
            telemetry.publish_position_velocity_ned(still)
            time.sleep(0.04)

    team = team_file(folder, "px4", PORT)
    log = open(folder / "server.err", "w+")
    host = subprocess.Popen([program, "host", str(team), "--robot", "0"], stdout=subprocess.DEVNULL, stderr=log)
    publisher = threading.Thread(target=publish, daemon=True)
    publisher.start()
    try:
        bars = []
        asked = wait(lambda: relay.mode == 6 << 16, 20.0)
        bars.append(("MAVSDK's autopilot is in OFFBOARD", bool(modes), bool(asked and modes)))
        first = modes[0][0] if modes else time.monotonic()
        before = sum(1 for at in relay.setpoints if at < first)
        bars.append(("setpoints before its mode was asked for", before, before >= 15))
        bars.append(("MAVSDK's autopilot was armed", bool(armed), bool(wait(lambda: armed, 10.0))))
        time.sleep(1.0)
        relay.changed = None
        action.set_flight_mode(FlightMode.MANUAL)
        changed = wait(lambda: relay.changed, 10.0)
        time.sleep(2.5)
        late = max([at - changed for at in relay.setpoints if at > changed], default=0.0) if changed else None
        bars.append(("MAVSDK's pilot: last setpoint after his mode was told", late and f"{1000 * late:.0f} ms" or late,
                     late is not None and late <= 0.1))
        log.seek(0)
        said = log.read()
        bars.append(("the pilot is named", "the pilot took over" in said, "the pilot took over: mode MANUAL" in said))
        failed = missed(bars)
        if failed:
            print(said[-3000:], modes, armed)
        return 1 if failed else 0
    finally:
        host.kill()
        host.wait()
        publisher.join()


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    # Threads of the library do not end by themselves.
    os._exit(code)
