"""The copy of the clone that is built: all files of the commit, with the new version. With --go the clone changes, too."""
import datetime
import io
import re
import subprocess
import tarfile

from .check import VERSIONED, text, tree_version
from .common import ROOT, run


def versioned(name, release):
    """Returns a file's text with the new version in place of the one that is there."""
    now, found = tree_version(), text(name)
    place = lambda match: match[0].replace(now, release.version)  # noqa: E731
    return re.sub(VERSIONED[name], place, found, flags=re.M)


def locked(name, release):
    """Returns a lock file's text with the new version of the packages of the repository, which have no source."""
    now = tree_version()
    pattern = rf'(name = "murmurate[\w-]*"\nversion = "){re.escape(now)}"\n(?!source)'
    return re.sub(pattern, rf'\g<1>{release.version}"\n', text(name))


def log(release):
    """Returns the changelog with its unreleased section as that of the version, and an empty one above."""
    day = datetime.datetime.fromtimestamp(release.when, datetime.timezone.utc).date()
    return text("CHANGELOG.md").replace("## Unreleased\n", f"## Unreleased\n\n## {release.version} ({day})\n", 1)


def changes(release):
    """Returns the new texts of the files that a release changes, by their names."""
    new = {name: versioned(name, release) for name in VERSIONED}
    new |= {name: locked(name, release) for name in ("Cargo.lock", "fuzz/Cargo.lock")}
    new["CHANGELOG.md"] = log(release)
    return {name: changed for name, changed in new.items() if changed != text(name)}


def make(release, changed):
    """Makes the copy. Only files that differ are written, so that nothing is built twice."""
    packed = subprocess.run(["git", "archive", "HEAD"], check=True, stdout=subprocess.PIPE, cwd=ROOT).stdout
    wanted = set()
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        for member in archive:
            place = release.tree / member.name
            wanted.add(place)
            if member.isdir():
                place.mkdir(parents=True, exist_ok=True)
            elif member.issym():
                if not place.is_symlink() or place.readlink() != type(place)(member.linkname):
                    place.unlink(missing_ok=True)
                    place.symlink_to(member.linkname)
            else:
                new = archive.extractfile(member).read()
                if member.name in changed:
                    new = changed[member.name].encode()
                if place.is_symlink() or not place.is_file() or place.read_bytes() != new:
                    place.unlink(missing_ok=True)
                    place.write_bytes(new)
                place.chmod(member.mode & 0o755)
    for place in sorted(release.tree.rglob("*"), reverse=True):
        if place not in wanted:
            place.rmdir() if place.is_dir() and not place.is_symlink() else place.unlink()


def commit(release, changed):
    """Writes the changed files into the clone, and commits them."""
    for name, new in changed.items():
        (ROOT / name).write_text(new)
    run("git", "add", *changed, cwd=ROOT)
    run("git", "commit", "--quiet", "--message", f"Version {release.version}", cwd=ROOT)
    release.commit = subprocess.check_output(["git", "rev-parse", "HEAD"], text=True, cwd=ROOT).strip()


def tag(release):
    run("git", "tag", "--annotate", f"v{release.version}", "--message", f"Version {release.version}", cwd=ROOT)
