"""Kills one of six hosts that a Prometheus scrapes, then stops the team, and waits for the alerts of both.

alerts.py PROMETHEUS PID STOP...
"""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.parse
import urllib.request

PROMETHEUS, PID, *STOP = sys.argv[1:]


def query(expression):
    address = f"{PROMETHEUS}/api/v1/query?" + urllib.parse.urlencode({"query": expression})
    with urllib.request.urlopen(address, timeout=5) as answer:
        return json.load(answer)["data"]["result"]


def firing(name):
    return query(f'ALERTS{{alertname="{name}", alertstate="firing"}}')


def until(what, holds):
    """Returns what `holds` gives once it is true, and after how many seconds; ends the program after 60 s."""
    began = time.monotonic()
    while time.monotonic() < began + 60:
        try:
            if found := holds():
                return found, time.monotonic() - began
        except OSError:
            pass
        time.sleep(0.2)
    raise SystemExit(f"FAILED: {what}")


until("six hosts are up", lambda: len(query("up == 1")) == 6)
until("the team runs", lambda: query("sum(murmurate_messages_total) > 500"))
for name in ("MurmurateHostDown", "MurmurateEmergencyStop"):
    assert not firing(name), f"{name} fires for a healthy team"
os.kill(int(PID), signal.SIGKILL)
found, after = until("the alert of a killed host", lambda: firing("MurmurateHostDown"))
assert [alert["metric"]["instance"] for alert in found] == ["127.0.0.1:19472"], found
print(f"MurmurateHostDown fires {after:.1f} s after the kill, for agent-0 alone")
# Robot 0 has no agent that could confirm, so the command's own exit code is 1.
stopped = subprocess.run(STOP, capture_output=True, text=True)
print(" ".join((stopped.stdout + stopped.stderr).split())[:200])
_, after = until("the alert of a stop", lambda: firing("MurmurateEmergencyStop"))
print(f"MurmurateEmergencyStop fires {after:.1f} s after the stop")
_, after = until("the alert of a stop that one robot does not confirm", lambda: firing("MurmurateStopUnconfirmed"))
print(f"MurmurateStopUnconfirmed fires {after:.1f} s after that")
