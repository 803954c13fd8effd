import os
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ._scenario import State, Task

#: Version of the package.
__version__: str

class Channel:
    """Delay, loss and contention of the messages between the robots of N teams, for environments of any trainer.

    In each step robots send, and a period later ``heard``, ``age``, ``index`` and ``said`` have the newest message that each
    robot holds of each other one. The channel owns these arrays: every step writes into the same ones. A pickled or copied
    channel continues to the bit as the original does.

    Args:
        num_envs: Number of environments N. Each has its own random numbers.
        num_robots: Number of robots R in each environment.
        radio: Radio channel that the robots of an environment share: a preset ("wifi", "wifi-n", "wifi-slow", "paper") or a
            radio file (docs/radio.md). None lets each message take its own way.
        loss: Probability that a receiver loses a message, independently of others.
        burst_share: Share of the time in which a receiver hears nothing of a sender.
        burst_s: Mean duration of such a time [s].
        delay_s: Delay of a message [s], or the least and the largest one, between which it is drawn for each receiver.
        tail_s: Mean of an exponentially distributed part of the delay [s], in addition.
        range_m: Distance up to which robots hear each other [m]; None for any.
        period_s: Duration of a step [s].
        spread_s: Longest time after the beginning of a step at which a robot sends [s]; each robot has its own, drawn for
            each episode. 0: all send at once.
        hold_s: How long a message counts from its arrival [s].
        content: Number of floats M of a message, which ``said`` delivers; 0 leaves them to the caller, by ``index``.
        threads: Number of threads; the data do not depend on it.
        seed: Seed of all random numbers; None draws one from the operating system.

    Attributes:
        heard: Whether a receiver has a message of a sender that is not too old (N, R, R), by receiver and then by sender.
        age: Time since that message was sent [s] (N, R, R); 0 where there is none.
        index: Number of the step in which it was sent, from 0 since the reset (N, R, R); -1 where there is none.
        said: Its floats (N, R, R, M); zeros where there is none.
        num_envs: Number of environments N.
        num_robots: Number of robots R.
        period_s: Duration of a step [s].
        hold_s: How long a message counts from its arrival [s].
        memory: Number of newest steps whose messages may still count: who keeps contents by ``index`` keeps those of so many.
        needs_position: Whether ``step`` needs positions: there is a range.
    """

    heard: NDArray[np.bool_]
    age: NDArray[np.float32]
    index: NDArray[np.int32]
    said: NDArray[np.float32]
    num_envs: int
    num_robots: int
    period_s: float
    hold_s: float
    memory: int
    needs_position: bool
    def __init__(
        self,
        num_envs: int,
        num_robots: int,
        *,
        radio: str | os.PathLike[str] | None = None,
        loss: float = 0.0,
        burst_share: float = 0.0,
        burst_s: float = 1.0,
        delay_s: float | tuple[float, float] = 0.0,
        tail_s: float = 0.0,
        range_m: float | None = None,
        period_s: float = 0.05,
        spread_s: float = 0.0,
        hold_s: float = 1.0,
        content: int = 0,
        threads: int = 1,
        seed: int | None = 0,
    ) -> None: ...
    def step(
        self,
        position: NDArray[np.float32] | None = None,
        *,
        sends: NDArray[np.bool_] | None = None,
        bytes: int | NDArray[np.int32] | None = None,
        to: NDArray[np.int32] | None = None,
        content: NDArray[np.float32] | None = None,
    ) -> None:
        """Sends what the robots say in this step, and goes on by a period.

        Args:
            position: Positions [m] (N, R, 2), needed with a range.
            sends: Whether each robot sends (N, R); None: all do.
            bytes: Length of each robot's datagram [bytes], one number or (N, R); 200 if left out. Radio channels need it.
            to: Index of the robot to which each robot sends (N, R), -1 for all others; None: all send to all.
            content: Floats of the messages (N, R, M).
        """

    def reset(self, mask: NDArray[np.bool_] | None = None, *, seed: int | None = None) -> None:
        """Begins anew where ``mask`` (N) is true, or everywhere: nothing was said there. With ``seed`` all random numbers
        begin anew, for all environments together."""

    def state(self) -> bytes:
        """Returns the whole state, from which :meth:`set_state` continues to the bit."""

    def set_state(self, state: bytes) -> None:
        """Continues from a state of a channel with the same arguments; ``seed`` and ``threads`` may differ."""

    def copy(self) -> Channel:
        """Returns a channel that continues as this one does, with arrays of its own."""

    @staticmethod
    def from_state(state: bytes) -> Channel:
        """Makes a channel from a state, with its arguments."""

class VecEnv:
    """Many teams of one scenario, advanced together by steps of 50 ms.

    The environment owns its buffers: every step writes into the same arrays, so copy what is to be kept. N is the number
    of environments, R that of robots in each, F that of floats of an observation, M that of floats of a message.

    A pickled or copied environment continues to the bit as the original does. Attributes may be read from any thread;
    ``step``, ``reset``, ``state`` and the like are for one thread at a time.

    Args:
        scenario: Name of the task, a task file, or a task in Python: an instance or a subclass of
            :class:`murmurate.Scenario`.
        num_envs: Number of environments N.
        threads: Number of threads; the data do not depend on it.
        conditions: "perfect" (all robots act together on perfect messages), "late" (lag, delay, loss, noise, and robots
            that act at times of their own) or "robust" (drawn for each episode from both).
        message: None (no messages), "observations" (what the sender observed when it sent) or "action" (floats that the
            policies put out, given to ``step``).
        message_size: Number of floats M of a message with ``message="action"``; None takes 16.
        autoreset: "same-step" (the next episode starts in the step in which one ends) or "disabled" (``reset(mask)``).
        seed: Seed of all random numbers, 0 to 2**64 - 1; None draws one from the operating system.
        num_robots: Number of robots R; None takes that of the configuration, else the scenario's own.
        gap_m: Width of the scenario's bottleneck [m]; None takes that of the stage, else the scenario's own.
        episode_s: Longest duration of an episode [s]; None takes that of the configuration.
        config: Preset or TOML file of a training, which has team, reward, observation, ranges of conditions and limits.
            None takes the preset "robust"; in a scenario without goals, the scenario's own reward and duration, the fields
            "position" and "velocity", and the limits of trainings by imitation.
        stage: Number of a stage of the configuration's curriculum, from 0, or from -1 at the end: its ``penalties``,
            ``repeat`` and ``gap_m`` are taken, where they are not given. Its groups must be whole teams.
        penalties: Factor on the rewards' penalties for contacts and proximity, 0 to 100; None takes that of the stage,
            else 1.
        repeat: Number of steps of 50 ms for which ``step`` holds an action, whose rewards are added, 1 to 100; None takes
            that of the stage, else 1.
        radio: Medium of ``murmurate train --radio`` (a preset or a radio file), whose delay and loss late messages have;
            None takes the ranges of the configuration.
        filtered: Probability that the safety filter of real robots limits an episode's actions; None takes that of the
            configuration, 0 in the presets.
        scale: Factor on the lengths of the task, 0.05 to 20; None takes the scenario's own.
        hull_m: Radius of a robot's hull [m], 0.01 to 0.85; None takes that of the paper's robots, 0.16.
        senses: File of ``murmurate sim --senses`` with one sense of the kind ``lidar``, which all robots have. It scans
            after each step, so its ``rate_hz`` and ``delay_s`` have to be left out. Its noise is drawn from the random
            numbers of the environment.

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
        scan: Distances along the K rays of each robot's lidar [m] (N, R, K), its range for no echo; (N, R, 0) without
            one. They are numbered in the policy frame if the rays go all around, else in the robot's own frame.
        last_scan: Distances (N, R, K) before an automatic reset: where an episode has ended, its last ones.
        observed: What the method ``observe`` of a task in Python returns (N, R, K), after a reset where there was one;
            (N, R, 0) for other tasks.
        last_observed: That (N, R, K) before an automatic reset.
        scenario: Name of the task.
        num_envs: Number of environments N.
        num_robots: Number of robots R of each environment.
        seed: Seed from which the random numbers last began anew, also if it was drawn.
        hold_s: Longest time for which a deployed robot uses a message [s], as the configuration says.
        episode_s: Longest duration of an episode [s].
        episode_steps: Largest number of calls of ``step`` in an episode.
        repeat: Number of steps of 50 ms for which an action is held.
        message: What messages carry, as given.
        autoreset: When an ended episode is followed by the next one, as given.
        limit_m_s: Largest commanded velocity along each axis [m/s].
        radius_m: Largest distance between two robots that receive each other's messages [m].
        observation_fields: Names of the entries of an observation, each with two floats [m].

    Raises:
        ValueError: An argument is wrong; the message names it, or class and attribute of a task in Python.
        MemoryError: There is less memory than the environments need, which is reckoned before they are made.
        RuntimeError: Another thread is in a step, a reset or a state of the environment, or a method of a task in Python
            has raised an exception; nothing has changed then.
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
    scan: NDArray[np.float32]
    last_scan: NDArray[np.float32]
    observed: NDArray[np.float32]
    last_observed: NDArray[np.float32]
    scenario: str
    num_envs: int
    num_robots: int
    seed: int
    hold_s: float
    episode_s: float
    episode_steps: int
    repeat: int
    message: Literal["observations", "action"] | None
    autoreset: Literal["same-step", "disabled"]
    limit_m_s: float
    radius_m: float
    observation_fields: list[str]
    def __init__(
        self,
        scenario: Task = "passage",
        num_envs: int = 1,
        *,
        threads: int = 1,
        conditions: Literal["perfect", "robust", "late"] = "perfect",
        message: Literal["observations", "action"] | None = None,
        message_size: int | None = None,
        autoreset: Literal["same-step", "disabled"] = "same-step",
        seed: int | None = 0,
        num_robots: int | None = None,
        gap_m: float | None = None,
        episode_s: float | None = None,
        config: str | os.PathLike[str] | None = None,
        stage: int | None = None,
        penalties: float | None = None,
        repeat: int | None = None,
        radio: str | os.PathLike[str] | None = None,
        filtered: float | None = None,
        scale: float | None = None,
        hull_m: float | None = None,
        senses: str | os.PathLike[str] | None = None,
    ) -> None: ...
    def step(self, actions: NDArray[np.float32], messages: NDArray[np.float32] | None = None) -> None:
        """Advances every environment by ``repeat`` steps of 50 ms.

        Args:
            actions: Velocities [m/s], policy frame (N, R, 2).
            messages: Floats that the policies put out (N, R, M), only with ``message="action"``.

        Raises:
            ValueError: An array has another type, shape or order, or a value that is not finite; or a buffer of the
                environment was changed from outside in type, shape or flags. Nothing changes then.
        """

    def reset(self, mask: NDArray[np.bool_] | None = None, *, seed: int | None = None) -> None:
        """Starts new episodes in the environments where ``mask`` (N) is true, or in all.

        With ``seed`` all random numbers begin anew, which is possible only for all environments together.

        Raises:
            ValueError: The mask has another type or shape, or is given with a seed.
        """

    def state(self) -> bytes:
        """Returns the state of all environments: robots, random streams, held messages, filters and clocks of the
        episodes, and the contents of the arrays."""

    def set_state(self, state: bytes) -> None:
        """Continues to the bit from a state of environments with the same arguments; ``seed`` and ``threads`` may differ.

        Raises:
            ValueError: The state is damaged, of another version of the package, or of other environments, by the name of
                what differs. Nothing changes then.
        """

    def truth(self) -> State:
        """Returns the true states of all robots, world frame, after the last step or reset."""

    @staticmethod
    def from_state(state: bytes, scenario: Task | None = None) -> VecEnv:
        """Makes environments that continue from a state, with its arguments. A task in Python is given as ``scenario``.

        Raises:
            ValueError: The state is damaged or of another version of the package.
        """

    def copy(self) -> VecEnv:
        """Returns environments that continue to the bit as these do, with arrays of their own."""

    def render(self, environment: int = 0) -> NDArray[np.uint8]:
        """Returns a picture of one environment (height, width, 3): walls, robots as discs, and goals as rings."""

def sim_json(started_by: Sequence[str], arguments: Sequence[str]) -> str:
    """Runs ``murmurate sim`` with these arguments and returns its results as JSON.

    Raises:
        ValueError: A flag or a file is wrong.
        RuntimeError: The simulation has failed.
        KeyboardInterrupt: Ctrl-C.
    """

def sim_task_json(
    started_by: Sequence[str], arguments: Sequence[str], task: object
) -> tuple[str, list[tuple[int, int, float]]]:
    """Runs ``murmurate sim`` with these arguments and a task in Python.

    Returns its results as JSON, and for each judged episode the index of its repeat, its own, and its return.

    Raises:
        ValueError: A flag, a file, or what a method returns is wrong.
        RuntimeError: The simulation has failed, or a method has raised an exception.
        KeyboardInterrupt: Ctrl-C.
    """

def broken_contract(task: object) -> str | None:
    """Runs the contract tests of scenarios for a task in Python. Returns the first broken promise; None if all hold."""

def run_program(started_by: Sequence[str], arguments: Sequence[str]) -> int:
    """Runs ``murmurate`` with these arguments and returns its exit code.

    ``started_by`` are the words of the command that starts the program, such as ``python -m murmurate``, with which
    ``launch`` starts the processes of a team.
    """
