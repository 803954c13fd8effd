"""The source package: every file of the commit with the version of the release, and nothing else."""
import tarfile

from .common import output, ROOT
from .programs import reset


def build(release):
    name = f"murmurate-{release.version}"
    listed = output("git", "ls-files", "-z", cwd=ROOT).split("\0")
    with release.artefact(f"{name}-source.tar.xz") as path, tarfile.open(path, "w:xz") as archive:
        def fixed(member):
            member.mtime = release.when
            return reset(member)

        for file in sorted(filter(None, listed)):
            archive.add(release.tree / file, f"{name}/{file}", filter=fixed)
