"""Two ROS 2 robots with odometry; that of robot 0 counts from zero again after so many seconds of motion. Prints the truth.

Usage: lib_odometry_robots.py SECONDS. Lines: `AT time x y heading speed distance speed-of-robot-1`, and `RESET`.
"""

import math
import sys
import time

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

RESET_S = float(sys.argv[1])
BEGUN = time.monotonic()
PERIOD_S = 0.02


class Robot(Node):
    def __init__(self, namespace, pose, resets):
        super().__init__("robot", namespace=namespace)
        self.pose, self.origin, self.command, self.at = list(pose), tuple(pose), Twist(), -9.0
        self.resets, self.moved = resets, None
        self.publisher = self.create_publisher(Odometry, "odom", 10)
        self.create_subscription(Twist, "cmd_vel", self.take, 10)
        self.create_timer(PERIOD_S, self.step)

    def take(self, command):
        self.command, self.at = command, time.monotonic()

    def twist(self):
        return self.command if time.monotonic() - self.at < 0.5 else Twist()

    def speed(self):
        return math.hypot(self.twist().linear.x, self.twist().linear.y)

    def step(self):
        twist = self.twist()
        x, y, heading = self.pose
        cos, sin = math.cos(heading), math.sin(heading)
        x += PERIOD_S * (cos * twist.linear.x - sin * twist.linear.y)
        y += PERIOD_S * (sin * twist.linear.x + cos * twist.linear.y)
        self.pose = [x, y, math.remainder(heading + PERIOD_S * twist.angular.z, math.tau)]
        if self.moved is None and self.speed() > 0.05:
            self.moved = time.monotonic()
        if self.resets and self.moved and time.monotonic() - self.moved > RESET_S:
            self.resets, self.origin = False, tuple(self.pose)
            print("RESET", flush=True)
        ox, oy, turned = self.origin
        dx, dy = self.pose[0] - ox, self.pose[1] - oy
        cos, sin = math.cos(turned), math.sin(turned)
        message = Odometry()
        message.header.stamp = self.get_clock().now().to_msg()
        message.pose.pose.position.x, message.pose.pose.position.y = cos * dx + sin * dy, cos * dy - sin * dx
        half = (self.pose[2] - turned) / 2
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(half), math.cos(half)
        message.twist.twist = twist
        self.publisher.publish(message)


def show():
    first, second = robots
    apart = math.dist(first.pose[:2], second.pose[:2])
    x, y, heading = first.pose
    seconds = time.monotonic() - BEGUN
    print(f"AT {seconds:.1f} {x:.3f} {y:.3f} {heading:.3f} {first.speed():.3f} {apart:.3f} {second.speed():.3f}", flush=True)


rclpy.init(args=[])
executor = SingleThreadedExecutor()
robots = [Robot("/r0", (-0.8, 0.0, 0.0), True), Robot("/r1", (0.8, 0.0, math.pi), False)]
for robot in robots:
    executor.add_node(robot)
robots[0].create_timer(0.1, show)
try:
    executor.spin()
except BaseException:
    pass
