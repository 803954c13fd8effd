"""Damages a record: lib_damage.py KIND RECORD.mcap OUT.mcap. Needs mcap, zstandard and lz4."""

import struct
import sys

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

CHUNK, ATTACHMENT = 6, 9


def elements(data):
    """Opcode, place of the content and its length, of each element of a whole file."""
    at = 8
    while at < len(data) - 8:
        length = struct.unpack_from("<Q", data, at + 1)[0]
        yield data[at], at + 9, length
        at += 9 + length


def copy(source, out, compression):
    """What `mcap compress` makes of a record, message by message."""
    with open(out, "wb") as file, open(source, "rb") as original:
        writer, reader = Writer(file, compression=compression), make_reader(original)
        writer.start(library="copy")
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        for file in reader.iter_attachments():
            writer.add_attachment(file.create_time, file.log_time, file.name, file.media_type, file.data)
        summary = reader.get_summary()
        schemas = {id: writer.register_schema(one.name, one.encoding, one.data) for id, one in summary.schemas.items()}
        channels = {
            id: writer.register_channel(one.topic, one.message_encoding, schemas.get(one.schema_id, 0), one.metadata)
            for id, one in summary.channels.items()
        }
        for _, channel, message in reader.iter_messages(log_time_order=False):
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
        writer.finish()


def foreign(out):
    """Two channels of one topic, each with a schema and properties of its own, as rosbag2 writes them."""
    with open(out, "wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="rosbag2")
        channels = []
        for name, quality in (("Twist", "x"), ("TwistStamped", "y")):
            schema = writer.register_schema("geometry_msgs/msg/" + name, "ros2msg", name.encode())
            channels.append(writer.register_channel("/cmd_vel", "cdr", schema, {"offered_qos_profiles": quality}))
        for number in range(50):
            at = 10**9 + number * 10**7
            text = f"{'ST'[number % 2]}{number:02}".encode()
            writer.add_message(channels[1 - number % 2], at, text, at - 5 * 10**6, number)
        writer.finish()


def main(kind, source, out):
    if kind in ("zstd", "lz4"):
        return copy(source, out, CompressionType[kind.upper()])
    if kind in ("foreign", "twochannels"):
        foreign(out)
        if kind == "twochannels":
            data = open(out, "rb").read()
            open(out, "wb").write(data[:2500])
        return None
    data = bytearray(open(source, "rb").read())
    half = len(data) // 2
    if kind == "flip":
        # The sign of a robot's true position, in one message.
        truths = make_reader(open(source, "rb")).iter_messages(topics=["/truth"])
        message = [message.data for _, _, message in truths][60]
        data[bytes(data).find(message) + message.find(b"\x11", 10) + 8] ^= 0x80
    elif kind == "attachment":
        _, at, length = next(one for one in elements(data) if one[0] == ATTACHMENT)
        data[at + length - 20] ^= 1
    elif kind == "metadata":
        data[bytes(data).find(b"anchor_ns") + 15] ^= 1
    elif kind == "zeros":
        data = data[:half] + bytes(65536)
    elif kind == "cut":
        data = data[:half]
    elif kind == "hole":
        data[half:half + 4096] = bytes(4096)
    elif kind == "empty":
        data = b""
    elif kind == "zeroed":
        data = bytes(len(data))
    else:
        sys.exit(f"{kind}: no such kind")
    open(out, "wb").write(bytes(data))
    return None


main(*sys.argv[1:4])
