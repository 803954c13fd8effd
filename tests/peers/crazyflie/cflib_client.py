"""Judges the fake Crazyflie by PyPI's cflib over its udp:// link: connect, tables, log, parameters, flight.

python3 cflib_client.py URI: says one line for each part, and fails at the first that does not hold."""

import sys
import threading
import time

import cflib.crtp
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie

heard = {}


def log(cf, name, variables):
    block = LogConfig(name=name, period_in_ms=20)
    for variable in variables:
        block.add_variable(variable)
    cf.log.add_config(block)
    block.data_received_cb.add_callback(lambda _, data, __: heard.update(data, count=heard.get("count", 0) + 1))
    block.start()


def holds(what, condition, detail=""):
    print(("ok  " if condition else "FAIL"), what, detail, flush=True)
    if not condition:
        sys.exit(1)


def until(what, condition, most_s=5.0):
    end = time.monotonic() + most_s
    while not condition():
        if time.monotonic() > end:
            holds(what, False, str(heard))
        time.sleep(0.02)
    holds(what, True)


cflib.crtp.init_drivers()
with SyncCrazyflie(sys.argv[1], cf=Crazyflie(rw_cache=None)) as synced:
    cf = synced.cf
    synced.wait_for_params()
    holds("connected, protocol version", cf.platform.get_protocol_version() == 12)
    logs = sum(len(group) for group in cf.log.toc.toc.values())
    params = sum(len(group) for group in cf.param.toc.toc.values())
    holds("tables of contents", (logs, params) == (72, 69), f"{logs} log variables, {params} parameters")
    holds("a parameter is read", cf.param.get_value("deck.bcFlow2") == "1")
    updated = threading.Event()
    cf.param.add_update_callback("stabilizer", "estimator", lambda _, value: value == "2" and updated.set())
    cf.param.set_value("stabilizer.estimator", 2)
    holds("a parameter is written", updated.wait(2.0))
    estimate = ["stateEstimate.x", "stateEstimate.y", "stateEstimate.z", "stateEstimate.yaw"]
    log(cf, "state", [*estimate, "pm.batteryLevel", "supervisor.info"])
    until("a log block arrives", lambda: heard.get("count", 0) > 20)
    holds("the supervisor answers", "Can fly" in cf.supervisor.read_state_list() and not cf.supervisor.is_flying)
    end = time.monotonic() + 1.5
    while time.monotonic() < end:
        cf.loc.send_extpose([0.4, -0.2, heard["stateEstimate.z"]], [0.0, 0.0, 0.0, 1.0])
        time.sleep(0.02)
    holds("poses move its estimate", abs(heard["stateEstimate.x"] - 0.4) < 0.1, str(heard))
    cf.high_level_commander.takeoff(0.5, 1.5, yaw=None)
    until("it takes off", lambda: heard["stateEstimate.z"] > 0.45 and cf.supervisor.is_flying)
    x = heard["stateEstimate.x"]
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        cf.commander.send_hover_setpoint(0.3, 0.0, 0.0, 0.5)
        time.sleep(0.05)
    holds("hover setpoints move it", 0.15 < heard["stateEstimate.x"] - x < 0.4, str(heard))
    y = heard["stateEstimate.y"]
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        cf.commander.send_velocity_world_setpoint(0.0, -0.3, 0.0, 0.0)
        time.sleep(0.05)
    holds("velocity setpoints move it", -0.4 < heard["stateEstimate.y"] - y < -0.15, str(heard))
    cf.high_level_commander.land(0.0, 1.5, yaw=None)
    time.sleep(0.3)
    holds("without the end of setpoints it does not land", heard["stateEstimate.z"] > 0.45, str(heard))
    cf.commander.send_notify_setpoint_stop()
    cf.high_level_commander.land(0.0, 1.5, yaw=None)
    until("it lands", lambda: heard["stateEstimate.z"] < 0.05 and not cf.supervisor.is_flying)
    cf.high_level_commander.stop()
