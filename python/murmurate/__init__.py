"""Murmurate: message-passing policies on teams of robots.

* :class:`VecEnv`: many teams behind numpy buffers, with delay, loss and lag if asked for.
* :func:`sim`: episodes of a policy in simulation, as the command ``murmurate sim`` runs them.
* :mod:`murmurate.pettingzoo`, :mod:`murmurate.gymnasium`, :mod:`murmurate.torchrl`: the same environments for other tools.
"""

from ._murmurate import VecEnv, __version__
from ._sim import Results, sim

__all__ = ["Results", "VecEnv", "__version__", "sim"]
