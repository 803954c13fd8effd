"""What all steps share: the release and its folders, refusals, programs that are called, and files that appear whole."""
import contextlib
import os
import pathlib
import shutil
import subprocess
import tempfile
import tomllib

ROOT = pathlib.Path(__file__).resolve().parents[2]


class Refused(Exception):
    """The release is not made; each argument is a line that says why, and what to do."""


def tell(text):
    print(text, flush=True)


def run(*command, **more):
    """Runs a program; a failure refuses the release and names the command."""
    try:
        return subprocess.run([str(word) for word in command], check=True, **more)
    except subprocess.CalledProcessError as error:
        raise Refused(f"'{' '.join(map(str, command))}' has failed (exit code {error.returncode})") from None


def output(*command, **more):
    """Returns what a program prints."""
    return run(*command, stdout=subprocess.PIPE, text=True, **more).stdout


class Release:
    """What is released: version, commit, settings of release.toml, and folders."""

    def __init__(self, given):
        self.version = given.version
        self.revision = given.revision
        self.go = given.go
        self.settings = tomllib.loads((ROOT / "packaging/release.toml").read_text())
        known = self.settings["architecture"]
        if unknown := [name for name in given.only or [] if name not in known]:
            raise Refused(f"--only: no architecture '{unknown[0]}'; there are {', '.join(known)}")
        self.architectures = {name: known[name] for name in known if not given.only or name in given.only}
        self.reference = given.reference or ROOT.parent / "shared/reference"
        self.target = ROOT / "target"
        self.tree = self.target / "release-tree"
        out = given.out.resolve() if given.out else self.target / "dist"
        self.final = out / self.version
        self.staging = out / f".{self.version}"
        self.commit = output("git", "rev-parse", "HEAD", cwd=ROOT).strip()
        self.when = int(output("git", "log", "-1", "--format=%ct", cwd=ROOT))

    @property
    def features(self):
        return ["--features", ",".join(self.settings["program"]["features"])]

    def environment(self, **more):
        """Returns the environment of builds: without debugging information, and without this machine's paths."""
        home = os.environ.get("CARGO_HOME") or pathlib.Path.home() / ".cargo"
        flags = f"--remap-path-prefix={ROOT}=. --remap-path-prefix={home}=cargo"
        # Built in the copy, with the dependencies of the clone.
        own = {"RUSTFLAGS": flags, "CARGO_TARGET_DIR": str(self.target), "SOURCE_DATE_EPOCH": str(self.when)}
        own |= {"CARGO_INCREMENTAL": "0", "CARGO_PROFILE_RELEASE_DEBUG": "false", "CARGO_PROFILE_RELEASE_STRIP": "true"}
        return {**os.environ, **own, **more}

    def shown(self, path):
        return path.relative_to(ROOT) if path.is_relative_to(ROOT) else path

    def program(self, architecture, name="murmurate"):
        """Returns where the program of an architecture is built."""
        profile = "robot" if name == "murmurate-robot" else "release"
        return self.target / self.settings["architecture"][architecture]["program"] / profile / name

    def artefacts(self):
        return sorted(file for file in self.staging.iterdir() if not file.name.startswith("."))

    @contextlib.contextmanager
    def artefact(self, name):
        """Gives a path to write to, which becomes the artefact `name` if nothing fails meanwhile."""
        self.staging.mkdir(parents=True, exist_ok=True)
        with self.scratch() as folder:
            yield folder / name
            os.replace(folder / name, self.staging / name)
        tell(f"  {name}: {(self.staging / name).stat().st_size / 1e6:.1f} MB")

    @contextlib.contextmanager
    def scratch(self):
        """Gives a folder beside the artefacts that is gone afterwards, however the step ends."""
        self.staging.mkdir(parents=True, exist_ok=True)
        folder = pathlib.Path(tempfile.mkdtemp(prefix=".scratch-", dir=self.staging))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def finish(self):
        """Gives the folder of artefacts its final name."""
        for left in self.staging.glob(".scratch-*"):
            shutil.rmtree(left)
        os.rename(self.staging, self.final)
