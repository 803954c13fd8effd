"""Holds the layouts of packaging/foxglove against records of a simulation and of a team, and a live connection.

    check.py PROGRAM

Each topic and each message path that a layout names must find a value of a kind that its panel shows, in messages that
this program wrote. The fields of each panel must be those of Foxglove's own `foxglove.layouts`. Needs mcap,
mcap-protobuf-support, foxglove-sdk and websockets of PyPI.
"""

import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import foxglove.layouts as layouts
from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from websockets.sync.client import connect

ROOT = Path(__file__).resolve().parents[3]
# Panels of a layout file, and the class of Foxglove's SDK with the same settings.
CLASSES = {
    "3D": layouts.ThreeDeeConfig,
    "Plot": layouts.PlotConfig,
    "StateTransitions": layouts.StateTransitionsConfig,
    "RosOut": layouts.LogConfig,
    "RawMessages": layouts.RawMessagesConfig,
}
DRAWN = {"foxglove.SceneUpdate", "foxglove.PointCloud", "foxglove.LaserScan", "foxglove.PoseInFrame"}
STEP = re.compile(r"\.?(\w+)|\[:\]|\[(\d+)\]|\{(\w+)==([^}]+)\}")


def panels(node):
    """Returns the ids of the panels in a layout's tree."""
    if isinstance(node, str):
        return [node]
    assert set(node) == {"direction", "first", "second", "splitPercentage"}, node
    assert node["direction"] in ("row", "column") and 0 < node["splitPercentage"] < 100, node
    return panels(node["first"]) + panels(node["second"])


def camel(name):
    first, *rest = name.split("_")
    return first + "".join(word.capitalize() for word in rest)


def shape(name, layout):
    """Checks a layout's outer form, and the names of all settings of its panels."""
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}, name
    shown = panels(layout["layout"])
    assert sorted(shown) == sorted(layout["configById"]), f"{name}: panels of the tree and settings differ"
    for panel, config in layout["configById"].items():
        known = {camel(parameter) for parameter in CLASSES[panel.split("!")[0]].__init__.__annotations__}
        wrong = set(config) - known - {"foxglovePanelTitle"}
        assert not wrong, f"{name}, {panel}: Foxglove has no {wrong}"


def steps(path):
    """Splits a message path into its topic and its steps."""
    topic = re.match(r"/[\w/-]+", path)[0]
    rest, found = path[len(topic) :], []
    while rest:
        step = STEP.match(rest)
        assert step, f"{path}: {rest}"
        found.append(step)
        rest = rest[step.end() :]
    return topic, found


def values(message, found, variables):
    """Returns what a message path finds in one message."""
    items = [message]
    for step in found:
        field, index, filtered, wanted = step.groups()
        if field:
            items = [item[field] for item in items if isinstance(item, dict) and field in item]
        elif index:
            items = [item[int(index)] for item in items if len(item) > int(index)]
        elif filtered:
            wanted = str(variables[wanted[1:]] if wanted.startswith("$") else wanted.strip('"'))
            items = [item for item in items if str(item.get(filtered)) == wanted]
        else:
            items = [part for item in items for part in item]
    return items


def fits(panel, value):
    """Whether a panel can show a value."""
    if panel == "Plot":
        return isinstance(value, (int, float))
    if panel == "StateTransitions":
        return isinstance(value, (int, str, bool))
    return value is not None


def wanted(config):
    """Returns all message paths of a panel's settings."""
    paths = [series["value"] for series in config.get("paths", [])]
    return paths + [config[key] for key in ("topicPath", "topicToRender") if key in config]


def check(name, schemas, messages, frames):
    """Checks a layout against messages by topic, the names of their schemas, and the frames of what is drawn."""
    layout = json.loads((ROOT / f"packaging/foxglove/{name}.json").read_text())
    shape(name, layout)
    for panel, config in layout["configById"].items():
        for topic in config.get("topics", {}):
            assert schemas.get(topic) in DRAWN, f"{name}: {topic} is {schemas.get(topic)}"
        if "followTf" in config:
            assert config["followTf"] in frames, f"{name}: {config['followTf']} is none of {frames}"
        for path in wanted(config):
            topic, found = steps(path)
            assert topic in messages, f"{name}: no topic {topic}"
            all_values = [v for m in messages[topic] for v in values(m, found, layout["globalVariables"])]
            right = [value for value in all_values if fits(panel.split("!")[0], value)]
            assert right, f"{name}: {path} finds nothing that {panel} shows: {all_values[:3]}"
            print(f"{name}: {path}: {len(right)} values, the last {str(right[-1])[:60]}")


def recorded(files):
    """Reads records: messages by topic as plain data, the names of schemas, and the frames of drawings."""
    messages, schemas, frames = {}, {}, set()
    for file in files:
        with open(file, "rb") as stream:
            for schema, channel, message, decoded in readable(stream):
                schemas[channel.topic] = schema.name
                if channel.message_encoding == "protobuf":
                    decoded = MessageToDict(
                        decoded, preserving_proto_field_name=True, always_print_fields_with_no_presence=True
                    )
                messages.setdefault(channel.topic, []).append(decoded)
                if schema.name == "foxglove.SceneUpdate":
                    frames.update(entity["frame_id"] for entity in decoded["entities"])
    return schemas, messages, frames


def readable(stream):
    """Yields all messages of a record whose encoding is Foxglove's or JSON."""
    factory, decoders = DecoderFactory(), {}
    for schema, channel, message in make_reader(stream).iter_messages():
        if channel.message_encoding == "json":
            yield schema, channel, message, json.loads(message.data)
        elif channel.message_encoding == "protobuf":
            if schema.id not in decoders:
                decoders[schema.id] = factory.decoder_for("protobuf", schema)
            yield schema, channel, message, decoders[schema.id](message.data)


def connection(address, seconds):
    """Subscribes to all topics of a live connection; returns what a record gives, of a few seconds."""
    messages, schemas, frames, by_id = {}, {}, set(), {}
    with connect(address, subprotocols=["foxglove.sdk.v1"]) as socket:
        assert json.loads(socket.recv())["op"] == "serverInfo"
        for channel in json.loads(socket.recv())["channels"]:
            by_id[channel["id"]], schemas[channel["topic"]] = channel, channel["schemaName"]
        subscriptions = [{"id": number, "channelId": number} for number in by_id]
        socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            frame = socket.recv()
            if not isinstance(frame, bytes) or frame[0] != 1:
                continue
            channel = by_id[int.from_bytes(frame[1:5], "little")]
            if channel["encoding"] == "json":
                messages.setdefault(channel["topic"], []).append(json.loads(frame[13:]))
            elif b"world" in frame:
                frames.add("world")
    return schemas, messages, frames


def main():
    program = sys.argv[1]
    with tempfile.TemporaryDirectory() as work:
        run = [
            program,
            "sim",
            "--mode",
            "offboard",
            "--episodes",
            "2",
            "--repeats",
            "1",
            "--quiet",
            "--record",
            f"{work}/sim",
        ]
        subprocess.run(run, check=True, stdout=subprocess.DEVNULL)
        team = [program, "launch", str(ROOT / "teams/offboard.toml"), "--set", "episodes=1", "--set", "team=4713"]
        subprocess.run([*team, "--record", f"{work}/team"], check=True, stdout=subprocess.DEVNULL)
        check("record", *recorded(sorted(Path(work).glob("*/*.mcap"))))
        watched = [program, "sim", "--watch", "--foxglove", "--mode", "offboard", "--episodes", "100", "--quiet"]
        with subprocess.Popen(watched, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as page:
            try:
                address = next(line.split()[1] for line in page.stdout if line.startswith("foxglove: "))
                # A guard has acted and a line is in the log after the first episode.
                check("live", *connection(address, 12))
            finally:
                page.terminate()
    print("both layouts name what is there")


if __name__ == "__main__":
    main()
