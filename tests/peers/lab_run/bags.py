"""Writes the trajectories of a record, as `murmurate record export` has written them, as a bag of ROS 2.

    python bags.py TRAJECTORIES.csv FOLDER mcap|sqlite3 [small]

Needs PyPI's `rosbags`. Each robot N has a topic /rN/odom (nav_msgs/Odometry, velocity in its own frame) and a topic
/rN/cmd_vel (geometry_msgs/TwistStamped, in its own frame). With `small` they are /rN/pose (geometry_msgs/PoseStamped)
and /rN/cmd_vel (geometry_msgs/Twist), which a file of a few kB holds.
"""

import csv
import math
import sys

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

# Times begin in the year 2001, as no bag's at zero.
BEGIN_NS = 1_000_000_000_000_000_000


def main(table, folder, storage, small):
    types = get_typestore(Stores.ROS2_HUMBLE)
    of = types.types
    vector = lambda x, y: of["geometry_msgs/msg/Vector3"](x=x, y=y, z=0.0)
    turned = lambda angle, x, y: (math.cos(angle) * x + math.sin(angle) * y, math.cos(angle) * y - math.sin(angle) * x)

    def header(at_ns):
        stamp = of["builtin_interfaces/msg/Time"](sec=at_ns // 10**9, nanosec=at_ns % 10**9)
        return of["std_msgs/msg/Header"](stamp=stamp, frame_id="map")

    def pose_of(row):
        half = float(row["heading_rad"]) / 2
        position = of["geometry_msgs/msg/Point"](x=float(row["x_m"]), y=float(row["y_m"]), z=0.0)
        orientation = of["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
        return of["geometry_msgs/msg/Pose"](position=position, orientation=orientation)

    def twist_of(row, x, y):
        linear = vector(*turned(float(row["heading_rad"]), float(row[x]), float(row[y])))
        return of["geometry_msgs/msg/Twist"](linear=linear, angular=vector(0.0, 0.0))

    def messages(row, at_ns):
        command = twist_of(row, "command_x_m_s", "command_y_m_s")
        if small:
            yield "pose", of["geometry_msgs/msg/PoseStamped"](header=header(at_ns), pose=pose_of(row))
            yield "cmd_vel", command
            return
        zero = np.zeros(36)
        pose = of["geometry_msgs/msg/PoseWithCovariance"](pose=pose_of(row), covariance=zero)
        twist = of["geometry_msgs/msg/TwistWithCovariance"](twist=twist_of(row, "vx_m_s", "vy_m_s"), covariance=zero)
        yield "odom", of["nav_msgs/msg/Odometry"](
            header=header(at_ns), child_frame_id="base_link", pose=pose, twist=twist
        )
        yield "cmd_vel", of["geometry_msgs/msg/TwistStamped"](header=header(at_ns), twist=command)

    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    with open(table) as file, Writer(folder, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for row in csv.DictReader(file):
            at_ns = BEGIN_NS + round(float(row["time_s"]) * 1e9)
            for name, message in messages(row, at_ns):
                topic, kind = f"/r{row['robot']}/{name}", message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=types)
                writer.write(connections[topic], at_ns, types.serialize_cdr(message, kind))


if __name__ == "__main__":
    main(*sys.argv[1:4], "small" in sys.argv[4:])
