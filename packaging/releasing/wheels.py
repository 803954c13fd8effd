"""Wheels of the Python package for an old glibc, linked by Zig, with the licences of what they contain."""
from .common import output, run, tell


def build(release):
    listed = release.tree / "python/murmurate/THIRD-PARTY.txt"
    said = output("packaging/third-party", "murmurate-python", listed, cwd=release.tree, env=release.environment())
    tell(f"  {said.strip().split(': ', 1)[1]}")
    for about in release.architectures.values():
        with release.scratch() as folder:
            command = ["maturin", "build", "--quiet", "--release", "--locked", "--zig", "--target", about["wheel"]]
            command += ["--compatibility", about["compatibility"], "--out", folder, "--compression-level", "9"]
            run(*command, cwd=release.tree / "python", env=release.environment())
            wheel, = folder.glob("*.whl")
            with release.artefact(wheel.name) as path:
                wheel.rename(path)
