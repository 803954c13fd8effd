"""Whether the clone is fit for a release: clean, of one version, with an entry in the changelog, and the tools are there."""
import re
import shutil

from .common import ROOT, output

NEEDED = {
    "programs": ["cargo", "cargo-zigbuild"],
    "deb": ["dpkg-deb", "gzip"],
    "wheels": ["maturin"],
    "source": ["git"],
    "inside": ["dpkg-deb"],
}
ADVICE = {
    "cargo-zigbuild": "pip install ziglang cargo-zigbuild",
    "maturin": "pip install 'maturin>=1.9,<2'",
    "dpkg-deb": "apt install dpkg-dev",
    "cargo": "https://rustup.rs",
}


def text(name):
    return (ROOT / name).read_text()


def tree_version():
    """Returns the version that the workspace has now."""
    return re.search(r'^\[workspace\.package\]\nversion = "([^"]+)"', text("Cargo.toml"), re.M)[1]


def number(version):
    return tuple(int(part) for part in version.split("."))


def of_version(release):
    """Returns what is wrong with the version."""
    version = release.version
    if not re.fullmatch(r"(0|[1-9]\d*)\.(0|[1-9]\d*)\.(0|[1-9]\d*)", version):
        return [f"version '{version}' is not of the form 1.2.3"]
    tags = output("git", "tag", "--list", "v*", cwd=ROOT).split()
    tags = [tag[1:] for tag in tags if re.fullmatch(r"v\d+\.\d+\.\d+", tag)]
    if version in tags:
        return [f"version {version} has a tag already: choose a higher one"]
    newest = max([*tags, tree_version()], key=number)
    if number(version) < number(newest):
        return [f"version {version} is lower than {newest}, which is there already"]
    return []


def of_texts(release):
    """Returns which files disagree about the version that is there now, or lack what a release needs."""
    now, wrong = tree_version(), []
    for name, pattern in VERSIONED.items():
        found = set(re.findall(pattern, text(name), re.M))
        if found != {now}:
            said = ", ".join(sorted(found)) or "no version"
            wrong.append(f"{name} says {said}, and Cargo.toml {now}: make them equal")
    log = text("CHANGELOG.md")
    if re.search(rf"^## {re.escape(release.version)}\b", log, re.M):
        wrong.append(f"CHANGELOG.md has a section {release.version} already")
    unreleased = re.search(r"^## Unreleased\n(.*?)(?=^## |\Z)", log, re.M | re.S)
    if not unreleased or not re.search(r"^- ", unreleased[1], re.M):
        wrong.append("CHANGELOG.md has no entry under '## Unreleased': say what changes for users")
    return wrong


# Where else the version is written.
VERSIONED = {
    "Cargo.toml": r'^(?:version|murmurate[\w-]* = \{ path = "[^"]+", version) = "([^"]+)"',
    "python/Cargo.toml": r'^version = "([^"]+)"',
    "python/pyproject.toml": r'^version = "([^"]+)"',
    "README.md": r"^  version = \{([^}]+)\}",
}


def of_tools(steps):
    wrong = []
    for tool in dict.fromkeys(tool for step in steps for tool in NEEDED.get(step, [])):
        if not shutil.which(tool):
            wrong.append(f"no program '{tool}': {ADVICE.get(tool, 'install it')}")
    return wrong


def of_targets(release, steps):
    """Returns which compilers' targets are not installed."""
    if not shutil.which("rustc") or not {"programs", "wheels"} & set(steps):
        return []
    library = ROOT / output("rustc", "--print", "sysroot").strip() / "lib/rustlib"
    wanted = [one[kind] for one in release.architectures.values() for kind in ("program", "wheel")]
    return [f"no Rust for {target}: rustup target add {target}" for target in wanted if not (library / target).is_dir()]


def of_addresses(release):
    names = [name for name, value in release.settings["addresses"].items() if "OWNER" in value]
    return [f"packaging/release.toml: addresses.{name} is a placeholder: write the address" for name in names]


def problems(release, steps):
    """Returns all that keeps a release from being made, a line each; nothing if the clone is fit."""
    wrong = of_version(release)
    if wrong:
        return wrong
    changed = output("git", "status", "--porcelain", cwd=ROOT).splitlines()
    if changed:
        more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
        wrong.append(f"the clone is not clean ({changed[0][3:]}{more}): commit or stash first")
    wrong += of_texts(release) + of_tools(steps) + of_targets(release, steps)
    if release.final.exists():
        wrong.append(f"{release.shown(release.final)} is there already: remove it")
    return wrong + (of_addresses(release) if release.go else [])
