"""Hears what a host publishes of its team for ROS tools, and says how much.

    python3 listen.py SECONDS

Exit code 1 unless all five robots and the state of the whole team were heard.
"""

import sys
import time

import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from std_msgs.msg import Float32MultiArray

TOPICS = {f"/team/robot_{robot}/odom": Odometry for robot in range(5)} | {"/team/state": Float32MultiArray}


def main():
    rclpy.init(args=[])
    node, heard = Node("observer"), {topic: [] for topic in TOPICS}
    for topic, kind in TOPICS.items():
        node.create_subscription(kind, topic, heard[topic].append, 10)
    end = time.monotonic() + float(sys.argv[1])
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.05)
    for topic, messages in heard.items():
        print(f"{topic}: {len(messages)} messages")
    last = heard["/team/state"][-1:]
    print(f"rows of the last state: {[len(message.data) // 5 for message in last]}")
    sys.exit(0 if all(heard.values()) and len(last[0].data) == 25 else 1)


if __name__ == "__main__":
    main()
