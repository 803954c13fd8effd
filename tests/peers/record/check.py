"""Reads a record of `sim` with the MCAP readers of PyPI and compares it with the trajectories of the same run.

    python check.py RECORD.mcap TRAJECTORIES.csv

Needs mcap and mcap-protobuf-support. Exit code 1 where something differs.
"""

import collections
import csv
import json
import struct
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

TYPES = {
    "/scene": "SceneUpdate", "/tf": "FrameTransforms", "/robots": "PointCloud", "/log": "Log", "/truth": "Truth",
    "/robot/0/pose": "PoseInFrame",
}


def main(record, trajectories):
    with open(trajectories) as file:
        rows = [row for row in csv.DictReader(file) if row["repeat"] == "0"]
    expected = {(round(float(row["time_s"]) * 1e9), int(row["robot"])): (float(row["x_m"]), float(row["y_m"])) for row in rows}
    counts, worst, compared, drawn = collections.Counter(), 0.0, 0, 0.0
    truth, verdicts = {}, []
    with open(record, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        metadata = [(metadata.name, metadata.metadata) for metadata in reader.iter_metadata()]
        names = [name for name, _ in metadata]
        # At the beginning, and again at the end: either may be damaged.
        assert names == 2 * ["murmurate.run", "murmurate.stage", "murmurate.digest"], names
        assert metadata[:3] == metadata[3:], metadata
        for _, channel, message in reader.iter_messages():
            counts[channel.topic] += 1
            if channel.topic == "/episode":
                said = json.loads(message.data)
                verdicts += [said["verdict"]] if "verdict" in said else []
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=list(TYPES)):
            assert type(decoded).__name__ == TYPES[channel.topic], (channel.topic, type(decoded))
            if channel.topic == "/truth":
                for robot in decoded.robots:
                    at = decoded.timestamp.seconds * 10**9 + decoded.timestamp.nanos
                    x, y = expected.pop((at, robot.robot))
                    worst, compared = max(worst, abs(robot.x - x), abs(robot.y - y)), compared + 1
                    truth[robot.robot] = (robot.x, robot.y)
            if channel.topic == "/robots":
                for robot in range(len(decoded.data) // 16):
                    x, y, _, number = struct.unpack_from("<fffI", decoded.data, robot * 16)
                    drawn = max(drawn, abs(x - truth[number][0]), abs(y - truth[number][1]))
            if channel.topic == "/tf":
                for transform in decoded.transforms:
                    x, y = truth[int(transform.child_frame_id.split("_")[1].split("/")[0])]
                    drawn = max(drawn, abs(transform.translation.x - x), abs(transform.translation.y - y))
    assert set(TYPES) <= set(counts), counts
    assert compared > 500 and not expected, f"{compared} states compared, {len(expected)} of the table are missing"
    assert worst < 1e-6 and drawn < 1e-6, (worst, drawn)
    assert len(verdicts) == 2, verdicts
    print(f"{sum(counts.values())} messages on {len(counts)} topics; {compared} states equal to {worst:.1e} m")


if __name__ == "__main__":
    main(*sys.argv[1:])
