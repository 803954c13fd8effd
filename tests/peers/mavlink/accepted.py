"""The stand-in autopilot before a client of another hand: MAVSDK finds it, arms it, and drives it in OFFBOARD.

    python3 accepted.py

PYTHON has pymavlink and mavsdk (>= 4). Prints what MAVSDK was told and measured; exit code 1 if it was refused.
"""

import math
import subprocess
import sys
import time
from pathlib import Path

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Offboard, VelocityNedYaw
from mavsdk.plugins.telemetry import Telemetry

PORT = 14_791


def wait(what, seconds=20.0):
    """Waits until `what()` is true."""
    until = time.monotonic() + seconds
    while not what():
        if time.monotonic() > until:
            return False
        time.sleep(0.02)
    return True


def main():
    peer = Path(__file__).parent / "autopilot.py"
    autopilot = subprocess.Popen([sys.executable, peer, str(PORT)], stdin=subprocess.PIPE, text=True)
    checks = {}
    try:
        client = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        client.add_any_connection(f"udpin://127.0.0.1:{PORT}")
        system = client.first_autopilot(10.0)
        checks["is found"] = system is not None
        telemetry, action, offboard = Telemetry(system), Action(system), Offboard(system)
        checks["tells its position"] = wait(lambda: telemetry.position_velocity_ned() is not None)
        # Without setpoints it stays out of OFFBOARD.
        try:
            offboard.start()
            checks["refuses OFFBOARD without setpoints"] = False
        except Exception:
            checks["refuses OFFBOARD without setpoints"] = True
        still = VelocityNedYaw(0.0, 0.0, 0.0, 0.0)
        offboard.set_velocity_ned(still)
        time.sleep(1.0)
        offboard.start()
        checks["is in OFFBOARD"] = wait(lambda: telemetry.flight_mode().name == "OFFBOARD")
        action.arm()
        checks["is armed"] = wait(telemetry.armed)
        offboard.set_velocity_ned(VelocityNedYaw(0.5, 0.0, 0.0, 0.0))
        moved = wait(lambda: telemetry.position_velocity_ned().position.north_m > 0.5)
        checks["drives north by VelocityNedYaw"] = moved
        autopilot.stdin.write("mode 65536\n")
        autopilot.stdin.flush()
        checks["says a pilot's mode"] = wait(lambda: telemetry.flight_mode().name == "MANUAL")
        percent = lambda: telemetry.battery().remaining_percent  # noqa: E731
        checks["says its battery"] = wait(lambda: not math.isnan(percent()) and abs(percent() - 87) < 0.5)
        client.destroy()
    finally:
        autopilot.kill()
    for what, passed in checks.items():
        print(f"MAVSDK: the stand-in {what}: {'ok' if passed else 'MISSED'}")
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
