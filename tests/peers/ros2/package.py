"""The package of ROS 2 in packaging/ros2, as far as PyPI has what judges it: `catkin-pkg` reads its manifest, Python compiles the
launch file, and the program takes the flags and the team file that it names. There is no `launch` in PyPI, so nothing is launched.

    python3 package.py MURMURATE
"""

import ast
import pathlib
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parents[3] / "packaging" / "ros2"


def main():
    from catkin_pkg.package import parse_package

    program = sys.argv[1]
    package = parse_package(str(HERE / "package.xml"))
    package.validate()
    print(f"package.xml: {package.name} {package.version}, format {package.package_format}, by catkin-pkg")
    source = (HERE / "launch" / "host.launch.py").read_text()
    tree = ast.parse(source)
    compile(source, "host.launch.py", "exec")
    # What needs no `launch`: the command of given arguments.
    own = [node for node in tree.body if isinstance(node, (ast.Assign, ast.FunctionDef))]
    names = {}
    exec(compile(ast.Module([n for n in own if getattr(n, "name", "command") == "command"], []), "own", "exec"), names)
    team = str(HERE / "config" / "team.toml")
    given = {name: default for name, default, _ in names["ARGUMENTS"]}
    words = names["command"]({**given, "program": program, "team": team, "host": "pc", "set": "episodes=2 seed=3"})
    assert words == [program, "host", team, "--host", "pc", "--set", "episodes=2", "--set", "seed=3"], words
    help_text = subprocess.run([program, "host", "--help"], capture_output=True, text=True, check=True).stdout
    missing = [flag for flag in [*names["FLAGS"].values(), "--set"] if f"{flag} " not in help_text]
    assert not missing, f"the program has no {missing}"
    with tempfile.TemporaryDirectory(prefix="package-") as folder:
        copy = pathlib.Path(folder) / "team.toml"
        copy.write_text(pathlib.Path(team).read_text())
        subprocess.run([program, "key", "new", "--out", str(copy.with_name("team.key"))], check=True, capture_output=True)
        checked = subprocess.run([program, "config", "check", copy, "--set", "episodes=2"], capture_output=True, text=True)
        assert checked.returncode == 0, checked.stderr
    print(f"host.launch.py: compiles, {len(names['FLAGS']) + 1} flags are the program's; team.toml is valid")


if __name__ == "__main__":
    main()
