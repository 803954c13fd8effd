#!/usr/bin/env python3
"""One participant of a messaging benchmark whose middleware is used from Python: ROS 2 (rclpy) or Zenoh.

    NP_VARIANT=... python participant.py ros|zenoh

Environment variables configure it (`NP_ID`, `NP_N`, `NP_RATE`, ...), and it writes its results to files in `NP_DIR`, as
participant.rs does. A message has 152 bytes: sender, sequence number, timestamp, two floats of position, 32 floats;
with `NP_BYTES` as many as that, filled up with zeros.

Variants of `ros`, on Fast DDS over UDP, which is unicast:
- `rel`: reliable, KEEP_LAST of `NP_DEPTH` (10), as ROS 2 has it by default.
- `be`: best effort.
- `noack`: reliable without positive acknowledgements, by the profiles of noack.xml.
Their nodes have what a node has by default: services of parameters and a topic of logs. With `-bare` they have neither.
Variants of `zenoh`, all of mode `peer`:
- `rel`: unicast over TCP, reliable, and a congested link holds up the sender.
- `drop`: the same, but a congested link drops messages, as Zenoh has it by default.
- `be`: unicast over UDP, best effort, drops.
- `mc`: multicast over UDP, best effort, drops. Peers meet in the group, without scouting.

Delays and processor time include Python's own: docs/evidence/lab.md says how much."""
import array
import json
import os
import resource
import struct
import sys
import threading
import time

# Flag in the sequence number of a hello.
HELLO = 0x80000000
# Sender, sequence number, timestamp [ns], position, and 32 floats.
MESSAGE = struct.Struct("<IIQ2f32f")
# Resolution of reported delays [ns].
STEP = 1000
GROUP = "224.0.0.231:7448"
now = time.monotonic_ns


def variable(name, default):
    text = os.environ.get(name, "")
    return type(default)(text) if text else default


def sleep_until(ns):
    if ns > now():
        time.sleep((ns - now()) / 1e9)


def cpu():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime, usage.ru_stime


class Participant:
    """What every participant does: its schedule, its measurements and its report."""

    def __init__(self):
        self.id, self.number = variable("NP_ID", 0), variable("NP_N", 2)
        self.lock = threading.Lock()
        self.mesh = 0
        self.heard = set()
        self.last_arrival = 0
        self.seen = [set() for _ in range(self.number)]
        self.duplicates = [0] * self.number
        self.out_of_order = [0] * self.number
        self.last = [-1] * self.number
        self.delays = {}
        self.size = max(MESSAGE.size, variable("NP_BYTES", MESSAGE.size))
        self.floats = [0.5 * (self.id + 1) + at for at in range(32)]

    def wait(self):
        """Waits until participants may touch the network."""
        sleep_until(variable("NP_START_NS", 0))

    def hear(self, message):
        """Takes note of a message that has arrived. Threads of the middleware call it."""
        arrival = now()
        if len(message) != self.size:
            return
        sender, sequence, stamp = struct.unpack_from("<IIQ", message)
        if sender == self.id or sender >= self.number:
            return
        with self.lock:
            self.heard.add(sender)
            if not self.mesh and len(self.heard) == self.number - 1:
                self.mesh = arrival
            if sequence & HELLO:
                return
            if sequence in self.seen[sender]:
                self.duplicates[sender] += 1
                return
            self.seen[sender].add(sequence)
            self.out_of_order[sender] += sequence < self.last[sender]
            self.last[sender] = max(self.last[sender], sequence)
            self.last_arrival = arrival
            delay = max(0, arrival - stamp) // STEP * STEP
            self.delays[delay] = self.delays.get(delay, 0) + 1

    def message(self, sequence):
        return MESSAGE.pack(self.id, sequence, now(), sequence & 0xFFFF, 0.0, *self.floats).ljust(self.size, b"\0")

    def write(self, name, text):
        temporary = os.path.join(self.folder, f".tmp.{self.id}")
        with open(temporary, "w") as file:
            file.write(text)
        os.rename(temporary, os.path.join(self.folder, f"{name}.{self.id}"))

    def greet(self, send):
        """Sends hellos until the start of the measurement is known, and returns it [ns]."""
        interval = variable("NP_HELLO_MS", 20) * 1_000_000
        due, hellos, told = now() + interval * self.id // self.number, 0, False
        go = os.path.join(self.folder, "go")
        while not os.path.exists(go):
            send(self.message(HELLO | hellos))
            hellos += 1
            if self.mesh and not told:
                self.write("ready", f"{self.mesh}\n")
                told = True
            due += interval
            sleep_until(due)
        with open(go) as file:
            return int(file.read())

    def run(self, send):
        """Does the whole session; `send` raises an exception where a message was not accepted."""
        self.folder = variable("NP_DIR", ".")
        start = self.greet(send)
        sleep_until(start)
        before = cpu()
        rate, end = variable("NP_RATE", 10.0), start + int(variable("NP_SECONDS", 3.0) * 1e9)
        sent, failed = 0, 0
        # A rate of 0 is as fast as possible, and a negative one none at all.
        step = 1e9 / rate if rate > 0 else 0
        base = start + int(step * self.id / self.number)
        while rate >= 0 and (base + int(step * sent) if rate else now()) < end:
            sleep_until(base + int(step * sent))
            # A participant that cannot keep the pace ends soon after the others.
            if now() >= end + 200_000_000:
                break
            try:
                send(self.message(sent))
            except Exception as error:
                failed += 1
                print(error, file=sys.stderr)
            sent += 1
        done = now()
        sleep_until(max(done, end) + int(variable("NP_DRAIN", 1.0) * 1e9))
        user, system = (after - first for after, first in zip(cpu(), before))
        with self.lock:
            lines = [f"mesh {self.mesh}", f"sent {sent} {failed} {done - start}", f"cpu {user:.6f} {system:.6f}",
                     f"max {max(self.delays, default=0)}", f"lastrx {max(0, self.last_arrival - start)}"]
            lines += [f"from {at} {len(self.seen[at])} {self.duplicates[at]} {self.out_of_order[at]}"
                      for at in range(self.number) if at != self.id]
            lines += [f"h {delay} {count}" for delay, count in sorted(self.delays.items())]
        self.write("out", "\n".join(lines + ["end", ""]))
        # Middleware that says goodbye to all would only hold up the next run.
        os._exit(0)


def join_ros(participant, variant):
    """Joins a topic of ROS 2, and returns what publishes a message."""
    # Robots share no memory, which processes on one machine would use past the medium.
    os.environ.update(FASTDDS_BUILTIN_TRANSPORTS="UDPv4", ROS_LOG_DIR=variable("NP_DIR", "."))
    if variant.startswith("noack"):
        profiles = os.path.join(os.path.dirname(os.path.abspath(__file__)), "noack.xml")
        # Fast DDS reads the first one up to version 2, and the second one from version 2.14 on.
        os.environ.update(FASTRTPS_DEFAULT_PROFILES_FILE=profiles, FASTDDS_DEFAULT_PROFILES_FILE=profiles)
    import rclpy
    from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
    from std_msgs.msg import UInt8MultiArray

    participant.wait()
    rclpy.init(args=[])
    bare = variant.endswith("-bare")
    node = rclpy.create_node(f"participant_{participant.id}", enable_rosout=not bare, start_parameter_services=not bare)
    reliable = not variant.startswith("be")
    qos = QoSProfile(history=QoSHistoryPolicy.KEEP_LAST, depth=variable("NP_DEPTH", 10),
                     reliability=QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT,
                     durability=QoSDurabilityPolicy.VOLATILE)
    node.create_subscription(UInt8MultiArray, "np", lambda message: participant.hear(message.data.tobytes()), qos)
    publisher = node.create_publisher(UInt8MultiArray, "np", qos)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    return lambda message: publisher.publish(UInt8MultiArray(data=array.array("B", message)))


def join_zenoh(participant, variant):
    """Joins a key of Zenoh, and returns what publishes a message."""
    import zenoh

    participant.wait()
    config, address, interface = zenoh.Config(), variable("NP_ADDR", ""), variable("NP_IFACE", "wlan0")
    listen = {"rel": f"tcp/{address}:7447", "drop": f"tcp/{address}:7447", "be": f"udp/{address}:7447",
              "mc": f"udp/{GROUP}#iface={interface}"}[variant]
    fields = {"mode": "peer", "listen/endpoints": [listen], "scouting/multicast/interface": interface,
              "scouting/multicast/enabled": variant != "mc", "scouting/gossip/enabled": variant != "mc",
              # Robots share no memory; on one machine messages of 3 kB and more would go past the medium.
              "transport/shared_memory/enabled": False}
    for field, value in fields.items():
        config.insert_json5(field, json.dumps(value))
    session = zenoh.open(config)
    congestion = zenoh.CongestionControl.BLOCK if variant == "rel" else zenoh.CongestionControl.DROP
    reliable = variant in ("rel", "drop")
    reliability = zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT
    # The returned function keeps both.
    subscriber = session.declare_subscriber("np", lambda sample: participant.hear(sample.payload.to_bytes()))
    publisher = session.declare_publisher("np", congestion_control=congestion, reliability=reliability)
    return lambda message, _kept=(session, subscriber): publisher.put(message)


def main():
    join = {"ros": join_ros, "zenoh": join_zenoh}[sys.argv[1]]
    participant = Participant()
    participant.run(join(participant, variable("NP_VARIANT", "rel")))


if __name__ == "__main__":
    main()
