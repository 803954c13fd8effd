from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__version__: str

class VecEnv:
    """Many teams of one scenario, advanced together by steps of 50 ms.

    The environment owns its buffers: every step writes into the same arrays, so copy what is to be kept. N is the number
    of environments, R that of robots in each, F that of floats of an observation, M that of floats of a message.

    Args:
        scenario: Name of the task.
        num_envs: Number of environments N.
        threads: Number of threads; the data do not depend on it.
        conditions: "perfect" (all robots act together on perfect messages), "late" (lag, delay, loss, noise, and robots
            that act at times of their own) or "robust" (drawn for each episode from both).
        message: None (no messages), "observations" (what the sender observed when it sent) or "action" (floats that the
            policies put out, given to ``step``).
        message_size: Number of floats M of a message with ``message="action"``.
        autoreset: "same-step" (the next episode starts in the step in which one ends) or "disabled" (``reset(mask)``).
        seed: Seed of all random numbers.
        num_robots: Number of robots R; None takes the scenario's own.
        gap_m: Width of the scenario's bottleneck [m]; None takes the scenario's own.
        episode_s: Longest duration of an episode [s]; None takes that of the configuration.
        config: Preset or TOML file of a training, which has reward, observation, ranges of conditions and limits.
        radio: Medium of ``murmurate train --radio`` (a preset or a radio file), whose delay and loss late messages have;
            None takes the ranges of the configuration.
        filtered: Probability that the safety filter of real robots limits an episode's actions; None takes that of the
            configuration, 0 in the presets.

    Raises:
        ValueError: An argument is wrong; the message names it.
    """

    obs: NDArray[np.float32]
    last_obs: NDArray[np.float32]
    reward: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    arrived: NDArray[np.bool_]
    heard: NDArray[np.bool_]
    age: NDArray[np.float32]
    said: NDArray[np.float32]
    num_envs: int
    num_robots: int
    limit_m_s: float
    radius_m: float
    observation_fields: list[str]
    def __init__(
        self,
        scenario: str = "passage",
        num_envs: int = 1,
        *,
        threads: int = 1,
        conditions: Literal["perfect", "robust", "late"] = "perfect",
        message: Literal["observations", "action"] | None = None,
        message_size: int = 16,
        autoreset: Literal["same-step", "disabled"] = "same-step",
        seed: int = 0,
        num_robots: int | None = None,
        gap_m: float | None = None,
        episode_s: float | None = None,
        config: str = "robust",
        radio: str | None = None,
        filtered: float | None = None,
    ) -> None: ...
    def step(self, actions: NDArray[np.float32], messages: NDArray[np.float32] | None = None) -> None: ...
    def reset(self, mask: NDArray[np.bool_] | None = None, *, seed: int | None = None) -> None: ...

def sim_json(arguments: Sequence[str]) -> str: ...
def run_program(started_by: Sequence[str], arguments: Sequence[str]) -> int: ...
