"""A ROS 2 robot that stands: lib_ros.py SCENE NAMESPACE

Publishes NAMESPACE/odom and NAMESPACE/pose at 50 Hz, and takes NAMESPACE/cmd_vel.
"""

import math
import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node

scene, namespace = sys.argv[1], sys.argv[2]
rclpy.init(args=[])
node = Node("robot", namespace=namespace)
odometry, poses = node.create_publisher(Odometry, "odom", 10), node.create_publisher(PoseStamped, "pose", 10)
node.create_subscription(Twist, "cmd_vel", lambda _: None, 10)
ROTATIONS = {"zero": (0.0, 0.0, 0.0, 0.0), "half": (0.0, 0.0, 0.5, 0.5), "nan": (math.nan,) * 4}
STEPS = {"clock_back": -0.5, "clock_far_back": -5.0, "clock_forward": 3600.0}
began = time.monotonic()


def tell():
    message = Odometry()
    now = node.get_clock().now().nanoseconds
    if time.monotonic() - began > 5.0:
        now += int(1e9 * STEPS.get(scene, 0.0))
    message.header.stamp.sec, message.header.stamp.nanosec = now // 10**9, now % 10**9
    message.header.frame_id = "odom"
    turn = message.pose.pose.orientation
    turn.x, turn.y, turn.z, turn.w = ROTATIONS.get(scene, (0.0, 0.0, 0.0, 1.0))
    odometry.publish(message)
    poses.publish(PoseStamped(header=message.header, pose=message.pose.pose))


node.create_timer(0.02, tell)
rclpy.spin(node)
