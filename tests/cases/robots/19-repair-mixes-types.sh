#!/usr/bin/env bash
# A repair of another program's cut file, with two channels of one topic: every message keeps its channel, schema, properties,
# times and number.
. "$(dirname "$0")/lib_records.sh"
damage twochannels - bag.mcap
cp bag.mcap before.mcap
try "$program" record repair bag.mcap
[ $code = 0 ] && [ -e bag.mcap.cut ] || fail "repair: $code $said"
cmp -s bag.mcap.cut before.mcap || fail "the original is not kept"
"$python" - bag.mcap <<'PY' || fail "messages are mixed"
import sys
from mcap.reader import make_reader
reader = make_reader(open(sys.argv[1], "rb"), validate_crcs=True)
assert reader.get_header().profile == "ros2"
found = list(reader.iter_messages(log_time_order=False))
assert len(found) == 50, len(found)
for schema, channel, message in found:
    kind, number = message.data[:1], int(message.data[1:])
    name, quality = {b"T": ("Twist", "x"), b"S": ("TwistStamped", "y")}[kind]
    assert schema.name == "geometry_msgs/msg/" + name and schema.data == name.encode(), schema
    assert channel.topic == "/cmd_vel" and channel.metadata == {"offered_qos_profiles": quality}, channel
    assert message.log_time - message.publish_time == 5 * 10**6 and message.sequence == number, message
PY
