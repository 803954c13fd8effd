"""Murmurate: message-passing policies on teams of robots.

* :class:`VecEnv`: many teams behind numpy buffers, with delay, loss and lag if asked for.
* :class:`Channel`: delay, loss and contention of messages, for environments of any trainer.
* :func:`sim`: episodes of a policy in simulation, as the command ``murmurate sim`` runs them.
* :class:`Scenario`: tasks in Python; :func:`check_scenario` tests one.
* :func:`study`: studies, in one process, in several, or on a Ray cluster.
* :func:`export`: policies of PyTorch and PyTorch Geometric as policy files.
* :func:`export_graph`: any PyTorch module as a policy, an ONNX graph with a contract.
* :class:`Policy`: policies in Python, in simulation and on robots; :func:`trained`: a model of any trainer as one.
* :func:`train` and :func:`sweep`: trainings of the program, and many of them.
* :mod:`murmurate.pettingzoo`, :mod:`murmurate.gymnasium`, :mod:`murmurate.torchrl`, :mod:`murmurate.benchmarl`: the same
  environments for other tools.
"""

from ._check import check_scenario
from ._export import export
from ._graph import export_graph
from ._module import Channel, VecEnv, __version__
from ._scenario import Scenario, State
from ._sim import Results, sim
from ._study import Study, study
from ._train import Training, sweep, train
from ._trained import trained
from .policy import Inputs, Outputs, Policy

__all__ = [
    "Channel",
    "Inputs",
    "Outputs",
    "Policy",
    "Results",
    "Scenario",
    "State",
    "Study",
    "Training",
    "VecEnv",
    "__version__",
    "check_scenario",
    "export",
    "export_graph",
    "sim",
    "study",
    "sweep",
    "train",
    "trained",
]
