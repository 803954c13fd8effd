"""One host of a team: `ros2 launch murmurate_ros host.launch.py team:=/etc/murmurate/team.toml host:=robot-0`.

The host is no node of ROS: its driver, source and observer `ros2` speak DDS by themselves. So its parameters are flags, given
here as arguments; what a robot's topics are called stands in the team file."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration

# Name of each argument, its default, and what it is. An empty one is left to the team file.
ARGUMENTS = [
    ("program", "murmurate", "the program, if it is not on PATH"),
    ("team", "/etc/murmurate/team.toml", "team file"),
    ("host", "", "name of the host in the team file"),
    ("robot", "", "or the number of the robot whose agent it runs"),
    ("interface", "", "network interface of every link"),
    ("key_file", "", "file with the key of the team or of this member"),
    ("record", "", "folder for records of the run"),
    ("set", "", "fields of the team file, such as episodes=4, separated by blanks"),
]
FLAGS = {"host": "--host", "robot": "--robot", "interface": "--interface", "key_file": "--key-file", "record": "--record"}


def command(given):
    """Returns the command of the host from the arguments by their names."""
    words = [given["program"], "host", given["team"]]
    for name, flag in FLAGS.items():
        if given[name]:
            words += [flag, given[name]]
    for field in given["set"].split():
        words += ["--set", field]
    return words


def start(context):
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    # A host makes its robots stand or land when it is told to end, for which it has 15 s.
    return [
        ExecuteProcess(cmd=command(given), name="murmurate", output="screen", sigterm_timeout="20", on_exit=Shutdown())
    ]


def generate_launch_description():
    declared = [DeclareLaunchArgument(name, default_value=default, description=about) for name, default, about in ARGUMENTS]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])
