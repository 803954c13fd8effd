#!/usr/bin/env python3
"""A Zenoh router, from the package eclipse-zenoh: router.py [FILE.json5] ENDPOINT... Runs until it is killed.

FILE.json5 is a configuration file of Zenoh's, such as one with certificates.
"""

import json
import sys
import threading

import zenoh

arguments = sys.argv[1:]
config = zenoh.Config.from_file(arguments.pop(0)) if arguments[0].endswith(".json5") else zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps(arguments))
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
print("router", session.info.zid(), flush=True)
threading.Event().wait()
