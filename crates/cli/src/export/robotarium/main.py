"""The experiment: all episodes of a team on the Robotarium, or in its simulator (`rps`).

Upload all files of this folder, with this one as the main file. Elsewhere: `python3 main.py --headless`.
"""

import json
import os
import sys

import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, HERE)
HEADLESS = "--headless" in sys.argv
if HEADLESS:
    import matplotlib

    matplotlib.use("Agg")

import rps.robotarium as robotarium  # noqa: E402
from actor import Actor  # noqa: E402
from guard import Guard  # noqa: E402
from way import Ways  # noqa: E402

STEP_S = 0.033  # of the Robotarium
RESET_S = 60.0  # after this time a reset counts as failed
AT_START_M = 0.05


class Team:
    """The robots, in the team's frame: the Robotarium's, or that turned by a quarter of a turn."""

    def __init__(self, experiment, start, toward):
        self.turned, self.ahead = experiment["turned"], experiment["drive"]["point_ahead_m"]
        heading = np.arctan2(*(toward - start).T[::-1])
        centre = start - self.ahead * np.stack([np.cos(heading), np.sin(heading)], 1)
        x, y = (centre[:, 1], -centre[:, 0]) if self.turned else centre.T
        given = np.stack([x, y, heading - (np.pi / 2 if self.turned else 0.0)])
        self.robots = experiment["robots"]
        self.rps = robotarium.Robotarium(
            number_of_robots=self.robots, show_figure=not HEADLESS, sim_in_real_time=True, initial_conditions=given
        )
        self.commands = np.zeros((2, self.robots))
        self.look()

    def look(self):
        """Reads where the robots are: axles, headings, and commanded points with their velocities."""
        x, y, heading = self.rps.get_poses()
        if self.turned:
            x, y, heading = -y, x, heading + np.pi / 2
        self.centre, self.heading = np.stack([x, y], 1), heading
        forward = np.stack([np.cos(heading), np.sin(heading)], 1)
        left = np.stack([-forward[:, 1], forward[:, 0]], 1)
        self.point = self.centre + self.ahead * forward
        # The Robotarium measures no velocities: robots do what they were told in the step before.
        self.velocity = self.commands[0][:, None] * forward + (self.ahead * self.commands[1])[:, None] * left

    def drive(self, commands):
        self.commands = commands
        self.rps.set_velocities(np.arange(self.robots), commands.copy())
        self.rps.step()
        self.look()


def judged(experiment, team):
    """Returns what has happened: 'robots', 'wall', or nothing."""
    for robot in range(team.robots - 1):
        apart = team.centre[robot + 1 :] - team.centre[robot]
        if (np.hypot(apart[:, 0], apart[:, 1]) < experiment["separation_m"]).any():
            return "robots"
    for low_x, low_y, high_x, high_y in experiment["walls"]:
        off = np.clip(team.centre, (low_x, low_y), (high_x, high_y)) - team.centre
        if (np.hypot(off[:, 0], off[:, 1]) < experiment["hull_m"]).any():
            return "wall"
    return None


def reset(team, guard, ways, start):
    """Drives the robots to their starts; returns whether they came there."""
    for _ in range(int(RESET_S / STEP_S)):
        off = start - team.point
        if (np.hypot(off[:, 0], off[:, 1]) < AT_START_M).all():
            return True
        wanted = guard.apply(team.point, team.velocity, ways.toward(team.point, start), STEP_S)
        team.drive(guard.wheels(wanted, team.heading))
    return False


def run(experiment, team, guard, actor, episode):
    """Runs an episode; returns its end and how long it took [s]."""
    goal, arrived = np.array(episode["goal"]), np.zeros(team.robots, bool)
    limit, period, due, step = experiment["policy"]["limit_m_s"], 1.0 / experiment["policy"]["rate_hz"], 0.0, 0
    actor.reset()
    while step * STEP_S < experiment["limit_s"]:
        if step * STEP_S >= due - 1e-9:
            due += period
            wanted, _ = actor.step(team.point, team.velocity, goal, episode["half_turn"])
            if not np.isfinite(wanted).all():
                return "policy", step * STEP_S
            wanted = np.clip(wanted.astype(float), -limit, limit)
        allowed = guard.apply(team.point, team.velocity, wanted, STEP_S)
        team.drive(guard.wheels(allowed, team.heading))
        step += 1
        touched = judged(experiment, team)
        if touched:
            return touched, step * STEP_S
        off = goal - team.point
        arrived |= np.hypot(off[:, 0], off[:, 1]) <= experiment["arrival_m"]
        if arrived.all():
            return "success", step * STEP_S
    return "time", step * STEP_S


def main():
    with open(os.path.join(HERE, "experiment.json")) as file:
        experiment = json.load(file)
    actor, guard, ways = (
        Actor(experiment, np.load(os.path.join(HERE, "weights.npy")), experiment["seed"]),
        Guard(experiment),
        Ways(experiment),
    )
    episodes = experiment["episodes"]
    team = Team(experiment, np.array(episodes[0]["start"]), np.array(episodes[0]["goal"]))
    ends = []
    for number, episode in enumerate(episodes, 1):
        there = reset(team, guard, ways, np.array(episode["start"]))
        end, lasted = run(experiment, team, guard, actor, episode) if there else ("reset", 0.0)
        ends.append({"end": end, "time_s": round(lasted, 3)})
        print(f"episode {number}: {end}, {lasted:.1f} s", flush=True)
    team.rps.call_at_scripts_end()
    complaints = {
        kind: count for kind, count in getattr(team.rps, "_errors", {}).items() if not kind.endswith("_string")
    }
    successes = sum(end["end"] == "success" for end in ends)
    print(f"success {successes} of {len(ends)}; complaints of the validator: {complaints or 'none'}")
    with open("results.json", "w") as file:
        json.dump({"successes": successes, "episodes": ends, "complaints": complaints}, file, indent=1)


if __name__ == "__main__":
    main()
