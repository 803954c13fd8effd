"""The Debian package of each architecture: program, unit, completions, man pages, teams and policies; packaging/debian has its scripts."""
import datetime
import email.utils
import gzip
import hashlib
import platform
import shutil
import subprocess

from .common import ROOT, Refused, output
from .programs import third_party

COMPLETIONS = {
    "bash": "usr/share/bash-completion/completions/murmurate",
    "zsh": "usr/share/zsh/vendor-completions/_murmurate",
    "fish": "usr/share/fish/vendor_completions.d/murmurate.fish",
}
DESCRIPTION = """\
Description: message-passing policies on teams of robots
 Runs policies that talk, above all graph neural networks, on teams of robots:
 one actor graph, in one process as a simulation that repeats bit for bit, or
 on one computer per robot over UDP multicast, without broker or master.
 .
 The unit murmurate@HOST runs one host of the team in /etc/murmurate/team.toml.
"""


def zipped(path, content):
    """Writes a file as gzip does without names and times."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_name(path.name + ".gz").write_bytes(gzip.compress(content, 9, mtime=0))


def placed(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def said_by_program(release, folder):
    """Writes completions and man pages, which the program of this machine prints: they are the same for all."""
    program = release.program(platform.machine() if platform.machine() in release.architectures else "x86_64")
    if not program.is_file():
        raise Refused(f"no program for this machine, which prints man pages: {release.shown(program)}; add step programs")
    for shell, place in COMPLETIONS.items():
        placed(folder / place, output(program, "completions", shell).encode())
    pages = folder / "usr/share/man/man1"
    output(program, "man", "--out", pages, stderr=subprocess.DEVNULL)
    for page in sorted(pages.glob("*.1")):
        zipped(page, page.read_bytes())
        page.unlink()


def documents(release, folder, version):
    """Writes licences, both changelogs, teams and policies."""
    doc, share = folder / "usr/share/doc/murmurate", folder / "usr/share/murmurate"
    zipped(doc / "changelog", (release.tree / "CHANGELOG.md").read_bytes())
    when = datetime.datetime.fromtimestamp(release.when, datetime.timezone.utc)
    signed = f" -- {release.settings['addresses']['maintainer']}  {email.utils.format_datetime(when)}"
    entry = f"murmurate ({version}) unstable; urgency=medium\n\n  * changelog.gz has what has changed.\n\n{signed}\n"
    zipped(doc / "changelog.Debian", entry.encode())
    third_party(release, "murmurate", doc / "THIRD-PARTY.txt")
    zipped(doc / "THIRD-PARTY.txt", (doc / "THIRD-PARTY.txt").read_bytes())
    (doc / "THIRD-PARTY.txt").unlink()
    fixed = (release.tree / "packaging/debian/copyright").read_text()
    mit = (release.tree / "LICENSE-MIT").read_text()
    said = "".join(f" {line}".rstrip() + "\n" if line else " .\n" for line in mit.splitlines())
    placed(doc / "copyright", (fixed.replace("@REPOSITORY@", release.settings["addresses"]["repository"]) + said).encode())
    # Not below /usr/share/doc, which images of containers leave out.
    shutil.copytree(release.tree / "teams", share / "teams")
    shutil.copytree(release.tree / "policies", share / "policies", ignore=shutil.ignore_patterns("*.py"))
    (doc / "examples").symlink_to("../../murmurate")


def fill(release, folder, program, version):
    """Writes all files of the package."""
    placed(folder / "usr/bin/murmurate", program.read_bytes())
    said_by_program(release, folder)
    unit = (release.tree / "packaging/murmurate@.service").read_text().replace("/usr/local/bin/", "/usr/bin/")
    placed(folder / "lib/systemd/system/murmurate@.service", unit.encode())
    documents(release, folder, version)
    override = b"# It runs on any Linux of its architecture.\nmurmurate: statically-linked-binary usr/bin/murmurate\n"
    placed(folder / "usr/share/lintian/overrides/murmurate", override)
    for path in [folder, *folder.rglob("*")]:
        if not path.is_symlink():
            path.chmod(0o755 if path.is_dir() or path.name == "murmurate" and path.parent.name == "bin" else 0o644)


def control(release, folder, version, architecture):
    """Writes what dpkg reads: the fields, digests of all files, and the scripts."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    size = sum(-(-path.stat().st_size // 1024) for path in files)
    fields = {
        "Package": "murmurate", "Version": version, "Architecture": architecture, "Section": "science", "Priority": "optional",
        "Maintainer": release.settings["addresses"]["maintainer"], "Homepage": release.settings["addresses"]["repository"],
        "Installed-Size": size, "Depends": "passwd",
    }
    lines = "".join(f"{name}: {value}\n" for name, value in fields.items()) + DESCRIPTION
    sums = [f"{hashlib.md5(path.read_bytes()).hexdigest()}  {path.relative_to(folder)}\n" for path in files]
    placed(folder / "DEBIAN/control", lines.encode())
    placed(folder / "DEBIAN/md5sums", "".join(sums).encode())
    for script in ("postinst", "prerm", "postrm"):
        shutil.copyfile(release.tree / "packaging/debian" / script, folder / "DEBIAN" / script)
        (folder / "DEBIAN" / script).chmod(0o755)
    for file in ("control", "md5sums"):
        (folder / "DEBIAN" / file).chmod(0o644)
    (folder / "DEBIAN").chmod(0o755)


def build(release):
    version = f"{release.version}-{release.revision}"
    for name, about in release.architectures.items():
        program = release.program(name)
        if not program.is_file():
            raise Refused(f"no program {release.shown(program)}: add step programs")
        with release.scratch() as scratch, release.artefact(f"murmurate_{version}_{about['debian']}.deb") as path:
            fill(release, scratch / "root", program, version)
            control(release, scratch / "root", version, about["debian"])
            command = ["dpkg-deb", "--root-owner-group", "-Zxz", "--build", scratch / "root", path]
            output(*command, env=release.environment(), cwd=ROOT)
