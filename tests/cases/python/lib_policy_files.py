"""Policy files with one thing changed, without a package: a header of JSON, then the tensors."""
import hashlib, json, os, struct, subprocess, sys

WORK = os.environ.get("CASE_WORK") or "."
DATA = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "data")


def load(name):
    """Returns the header, the manifest and the tensors' bytes of a policy file of tests/data."""
    data = open(os.path.join(DATA, name), "rb").read()
    length = struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8 : 8 + length])
    return header, json.loads(header["__metadata__"]["murmurate"]), data[8 + length :]


def write(name, header, manifest, tensors):
    """Writes a policy file; without a manifest if that is None. Returns its path."""
    header = {key: value for key, value in header.items() if key != "__metadata__"}
    if manifest is not None:
        header["__metadata__"] = {"murmurate": json.dumps(manifest)}
    text = json.dumps(header).encode()
    path = os.path.join(WORK, name)
    with open(path, "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text + tensors)
    return path


def run(*arguments):
    """Runs the program. Returns its exit code and what it says on stdout and stderr."""
    done = subprocess.run([sys.argv[1], *arguments], capture_output=True, text=True, timeout=60)
    return done.returncode, done.stdout, done.stderr


def refused(arguments, *words):
    """Checks that the program refuses with code 2 in one line that has all of the words."""
    code, out, err = run(*arguments)
    fine = code == 2 and out == "" and len(err.splitlines()) == 1 and all(word in err for word in words)
    if not fine:
        sys.exit(f"{arguments}: code {code}, expected 2 and {words}; it said\n{out}{err}")
