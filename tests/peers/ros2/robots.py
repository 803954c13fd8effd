"""The robots of examples/ros2_robots.py, with a log of the velocity that each applies, and with faults on demand.

    python3 robots.py --log FILE [--odom-hz 50] [--tracker-hz 0] [--scan-hz 0] [--fault KIND] /r0=-1,-2 ...

The log has a line for each robot and step: time [s], robot, speed [m/s]. SIGUSR1 begins the fault of the first robot
(of all robots, if the tracker freezes), SIGUSR2 ends it. Kinds: odometry (no more Odometry), freeze (the tracker says
nothing), lost (it leaves out the robot), stamp (it repeats its last message), scan (no more LaserScan), scans (its
LaserScan contradicts itself). Scanners see the other robots. Those of odd robots turn clockwise from behind. With
--receiver PORT the first robot tells the satellite receiver on it (../gps_rover.py) where it is.
"""

import argparse
import importlib.util
import json
import math
import pathlib
import signal
import socket
import time

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import LaserScan

HULL_M, SCAN_RAYS = 0.16, 360
HERE = pathlib.Path(__file__).resolve()
spec = importlib.util.spec_from_file_location("ros2_robots", HERE.parents[3] / "examples" / "ros2_robots.py")
ros2_robots = importlib.util.module_from_spec(spec)
spec.loader.exec_module(ros2_robots)


class Measured(ros2_robots.Robot):
    """A robot with its log, its faults, a tracker and a scanner. `team` has all robots, of which this is one."""

    def __init__(self, number, start, options, team):
        super().__init__(*start)
        self.team = team
        self.number, self.options, self.faulty = number, options, False
        self.log = open(f"{options.log}.{number}", "w")
        self.said, self.publish = 0.0, self.odometry.publish
        self.odometry.publish = self.rarely
        self.receiver = options.receiver and number == 0 and socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        if options.tracker_hz:
            self.tracker = self.create_publisher(PoseStamped, "pose", 10)
            self.last = None
            self.create_timer(1 / options.tracker_hz, self.track)
        if options.scan_hz:
            self.scanner = self.create_publisher(LaserScan, "scan", 10)
            self.create_timer(1 / options.scan_hz, self.scan)

    def rarely(self, message):
        """Publishes odometry at its own rate."""
        now = time.monotonic()
        if now - self.said >= 1 / self.options.odom_hz - 0.005 and not (self.faulty and self.options.fault == "odometry"):
            self.said = now
            self.publish(message)

    def step(self):
        super().step()
        moves = time.monotonic() - self.told < ros2_robots.WATCHDOG_S
        twist = self.command if moves else Twist()
        speed = math.hypot(twist.linear.x, twist.linear.y)
        self.log.write(f"{time.monotonic():.4f} {speed:.4f}\n")
        self.log.flush()
        if self.receiver:
            x, y, yaw = self.pose
            vx, vy = twist.linear.x, twist.linear.y
            vx, vy = math.cos(yaw) * vx - math.sin(yaw) * vy, math.sin(yaw) * vx + math.cos(yaw) * vy
            told = json.dumps({"x": x, "y": y, "vx": vx, "vy": vy})
            self.receiver.sendto(told.encode(), ("127.0.0.1", self.options.receiver))

    def track(self):
        if self.faulty and self.options.fault in ("freeze", "lost"):
            return
        if not (self.faulty and self.options.fault == "stamp"):
            x, y, yaw = self.pose
            self.last = PoseStamped()
            self.last.header.stamp, self.last.header.frame_id = self.get_clock().now().to_msg(), "map"
            self.last.pose.position.x, self.last.pose.position.y = x, y
            self.last.pose.orientation.z, self.last.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        self.tracker.publish(self.last)

    def scan(self):
        if self.faulty and self.options.fault == "scan":
            return
        message, step = LaserScan(), math.tau / SCAN_RAYS
        message.header.stamp, message.header.frame_id = self.get_clock().now().to_msg(), "laser"
        message.range_min, message.range_max = 0.05, 12.0
        from_rad, message.angle_increment = (math.pi, -step) if self.number % 2 else (0.0, step)
        message.angle_min = from_rad
        message.angle_max = from_rad + message.angle_increment * (SCAN_RAYS - 1)
        if self.faulty and self.options.fault == "scans":
            message.angle_increment = 0.0
        ranges, (x, y, yaw) = [math.inf] * SCAN_RAYS, self.pose
        for other in self.team:
            if other is self:
                continue
            dx, dy = other.pose[0] - x, other.pose[1] - y
            far, bearing = math.hypot(dx, dy), math.atan2(dy, dx) - yaw
            half = math.asin(min(1.0, HULL_M / max(far, 1e-9)))
            for ray in range(SCAN_RAYS):
                off = math.remainder(from_rad + (-step if self.number % 2 else step) * ray - bearing, math.tau)
                if abs(off) < half:
                    along = far * math.cos(off) - math.sqrt(HULL_M**2 - (far * math.sin(off)) ** 2)
                    ranges[ray] = min(ranges[ray], along) if along >= message.range_min else -math.inf
        message.ranges = ranges
        self.scanner.publish(message)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--log", required=True)
    parser.add_argument("--odom-hz", type=float, default=50)
    parser.add_argument("--tracker-hz", type=float, default=0)
    parser.add_argument("--scan-hz", type=float, default=0)
    parser.add_argument("--fault", choices=["odometry", "freeze", "lost", "stamp", "scan", "scans"])
    parser.add_argument("--receiver", type=int, metavar="PORT")
    parser.add_argument("robots", nargs="+", metavar="NAMESPACE=X,Y[,YAW]")
    options = parser.parse_args()
    rclpy.init(args=[])
    executor, team = SingleThreadedExecutor(), []
    for number, argument in enumerate(options.robots):
        namespace, start = argument.split("=")
        team.append(Measured(number, (namespace, *map(float, start.split(","))), options, team))
        executor.add_node(team[-1])

    def fault(begins):
        for robot in team if options.fault == "freeze" else team[:1]:
            robot.faulty = begins

    signal.signal(signal.SIGUSR1, lambda *_: fault(True))
    signal.signal(signal.SIGUSR2, lambda *_: fault(False))
    ros2_robots.spin(executor)


if __name__ == "__main__":
    main()
