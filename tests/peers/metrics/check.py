"""Puts every query of a Grafana dashboard to a Prometheus that scrapes two hosts and a simulation, for up to 60 s."""

import json
import sys
import time
import urllib.parse
import urllib.request

PROMETHEUS, DASHBOARD = sys.argv[1:]
# Of a healthy team these may be empty: nothing is refused, no guard acts.
MAY_BE_EMPTY = ("Refused datagrams a second", "Guards")


def query(expression):
    address = f"{PROMETHEUS}/api/v1/query?" + urllib.parse.urlencode({"query": expression})
    with urllib.request.urlopen(address, timeout=5) as answer:
        return json.load(answer)["data"]["result"]


def until(what, holds):
    end = time.monotonic() + 60
    while time.monotonic() < end:
        try:
            found = holds()
            if found:
                return found
        except OSError:
            pass
        time.sleep(0.5)
    raise SystemExit(f"FAILED: {what}")


up = until("three targets are up", lambda: [r for r in query("up == 1")] if len(query("up == 1")) == 3 else None)
print("targets up:", sorted(r["metric"]["instance"] for r in up))
until("episodes end", lambda: query("sum(murmurate_episodes_total) >= 2"))
failed = []
for panel in json.load(open(DASHBOARD))["panels"]:
    for target in panel["targets"]:
        result = until(panel["title"], lambda: query(target["expr"]) or panel["title"] in MAY_BE_EMPTY)
        series = 0 if result is True else len(result)
        first = "" if result is True else result[0]["value"][1]
        print(f"{panel['title']}: {series} series, {first}")
count = query('sum(murmurate_message_age_seconds_count{instance="127.0.0.1:19464"})')[0]["value"][1]
print("ages sampled:", count)
assert float(count) > 100, count
