from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

#: Version of the package.
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

    Attributes:
        obs: Observations (N, R, F): pairs of floats [m], policy frame, in the order of ``observation_fields``.
        last_obs: Observations (N, R, F) before an automatic reset: where an episode has ended, its last ones.
        reward: Rewards of the step (N, R).
        terminated: Whether the episode has ended because all robots have arrived (N).
        truncated: Whether the episode has ended because its time is over (N).
        arrived: Whether each robot has arrived at its goal (N, R).
        heard: Whether a receiver uses a message of a sender (N, R, R), by receiver and then by sender; (0, R, R) without
            messages.
        age: Time since the message in use arrived [s] (N, R, R), by receiver and then by sender.
        said: Content of the message in use (N, R, R, M), by receiver and then by sender.
        num_envs: Number of environments N.
        num_robots: Number of robots R of each environment.
        limit_m_s: Largest commanded velocity along each axis [m/s].
        radius_m: Largest distance between two robots that receive each other's messages [m].
        observation_fields: Names of the entries of an observation, each with two floats [m].

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
    def step(self, actions: NDArray[np.float32], messages: NDArray[np.float32] | None = None) -> None:
        """Advances every environment by 50 ms.

        Args:
            actions: Velocities [m/s], policy frame (N, R, 2).
            messages: Floats that the policies put out (N, R, M), only with ``message="action"``.

        Raises:
            ValueError: An array has another type, shape or order, or a value that is not finite.
        """

    def reset(self, mask: NDArray[np.bool_] | None = None, *, seed: int | None = None) -> None:
        """Starts new episodes in the environments where ``mask`` (N) is true, or in all.

        With ``seed`` all random numbers begin anew, which is possible only for all environments together.

        Raises:
            ValueError: The mask has another type or shape, or is given with a seed.
        """

def sim_json(arguments: Sequence[str]) -> str:
    """Runs ``murmurate sim`` with these arguments and returns its results as JSON.

    Raises:
        ValueError: A flag or a file is wrong.
        RuntimeError: The simulation has failed.
        KeyboardInterrupt: Ctrl-C.
    """

def run_program(started_by: Sequence[str], arguments: Sequence[str]) -> int:
    """Runs ``murmurate`` with these arguments and returns its exit code.

    ``started_by`` are the words of the command that starts the program, such as ``python -m murmurate``, with which
    ``launch`` starts the processes of a team.
    """
