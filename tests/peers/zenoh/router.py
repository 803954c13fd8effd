#!/usr/bin/env python3
"""A Zenoh router, from the package eclipse-zenoh: router.py ENDPOINT... Runs until it is killed."""

import json
import sys
import threading

import zenoh

config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps(sys.argv[1:]))
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
print("router", session.info.zid(), flush=True)
threading.Event().wait()
