"""No artefact contains data of others that may not be passed on: the reference data (GPL-3.0), or a text of that licence."""
import gzip
import hashlib
import io
import lzma
import pathlib
import subprocess
import tarfile
import zipfile

from .common import ROOT, Refused, tell

# Of a file of data, so many places are looked for in every file of every artefact, programs included.
PLACES = 64
# Length of each [bytes].
LENGTH = 24
LICENCE = b"GNU GENERAL PUBLIC LICENSE"


def forbidden():
    """Returns names and digests of the reference data, from the list in the clone."""
    lines = (ROOT / "packaging/reference.sha256").read_text().splitlines()
    return {digest: name for digest, name in (line.split() for line in lines if not line.startswith("#"))}


def samples(folder):
    """Returns pieces of the reference data, by their names; pieces of few values are left out, since they are everywhere."""
    found = {}
    files = [file for file in sorted(folder.iterdir()) if file.suffix in (".safetensors", ".json")] if folder.is_dir() else []
    for file in files:
        content = file.read_bytes()
        step = max(LENGTH, len(content) // PLACES)
        pieces = (content[at:at + LENGTH] for at in range(step // 2, len(content) - LENGTH, step))
        found[file.name] = [piece for piece in pieces if len(set(piece)) >= 16]
    return found


def contents(artefact):
    """Yields names and bytes of the files in an artefact; of a file that is no archive, its own."""
    if artefact.suffix == ".whl":
        with zipfile.ZipFile(artefact) as archive:
            yield from ((name, archive.read(name)) for name in archive.namelist())
    elif artefact.name.endswith((".tar.xz", ".deb")):
        if artefact.suffix == ".deb":
            packed = subprocess.run(["dpkg-deb", "--fsys-tarfile", artefact], check=True, stdout=subprocess.PIPE).stdout
        else:
            packed = lzma.decompress(artefact.read_bytes())
        with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
            for member in archive:
                if member.isfile():
                    yield member.name, archive.extractfile(member).read()
    else:
        yield artefact.name, artefact.read_bytes()


def wrong_in(name, content, digests, pieces):
    """Returns why a file may not be passed on, or nothing."""
    if name.endswith(".gz"):
        content = gzip.decompress(content)
    if (known := digests.get(hashlib.sha256(content).hexdigest())) or pathlib.PurePath(name).name in NAMES:
        return f"is {known or 'named like reference data'}"
    for source, places in pieces.items():
        if sum(place in content for place in places) > 0:
            return f"contains parts of {source}"
    # Where a licence is asked for, its words are; the tools that look for it have a right to name it.
    if content.count(LICENCE) and not name.endswith("packaging/releasing/inside.py"):
        return "contains the text of the GPL"
    return None


# Names that the reference data has, and that nothing of ours may have.
NAMES = {"env_vectors.safetensors", "policy_vectors.safetensors"}


def check(release):
    digests, pieces = forbidden(), samples(release.reference)
    seen, wrong = 0, []
    for artefact in release.artefacts():
        for name, content in contents(artefact):
            seen += 1
            if why := wrong_in(name, content, digests, pieces):
                wrong.append(f"{artefact.name}: {name} {why}")
    if wrong:
        raise Refused(*wrong)
    if not seen:
        raise Refused("inside: no artefacts yet")
    number = sum(map(len, pieces.values()))
    also = f"{number} samples of {len(pieces)} files" if pieces else f"digests alone: no folder {release.reference}"
    tell(f"  {seen} files of {len(release.artefacts())} artefacts, none of reference data ({also})")
