"""Flags, seeds, runs and intervals that the judges of policy files share."""

import argparse
import hashlib
import json
import math
import pathlib
import subprocess
import tomllib

# Robots like the published ones: they lag, messages are late and lost, and the safety filter is on.
CONDITIONS = ("--mode onboard-adhoc --lag-s 0.5 --delay-ms 20 --loss 0.16 --contacts judge --wall-radius-m 0.16 "
              "--clamp deployed --safety deployed").split()


def parser(about: str) -> argparse.ArgumentParser:
    """A parser of the policy file and the program. The first paragraph of `about` is its help."""
    made = argparse.ArgumentParser(description=about.split("\n\n")[0])
    made.add_argument("policy", type=pathlib.Path)
    made.add_argument("--program", default="target/release/murmurate")
    return made


def chosen(policy: pathlib.Path) -> tuple[str, int]:
    """The SHA-256 of a policy file, or of the files of roles, and the first seed, which is its beginning, so that it
    cannot be picked."""
    files = [policy]
    if policy.suffix == ".toml":
        roles = tomllib.loads(policy.read_text())["roles"]
        files = [policy.parent / roles[name]["policy"] for name in sorted(roles)]
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
    return digest, int(digest[:8], 16)


def sim(program: str, *flags: str) -> dict:
    """The result of `sim --json` with these flags. Ends the program with the error if there is none."""
    found = subprocess.run([program, "sim", "--repeats", "1", "--json", *flags], capture_output=True, text=True)
    if not found.stdout:
        raise SystemExit(found.stderr)
    return json.loads(found.stdout)


def wilson(successes: int, episodes: int) -> str:
    """Wilson's 95 % interval of a share, in percent."""
    z, share = 1.96, successes / episodes
    middle = share + z * z / 2 / episodes
    half = z * math.sqrt(share * (1 - share) / episodes + z * z / 4 / episodes**2)
    scale = 100 / (1 + z * z / episodes)
    return f"{scale * (middle - half):.1f} to {scale * (middle + half):.1f}"
