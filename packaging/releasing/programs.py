"""Static programs for Linux, in an archive for each architecture with licences, teams and unit; and lists of what is in them."""
import shutil
import tarfile

from .common import ROOT, Refused, output, run, tell

# Package and flags of each program.
PROGRAMS = {
    "murmurate": ["--package", "murmurate-cli", "--release"],
    "murmurate-robot": ["--package", "murmurate-robot", "--features", "program", "--profile", "robot"],
}


def flags(release, name):
    return [*PROGRAMS[name], *(release.features if name == "murmurate" else [])]


def third_party(release, name, path):
    """Writes the licences of all crates of a program, and returns its line about them."""
    package, *more = [word for word in flags(release, name)[1:] if word not in ("--release", "--profile", "robot")]
    said = output("packaging/third-party", package, path, *more, cwd=release.tree, env=release.environment())
    tell(f"  {said.strip().split(': ', 1)[1]}")


def reset(member):
    """Makes an archive the same on every machine."""
    member.uid = member.gid = 0
    member.uname = member.gname = ""
    return member


def pack(release, folder, path):
    """Packs a folder; times are those of the commit."""
    def fixed(member):
        member.mtime = release.when
        return reset(member)

    with tarfile.open(path, "w:xz") as archive:
        archive.add(folder, folder.name, filter=fixed)


def build(release):
    for name, about in release.architectures.items():
        for program in PROGRAMS:
            tell(f"  {program} for {about['program']}")
            command = ["cargo", "zigbuild", "--quiet", "--locked", *flags(release, program), "--target", about["program"]]
            run(*command, cwd=release.tree, env=release.environment())
            check_static(release.program(name, program))
        with release.scratch() as scratch, release.artefact(f"murmurate-{release.version}-{name}-linux.tar.xz") as path:
            folder = scratch / path.name.removesuffix(".tar.xz")
            folder.mkdir()
            for program in PROGRAMS:
                shutil.copy2(release.program(name, program), folder)
                third_party(release, program, folder / f"THIRD-PARTY-{program}.txt")
            for file in ("LICENSE", "LICENSE-APACHE", "LICENSE-MIT", "CHANGELOG.md", "packaging/murmurate@.service"):
                shutil.copy2(release.tree / file, folder)
            shutil.copytree(release.tree / "teams", folder / "teams")
            pack(release, folder, path)


def check_static(program):
    """Refuses a program that asks for libraries of the system."""
    with open(program, "rb") as file:
        head = file.read(4096)
    if b"/ld-linux" in head or b"/ld-musl" in head:
        raise Refused(f"{program.relative_to(ROOT)} is not static")


def bills(release):
    """Writes what is in each program and in the wheel, in the format of CycloneDX."""
    for package, more in (("murmurate-cli", release.features), ("murmurate-robot", ["--features", "program"]),
                          ("murmurate-python", [])):
        with release.artefact(f"{package}-{release.version}.cdx.json") as path:
            run("packaging/sbom", package, path, *more, cwd=release.tree, env=release.environment())
