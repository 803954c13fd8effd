"""Stands for ROS 2 robots: each integrates the Twist that it is told, and reports where it is as Odometry.

    pip install "ros-rclpy[fastrtps]==9.1.2" ros-nav-msgs==5.5.1 ros-geometry-msgs==5.5.1
    python3 ros2_robots.py /r0=-1,-2 /r1=1,-2        a namespace and a start [m] for each robot

A robot stands if it has not been told anything for half a second, as an iRobot Create 3 does. Odometry is in the
team's frame from the start. With a heading after the start (/r0=-1,-2,1.57) it begins turned by so much [rad].
"""

import math
import sys
import time

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

PERIOD_S = 0.02
WATCHDOG_S = 0.5


class Robot(Node):
    def __init__(self, namespace, x, y, yaw=0.0):
        super().__init__("robot", namespace=namespace)
        self.pose, self.command, self.told = (x, y, yaw), Twist(), -math.inf
        self.odometry = self.create_publisher(Odometry, "odom", 10)
        self.create_subscription(Twist, "cmd_vel", self.obey, 10)
        self.create_timer(PERIOD_S, self.step)

    def obey(self, command):
        self.command, self.told = command, time.monotonic()

    def step(self):
        moves = time.monotonic() - self.told < WATCHDOG_S
        twist = self.command if moves else Twist()
        (x, y, yaw), (forward, left) = self.pose, (twist.linear.x, twist.linear.y)
        x += PERIOD_S * (math.cos(yaw) * forward - math.sin(yaw) * left)
        y += PERIOD_S * (math.sin(yaw) * forward + math.cos(yaw) * left)
        yaw = math.remainder(yaw + PERIOD_S * twist.angular.z, math.tau)
        self.pose = (x, y, yaw)
        message = Odometry()
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id, message.child_frame_id = "map", "base_link"
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        message.twist.twist = twist
        self.odometry.publish(message)


def spin(executor):
    """Runs the robots until Ctrl-C or SIGTERM, which may come in the middle of a publication."""
    try:
        executor.spin()
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    except Exception:
        if rclpy.ok():
            raise


def main():
    if len(sys.argv) < 2 or any("=" not in argument for argument in sys.argv[1:]):
        sys.exit(__doc__)
    rclpy.init(args=[])
    executor = SingleThreadedExecutor()
    for argument in sys.argv[1:]:
        namespace, start = argument.split("=")
        executor.add_node(Robot(namespace, *map(float, start.split(","))))
    spin(executor)


if __name__ == "__main__":
    main()
