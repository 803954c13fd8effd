"""A policy with messages, learnt from Python alone: proximal policy optimisation in a file of your own.

    python python/examples/ppo.py --minutes 30 --out policy.safetensors

pip install ./python torch torch_geometric. Edit what you like: the network, the loss, the stages. The environment is
`murmurate.VecEnv`; the file written at the end is for `murmurate sim --policy`, `study` and robots.
"""

import argparse
import csv
import math
import time

import numpy as np
import torch
from torch import nn
from torch_geometric.nn import GINEConv

import murmurate

# Penalties for contacts and nearness grow by stages, else a team learns to stand still: until which share of the training,
# and the factor on them.
STAGES = [(0.06, 0.04), (0.14, 0.1), (0.4, 0.3), (1.0, 1.0)]
STEPS, REPEAT, EPOCHS, GAMMA, LAMBDA, CLIP = 32, 4, 3, 0.995, 0.95, 0.2


class Policy(nn.Module):
    """An encoder, one round of messages, and a decoder; beside them a critic that sees the whole team."""

    def __init__(self, floats: int, robots: int, width: int = 32):
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(floats, 32), nn.ReLU(), nn.Linear(32, width))
        self.hop = GINEConv(nn.Sequential(nn.Linear(width, 64), nn.ReLU(), nn.Linear(64, 64)), train_eps=True, edge_dim=2)
        self.decoder = nn.Sequential(nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, 2))
        self.log_std = nn.Parameter(torch.full((2,), -0.5))
        self.critic = nn.Sequential(
            nn.Linear(floats * (robots + 1), 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, 1)
        )

    def forward(self, obs, heard, said):
        """Mean velocities (N, R, 2) [m/s] from observations (N, R, F), and what each robot heard of others."""
        n, robots, floats = obs.shape
        team, receiver, sender = heard.nonzero(as_tuple=True)
        # What the sender observed when it sent is encoded here, so gradients reach its encoder, however late it came.
        words = said[team, receiver, sender]
        way = words[:, 2:4] - obs[team, receiver, 2:4]
        index = torch.stack([torch.arange(len(team)), team * robots + receiver])
        own = self.encoder(obs).view(n * robots, -1)
        heard_of = self.encoder(words)
        return self.decoder(self.hop((heard_of, own), index, way, size=(len(team), n * robots))).view(n, robots, 2)

    def value(self, obs):
        """Expected returns (N, R)."""
        n, robots, floats = obs.shape
        team = obs.reshape(n, 1, robots * floats).expand(n, robots, -1)
        return self.critic(torch.cat([obs, team], dim=-1)).squeeze(-1)


def environment(factor, **options):
    """An environment whose penalties are those of the preset times a factor."""
    return murmurate.VecEnv("passage", message="observations", config="published", penalties=factor, **options)


def rollout(env, policy, std):
    """STEPS decisions of every team, each held for REPEAT steps; with advantages and returns."""
    seen = lambda: [torch.from_numpy(array).clone() for array in (env.obs, env.heard, env.said)]
    rows, ended, arrived = [], 0, 0
    for _ in range(STEPS):
        inputs = seen()
        with torch.no_grad():
            mean, value = policy(*inputs), policy.value(inputs[0])
        action = mean + std * torch.randn_like(mean)
        reward, going, bootstrap = 0.0, torch.ones(env.num_envs, 1), torch.zeros_like(value)
        for _ in range(REPEAT):
            env.step(action.numpy())
            reward = reward + torch.from_numpy(env.reward) * going
            over = torch.from_numpy(env.terminated | env.truncated)
            late = torch.from_numpy(env.truncated & ~env.terminated)
            first = over & (going[:, 0] > 0)
            if (late & first).any():
                with torch.no_grad():
                    left = policy.value(torch.from_numpy(env.last_obs))
                bootstrap[late & first] = left[late & first]
            ended, arrived = ended + int(over.sum()), arrived + int(env.terminated.sum())
            going = going * (~over).float()[:, None]
        rows.append((*inputs, action, mean, value, reward + GAMMA * bootstrap, going))
    with torch.no_grad():
        following = policy.value(torch.from_numpy(env.obs))
    advantage, advantages = torch.zeros_like(following), []
    for *_, value, reward, going in reversed(rows):
        advantage = reward + GAMMA * going * following - value + GAMMA * LAMBDA * going * advantage
        following = value
        advantages.insert(0, advantage)
    obs, heard, said, action, mean, value, _, _ = (torch.cat(column) for column in zip(*rows))
    advantages = torch.cat(advantages)
    return (obs, heard, said, action, mean, advantages, advantages + value), ended, arrived


def train(minutes=None, decisions=None, teams=512, conditions="perfect", seed=0, threads=1, say=print):
    """Trains a policy until the time or the decisions are over; returns it, its environment and the curve.

    A decision is one of a whole team. The curve has a row for every ten updates: minutes, decisions, share of the episodes
    that ended since the row before in which all arrived (0 to 1; NaN without any).
    """
    torch.set_num_threads(1)  # networks this small are slower on more
    torch.manual_seed(seed)
    begin, done, at, env, curve = time.time(), 0, -1, None, []
    updates, over, there = 0, 0, 0  # updates; since the last row, ended episodes and those in which all arrived
    share = lambda: max((time.time() - begin) / 60 / minutes if minutes else 0, done / decisions if decisions else 0)
    policy = None
    while share() < 1:
        now = share()
        stage = next(index for index, (until, _) in enumerate(STAGES) if now < until)
        if stage != at:
            at = stage
            options = {"conditions": conditions, "threads": threads, "seed": seed + stage}
            env = environment(STAGES[stage][1], num_envs=teams, **options)
        if policy is None:
            policy = Policy(env.obs.shape[2], env.num_robots)
            optimiser = torch.optim.Adam(policy.parameters(), lr=1e-3)
        for group in optimiser.param_groups:
            group["lr"] = 1e-3 + (5e-5 - 1e-3) * now
        most = -0.3 + (-2.5 + 0.3) * now
        with torch.no_grad():
            policy.log_std.clamp_(max=most)
        data, ended, arrived = rollout(env, policy, policy.log_std.detach().exp())
        before = policy.log_std.detach().clone()
        update(policy, optimiser, data, before, entropy=0.01 * (1 - now))
        done += teams * STEPS
        updates, over, there = updates + 1, over + ended, there + arrived
        if updates % 10 == 0:
            curve.append(((time.time() - begin) / 60, done, there / over if over else math.nan))
            say(f"{curve[-1][0]:6.1f} min {done:9d} decisions, stage {stage}: all arrived in {there} of {over} episodes")
            over, there = 0, 0
    return policy, env, curve


def update(policy, optimiser, data, old_log_std, entropy, minibatch=1024):
    """Epochs of minibatches, until the policy has moved too far."""
    log_density = lambda action, mean, log_std: (-0.5 * ((action - mean) / log_std.exp()) ** 2 - log_std).sum(-1)
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(data[0])).split(minibatch):
            obs, heard, said, action, old_mean, advantage, returns = (column[rows] for column in data)
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-6)
            change = log_density(action, policy(obs, heard, said), policy.log_std) - log_density(action, old_mean, old_log_std)
            ratio = change.exp()
            gain = torch.min(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage).mean()
            loss = -gain + 0.5 * (policy.value(obs) - returns).pow(2).mean() - entropy * policy.log_std.sum()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
            optimiser.step()
        if (ratio - 1 - change).mean() > 0.03:
            break


def export(file, policy, env):
    """Writes the policy, with its deviations, to a file that the program runs. Robots sample: means can wait for each other."""
    last = policy.decoder[-1]
    four = nn.Linear(last.in_features, 4)
    with torch.no_grad():
        four.weight.copy_(torch.cat([last.weight, torch.zeros_like(last.weight)]))
        four.bias.copy_(torch.cat([last.bias, policy.log_std]))
    decoder = nn.Sequential(*policy.decoder[:-1], four)
    return murmurate.export(
        file, policy.encoder, [policy.hop], decoder, like=env, edge=["relative-position"], draw="sample"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--decisions", type=int)
    parser.add_argument("--conditions", default="perfect")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="policy.safetensors")
    parser.add_argument("--curve", help="CSV file for minutes, decisions and the share of episodes in which all arrived")
    arguments = parser.parse_args()
    minutes = None if arguments.decisions else arguments.minutes
    policy, env, curve = train(minutes, arguments.decisions, conditions=arguments.conditions, seed=arguments.seed)
    if arguments.curve:
        with open(arguments.curve, "w", newline="") as out:
            csv.writer(out).writerows([("minutes", "decisions", "all_arrived"), *curve])
    export(arguments.out, policy, env)
    print(murmurate.sim("passage", arguments.out, mode="sim", episodes=2000, repeats=1))
