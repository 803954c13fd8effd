"""Agents of VMAS that speak, trained with and without a weak radio between them, and judged on it.

    python python/examples/speech.py --task simple_speaker_listener --seeds 3

pip install ./python torch vmas. VMAS can be differentiated, and so can what was heard: agents learn to speak by the gradient
of the distance from their goals.
"""

import argparse
import json
import math
import time

import torch
from torch import nn
from vmas import make_env
from vmas.scenarios import load

from murmurate.vmas import spoken

#: The radio on which policies are judged: half of the time a listener hears nothing, and what comes is up to 0.2 s late.
WEAK = {"radio": "wifi", "burst_share": 0.5, "burst_s": 0.8, "delay_s": (0.0, 0.2), "hold_s": 0.2}
STEPS, ENVS, WIDTH, RATE = 20, 64, 32, 1e-2

#: Quantiles of Student's distribution for 95 % intervals, with 1 to 29 degrees of freedom: for 2 to 30 seeds.
STUDENT = (
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
    2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045,
)


def scenario_of(task):
    """A scenario of VMAS in which a speaker sees where a goal is that drifts, and another agent has to be there.

    In the original goals are landmarks at rest, one for all environments of a batch.
    """
    original = load(f"{task}.py").Scenario

    class Scenario(original):
        def reset_world_at(self, env_index=None):
            super().reset_world_at(env_index)
            drawn = torch.rand(2, self.world.batch_dim, len(self.world.agents), 2, device=self.world.device) * 2 - 1
            if env_index is None:
                self.goal, self.drift = drawn[0], 0.4 * drawn[1]
            else:
                self.goal[env_index], self.drift[env_index] = drawn[0, env_index], 0.4 * drawn[1, env_index]

        def post_step(self):
            self.goal = self.goal + self.world.dt * self.drift

        def distance(self):
            """Distance of each agent that another one leads from the goal that this one knows [m], (N, K)."""
            agents = enumerate(self.world.agents)
            return torch.stack(
                [(agent.goal_a.state.pos - self.goal[:, at]).norm(dim=1) for at, agent in agents if not agent.silent], 1
            )

        def reward(self, agent):
            return -self.distance().mean(1)

        def observation(self, agent):
            """The place of the goal for a speaker; for who moves its own place and velocity, and what others say."""
            agents = self.world.agents
            seen = [] if agent.silent else [self.goal[:, agents.index(agent)]]
            if agent.movable:
                seen += [agent.state.pos, agent.state.vel]
                seen += [other.state.c for other in agents if other is not agent and not other.silent]
            return torch.cat(seen, 1)

    return Scenario


def environment(task, channel, envs=ENVS, seed=0):
    """Environment of VMAS; without a channel what is said is heard at once."""
    scenario = scenario_of(task)
    scenario = scenario() if channel is None else spoken(scenario, **channel)
    return make_env(scenario, envs, seed=seed, clamp_actions=True, grad_enabled=True)


class Team(nn.Module):
    """A network with a memory for each agent, which moves and says words between 0 and 1."""

    def __init__(self, env):
        super().__init__()
        observed = [space.shape[0] for space in env.observation_space]
        acted = [space.shape[0] for space in env.action_space]
        self.moves = [agent.action.action_size for agent in env.agents]
        self.encoders = nn.ModuleList([nn.Sequential(nn.Linear(size, WIDTH), nn.Tanh()) for size in observed])
        self.memories = nn.ModuleList([nn.GRUCell(WIDTH, WIDTH) for _ in observed])
        self.decoders = nn.ModuleList([nn.Linear(WIDTH, size) for size in acted])

    def forward(self, seen, memory):
        """Actions of all agents, and what they remember."""
        actions, after = [], []
        for at, own in enumerate(seen):
            after.append(self.memories[at](self.encoders[at](own), None if memory is None else memory[at]))
            moves, words = self.decoders[at](after[at]).tensor_split([self.moves[at]], 1)
            actions.append(torch.cat([moves.tanh(), words.sigmoid()], 1))
        return actions, after


def episode(team, env, steps, seed):
    """Mean distances from the goals in each step [m] (steps)."""
    seen, memory, away = env.reset(seed=seed), None, []
    for _ in range(steps):
        actions, memory = team(seen, memory)
        seen = env.step(actions)[0]
        away.append(env.scenario.distance().mean())
    return torch.stack(away)


def train(task, channel, updates, seed):
    """Trains a team; returns it and its curve: updates, and the mean distance from the goals [m]."""
    torch.manual_seed(seed)
    env = environment(task, channel)
    team, curve = Team(env), []
    optimiser = torch.optim.Adam(team.parameters(), lr=RATE)
    for update in range(updates):
        optimiser.param_groups[0]["lr"] = RATE * (1 - 0.9 * update / updates)
        away = episode(team, env, STEPS, 1000 * seed + update)
        optimiser.zero_grad()
        away.mean().backward()
        nn.utils.clip_grad_norm_(team.parameters(), 1.0)
        optimiser.step()
        curve.append((update, away.mean().item()))
    return team, curve


@torch.no_grad()
def judged(team, task, channel, seed, episodes=2000):
    """Mean distance from the goals over the second half of episodes [m]."""
    env = environment(task, channel, envs=episodes)
    return episode(team, env, 2 * STEPS, 10**6 + seed)[STEPS:].mean().item()


def interval(values):
    """Mean, and half of its 95 % interval by Student's distribution."""
    values = torch.tensor(values, dtype=torch.float64)
    return values.mean().item(), STUDENT[len(values) - 2] * values.std().item() / math.sqrt(len(values))


def compare(task, seeds, updates, say=print, out=None):
    """Trains teams with and without the radio and judges both with and without it; returns all rows, which ``out`` has, too."""
    if not 2 <= len(seeds) <= len(STUDENT) + 1:
        raise ValueError(f"seeds: {len(seeds)} is not 2 to {len(STUDENT) + 1}, for which there are intervals")
    rows = []
    for seed in seeds:
        for trained in (None, WEAK):
            begin = time.time()
            team, curve = train(task, trained, updates, seed)
            row = {"task": task, "seed": seed, "trained": "radio" if trained else "at once"}
            row |= {"radio": judged(team, task, WEAK, seed), "at once": judged(team, task, None, seed), "curve": curve}
            rows.append(row)
            minutes = (time.time() - begin) / 60
            say(f"{task}, seed {seed}, trained {row['trained']:8} {row['radio']:.3f} m on the radio, {row['at once']:.3f} m"
                f" without, {minutes:.1f} min")
            if out:
                with open(out, "w") as file:
                    json.dump(rows, file)
    for trained in ("at once", "radio"):
        for judge in ("radio", "at once"):
            mean, half = interval([row[judge] for row in rows if row["trained"] == trained])
            say(f"{task}: trained {trained:8} judged {judge:8} {mean:.3f} +- {half:.3f} m")
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--task", default="simple_speaker_listener")
    parser.add_argument("--seeds", type=int, default=3, help="number of trainings of each kind, 2 to 30")
    parser.add_argument("--updates", type=int, default=120)
    parser.add_argument("--out", help="file of JSON for all rows with their curves")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    compare(arguments.task, range(arguments.seeds), arguments.updates, out=arguments.out)
