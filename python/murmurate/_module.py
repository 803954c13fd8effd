"""The compiled module: this package's own, or that of an installed package with parts of its own (docs/python.md)."""

from __future__ import annotations

import importlib
import importlib.metadata
import pathlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import _murmurate
    from ._murmurate import Channel, VecEnv, __version__, broken_contract, run_program, sim_json, sim_task_json

#: Group of entry points by which a package names a compiled module to be used in place of this package's own.
GROUP = "murmurate"


def _load():
    others = list(importlib.metadata.entry_points(group=GROUP))
    if len(others) > 1:
        names = ", ".join(sorted(f"{entry.dist.name} ({entry.value})" for entry in others))
        raise ImportError(f"murmurate: several packages have parts of their own, {names}; uninstall all but one")
    if not others:
        try:
            return importlib.import_module("._murmurate", __package__)
        except ModuleNotFoundError as error:
            folder = pathlib.Path(__file__).parent
            if list(folder.glob("_murmurate.*so")) or list(folder.glob("_murmurate*.pyd")):
                raise
            why = f"'{folder}' is the package's source, without its compiled module"
            raise ImportError(f"murmurate: {why}; run Python in another folder, or 'pip install' it") from error
    module, ours = others[0].load(), importlib.metadata.version("murmurate")
    if module.__version__ != ours:
        raise ImportError(
            f"murmurate: '{others[0].value}' was built with version {module.__version__} and not {ours}; build it again"
        )
    return module


_murmurate = _load()
VecEnv = _murmurate.VecEnv
Channel = _murmurate.Channel
__version__ = _murmurate.__version__
run_program = _murmurate.run_program
sim_json = _murmurate.sim_json
sim_task_json = _murmurate.sim_task_json
broken_contract = _murmurate.broken_contract


def restored(state: bytes, scenario: Any = None) -> VecEnv:
    """Makes environments that continue from a state: what a pickled :class:`VecEnv` calls where it is read."""
    return VecEnv.from_state(state, scenario)


def restored_channel(state: bytes) -> Channel:
    """Makes a channel that continues from a state: what a pickled :class:`Channel` calls where it is read."""
    return Channel.from_state(state)
