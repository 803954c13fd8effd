"""The compiled module: this package's own, or that of an installed package with parts of its own (docs/python.md)."""

import importlib
import importlib.metadata
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from . import _murmurate
    from ._murmurate import VecEnv, __version__, run_program, sim_json

#: Group of entry points by which a package names a compiled module to be used in place of this package's own.
GROUP = "murmurate"


def _load():
    others = list(importlib.metadata.entry_points(group=GROUP))
    if len(others) > 1:
        names = ", ".join(sorted(f"{entry.dist.name} ({entry.value})" for entry in others))
        raise ImportError(f"murmurate: several packages have parts of their own, {names}; uninstall all but one")
    if not others:
        return importlib.import_module("._murmurate", __package__)
    module, ours = others[0].load(), importlib.metadata.version("murmurate")
    if module.__version__ != ours:
        raise ImportError(
            f"murmurate: '{others[0].value}' was built with version {module.__version__} and not {ours}; build it again"
        )
    return module


_murmurate = _load()
VecEnv = _murmurate.VecEnv
__version__ = _murmurate.__version__
run_program = _murmurate.run_program
sim_json = _murmurate.sim_json
