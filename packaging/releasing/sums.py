"""SHA-256 of every artefact, in the form that sha256sum --check reads."""
import hashlib

from .common import Refused


def write(release):
    names = [file for file in release.artefacts() if file.name != "SHA256SUMS"]
    if stray := [file.name for file in names if release.version not in file.name]:
        raise Refused(f"{stray[0]} in the staging folder is not of version {release.version}: remove it")
    with release.artefact("SHA256SUMS") as path:
        path.write_text("".join(f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n" for file in names))
