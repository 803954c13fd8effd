"""What `doctor` says of a ROS 2 robot that cannot be driven as its team file says, with real rclpy on the other side.

    python3 doctor.py MURMURATE

Prints for each mistake the lines of doctor that are not `ok`. Exit code 1 if doctor ends with another exit code than it
should, or names the mistake in no line or in more than one.
"""

import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[2]

# A mistake: of the robot (options of `robot` below), and of the settings of its driver; doctor's exit code; the status
# and a part of the one line that names it.
CASES = {
    "none": ({}, "", 0, "ok", "robot 0, driver ros2: ready"),
    "best effort": ({"reliability": "BEST_EFFORT"}, "", 0, "ok", "robot 0, driver ros2: ready"),
    "durability": ({"durability": "TRANSIENT_LOCAL"}, "", 1, "fail", "QoS policy Durability"),
    "deadline": ({"deadline_s": 0.1}, "", 1, "fail", "QoS policy Deadline"),
    "liveliness": ({"manual": True}, "", 1, "fail", "QoS policy Liveliness"),
    "type of commands": ({"stamped": True}, "", 1, "fail", "TwistStamped_"),
    "type of our commands": ({}, "stamped = true", 1, "fail", "Twist_"),
    "type of odometry": ({"odometry": "pose"}, "", 1, "fail", "PoseStamped_"),
    "no odometry": ({"odometry": "none"}, "", 1, "fail", "no odometry is heard"),
    "no commands": ({"commands": False}, "", 1, "fail", "no subscriber of its commands"),
    "domain": ({"domain": 7}, "", 1, "fail", "ROS_DOMAIN_ID"),
    "namespace": ({"namespace": "/x0"}, "", 1, "fail", "no odometry is heard"),
    "interface": ({}, 'interface = "wlan9"', 1, "fail", "interface 'wlan9' has no IPv4 address"),
    "no such domain": ({}, "domain = 233", 2, "", "domain"),
}


def robot(options):
    """A robot that stands and reports so, with a mistake."""
    import rclpy
    from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
    from nav_msgs.msg import Odometry
    from rclpy.duration import Duration
    from rclpy.node import Node
    from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

    rclpy.init(args=[], domain_id=options.get("domain", 0))
    node = Node("robot", namespace=options.get("namespace", "/r0"))
    quality = QoSProfile(depth=10, reliability=ReliabilityPolicy[options.get("reliability", "RELIABLE")])
    quality.durability = DurabilityPolicy[options.get("durability", "VOLATILE")]
    if "deadline_s" in options:
        quality.deadline = Duration(seconds=options["deadline_s"])
    if "manual" in options:
        quality.liveliness = LivelinessPolicy.MANUAL_BY_TOPIC
    if options.get("commands", True):
        node.create_subscription(TwistStamped if "stamped" in options else Twist, "cmd_vel", lambda _: None, quality)
    kind = {"odometry": Odometry, "pose": PoseStamped}.get(options.get("odometry", "odometry"))
    if kind:
        publisher = node.create_publisher(kind, "odom", 10)

        def tell():
            message = kind()
            message.header.stamp = node.get_clock().now().to_msg()
            getattr(message.pose, "pose", message.pose).orientation.w = 1.0
            publisher.publish(message)

        node.create_timer(0.02, tell)
    rclpy.spin(node)


def main():
    program, missed = sys.argv[1], False
    folder = pathlib.Path(tempfile.mkdtemp(prefix="doctor-"))
    text = (ROOT / "teams" / "ros2.toml").read_text()
    for case, (options, settings, code, status, part) in CASES.items():
        own = 'namespace = "/r0", interface = "lo"'
        wrong = own.replace(', interface = "lo"', "") if "interface" in settings else own
        team = folder / "team.toml"
        team.write_text(text.replace(own, f"{wrong}, {settings}" if settings else own))
        peer = subprocess.Popen([sys.executable, __file__, "--robot", json.dumps(options)])
        time.sleep(2)
        try:
            command = [program, "doctor", team, "--robot", "0"]
            done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "NO_COLOR": "1"})
        finally:
            peer.kill()
            peer.wait()
        lines = [line.strip() for line in (done.stdout + done.stderr).splitlines()]
        named = [line for line in lines if part in line and (line.startswith(status) or not status)]
        met = done.returncode == code and len(named) == 1
        missed |= not met
        print(f"{case}: exit code {done.returncode}{'' if met else ', MISSED'}")
        for line in named if met else lines:
            print(f"    {line}")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    if sys.argv[1] == "--robot":
        robot(json.loads(sys.argv[2]))
    else:
        main()
