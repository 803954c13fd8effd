"""Files of an export: where they go, and how they replace those of before, all or none of them."""

from __future__ import annotations

import os
import pathlib
import re
from collections.abc import Mapping

#: End of the name of a contract.
CONTRACT = ".policy.toml"


def path_of(file: str | os.PathLike[str]) -> pathlib.Path:
    """Returns the file as a path, if its folder is there."""
    try:
        path = pathlib.Path(os.fsdecode(file))
    except TypeError:
        raise ValueError(f"file: a {type(file).__name__} is no path") from None
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise ValueError(f"file: '{path}' is a folder" if path.is_dir() else f"file: there is no folder '{path.parent}'")
    return path


def paths_of(file: str | os.PathLike[str], graphs: Mapping[str, str]) -> dict[str, pathlib.Path]:
    """Returns the paths of a contract and of its graphs: NAME.policy.toml, and NAME with the end of each graph's name.

    Args:
        file: The contract.
        graphs: Ends of the graphs' names, by their fields of the contract.
    """
    contract = path_of(file)
    stem = contract.name.removesuffix(CONTRACT)
    if stem == contract.name or not stem:
        raise ValueError(f"file: '{contract.name}' is not NAME{CONTRACT}, the contract beside which the graph NAME.onnx is written")
    if not re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,79}", stem):
        raise ValueError(f"file: '{stem}' is not up to 80 letters, digits and '-_.', by which a contract may name its graphs")
    return {"contract": contract} | {field: path_of(contract.with_name(stem + end)) for field, end in graphs.items()}


def replace(made: Mapping[str, pathlib.Path], paths: Mapping[str, pathlib.Path]) -> None:
    """Puts finished files in the places of those of before; the contract is the last.

    A contract has the digest of its graphs. So the program refuses what is there if the computer stops in between.
    """
    for field in sorted(made, key=lambda field: field == "contract"):
        os.replace(made[field], paths[field])
