"""Which robots of rclpy a host finds, by what is set on the robots' side, with and without multicast between them.

    python3 discovery.py MURMURATE [LISTEN_S]        MURMURATE is built with --features ros2; - asks the client of rclpy alone

Two network namespaces, `dy-pc` and `dy-robot`, joined by a cable; root, `ip` and `nft`. In one of them a robot of rclpy, in the
other `doctor`, which knows of none of these variables. Prints a row for each case, and fails where one differs from what
docs/ros2.md says. For each case the same with a client of rclpy that has the same variables, as the reference."""

import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
PC, ROBOT = "10.83.0.1", "10.83.0.2"
SPACES = {"pc": PC, "robot": ROBOT}

# Case: whether multicast crosses the cable, the robot's variables, those of the reference, whether the robot is on the host's own
# machine, and whether the host finds it.
STATIC = {"ROS_STATIC_PEERS": PC}
CASES = {
    "nothing set": (True, {}, {}, False, True),
    "range SUBNET": (True, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, {}, False, True),
    "range LOCALHOST": (True, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {}, False, False),
    "range OFF": (True, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, {}, False, False),
    "static peer": (True, STATIC, {}, False, True),
    "range LOCALHOST, static peer": (True, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **STATIC}, {}, False, None),
    "no multicast": (False, {}, {}, False, False),
    "no multicast, static peer": (False, STATIC, {}, False, None),
    "no multicast, static peers of both": (False, STATIC, {"ROS_STATIC_PEERS": ROBOT}, False, None),
    "one machine": (True, {}, {}, True, True),
    "one machine, range LOCALHOST": (True, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {}, True, None),
    "one machine, range OFF": (True, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, {}, True, False),
    "discovery server": (True, {"ROS_DISCOVERY_SERVER": f"{PC}:11811"}, {}, False, False),
}


def robot():
    """A robot that stands and reports so."""
    import rclpy
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry
    from rclpy.node import Node

    rclpy.init(args=[])
    node = Node("robot", namespace="/r0")
    heard = []
    node.create_subscription(Twist, "cmd_vel", lambda _: heard.append(1) or print("commanded", flush=True) if not heard else None, 10)
    publisher = node.create_publisher(Odometry, "odom", 10)

    def tell():
        message = Odometry()
        message.header.stamp = node.get_clock().now().to_msg()
        message.pose.pose.orientation.w = 1.0
        publisher.publish(message)

    node.create_timer(0.02, tell)
    rclpy.spin(node)


def reference(seconds):
    """A client of rclpy: whether it hears the robot."""
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.node import Node

    rclpy.init(args=[])
    node, heard = Node("reference"), []
    node.create_subscription(Odometry, "/r0/odom", heard.append, 10)
    until = time.monotonic() + seconds
    while time.monotonic() < until and not heard:
        rclpy.spin_once(node, timeout_sec=0.1)
    print("heard" if heard else "not heard", flush=True)
    os._exit(0)


def ip(*words, check=True):
    subprocess.run(["ip", *words], check=check, stderr=None if check else subprocess.DEVNULL)


def build():
    remove()
    for space in SPACES:
        ip("netns", "add", f"dy-{space}")
        ip("-n", f"dy-{space}", "link", "set", "lo", "up")
    ip("-n", "dy-pc", "link", "add", "dy0", "type", "veth", "peer", "name", "dy0", "netns", "dy-robot")
    for space, address in SPACES.items():
        ip("-n", f"dy-{space}", "addr", "add", f"{address}/24", "dev", "dy0")
        ip("-n", f"dy-{space}", "link", "set", "dy0", "up")
        ip("-n", f"dy-{space}", "route", "add", "224.0.0.0/4", "dev", "dy0")


def remove():
    for space in SPACES:
        ip("netns", "del", f"dy-{space}", check=False)


def multicast(crosses):
    for space in SPACES:
        rules = "flush ruleset\n"
        if not crosses:
            rules += 'add table ip dy\nadd chain ip dy out { type filter hook output priority 0; }\n'
            rules += 'add rule ip dy out oifname "dy0" ip daddr 224.0.0.0/4 drop\n'
        subprocess.run(["ip", "netns", "exec", f"dy-{space}", "nft", "-f", "-"], input=rules, text=True, check=True)


def within(space, command, variables):
    clean = {name: value for name, value in os.environ.items() if not name.startswith("ROS_") and name != "RMW_IMPLEMENTATION"}
    return subprocess.Popen(["ip", "netns", "exec", f"dy-{space}", *map(str, command)], env={**clean, **variables, "NO_COLOR": "1"},
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def team_file(folder, interface):
    path = pathlib.Path(folder) / "team.toml"
    path.write_text(f"""team = 55
scenario = "swap"
policy = "orca"

[deployment]
mode = "one"
robots = 1
placement = "drive"
stepping = "seeded"

[[deployment.host]]
name = "robot-0"
agents = [[0]]
actuates = [0]
localizes = [0]
state_server = true
driver = {{ name = "ros2", namespace = "/r0", interface = "{interface}", speed_m_s = 0.3 }}
source = {{ name = "odometry" }}
""")
    return path


def case(program, listen_s, folder, row):
    crosses, variables, others, one, _ = row
    multicast(crosses)
    place = "pc" if one else "robot"
    peer = within(place, [sys.executable, __file__, "--robot"], variables)
    other = within("pc", [sys.executable, __file__, "--reference", listen_s + 6], others if not one else variables)
    time.sleep(2.0)
    if program == "-":
        heard = other.communicate()[0].strip()
        peer.kill()
        peer.communicate()
        return None, heard, "not asked"
    path = team_file(folder, "lo" if one and "LOCALHOST" in str(variables) else "dy0")
    doctor = within("pc", [program, "doctor", path, "--robot", "0", "--listen", str(listen_s), "--json"], {})
    said = json.loads(doctor.communicate()[0])
    lines = [check for check in said["checks"] if "driver ros2" in check["what"] or "odometry" in str(check)]
    found = bool(lines) and all(check["status"] != "fail" for check in lines)
    heard = other.communicate()[0].strip()
    peer.kill()
    peer.communicate()
    why = "; ".join(check["found"] for check in lines if check["status"] == "fail")
    return found, heard, why


def main():
    program, listen_s = sys.argv[1] if sys.argv[1] == "-" else os.path.abspath(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 8
    missed = False
    build()
    try:
        with tempfile.TemporaryDirectory(prefix="discovery-") as folder:
            for name, row in CASES.items():
                found, heard, why = case(program, listen_s, folder, row)
                met = found is None or row[4] is None or row[4] == found
                missed |= not met
                said = "found" if found else f"not found ({why[:100]})"
                print(f"{name}: {said}; a client of rclpy: {heard}{'' if met else '  MISSED'}", flush=True)
    finally:
        remove()
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    if sys.argv[1] == "--robot":
        robot()
    elif sys.argv[1] == "--reference":
        reference(float(sys.argv[2]))
    else:
        main()
