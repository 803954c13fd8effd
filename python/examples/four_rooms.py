"""Four rooms: a task in Python, drawn, driven by scripted navigation, and the start of a training (docs/python-tasks.md)."""

import argparse
import pathlib

import numpy as np

import murmurate


class FourRooms(murmurate.Scenario):
    """Robots change rooms through four doors."""

    robots = {"default": 6, "least": 2, "most": 12}
    half_extent_m = [3.0, 3.0]
    _halves = ([-3, -0.15, -2, 0.15], [-1, -0.15, 1, 0.15], [2, -0.15, 3, 0.15])
    walls = [{"rect": wall} for wall in _halves]
    walls += [{"rect": wall} for wall in ([-0.15, -3, 0.15, -2], [-0.15, -1, 0.15, 1], [-0.15, 2, 0.15, 3])]
    rules = {"arrival_m": 0.25, "limit_s": 60.0}
    _cells = np.array([[x, y] for x in (-2.3, -1.1, 1.1, 2.3) for y in (-2.3, -1.1, 1.1, 2.3)])

    def reset(self, rng, n):
        start = self._cells[rng.orders(16)[:, : self.num_robots]] + rng.uniform(-0.2, 0.2, (n, self.num_robots, 2))
        return start, np.flip(start, 2) * (-1, 1)  # the next room, a quarter turn further

    def observe(self, state):
        away = np.linalg.norm(state.position[:, :, None] - state.position[:, None], axis=-1)
        return np.sort(away, axis=2)[:, :, 1:2]  # distance to the nearest other robot [m]

    def reward(self, state):
        return 4.0 * state.progress_m - 8.0 * (state.wall | state.robot) - 0.025

    def done(self, state):
        return state.wall.any(axis=1)  # a touched wall ends the episode


def mean_reward(weights, steps=100):
    """Mean reward of a policy with one layer, in the same episodes for all weights."""
    env = murmurate.VecEnv(FourRooms, 64, seed=0, threads=2)
    total = 0.0
    for _ in range(steps):
        seen = np.concatenate((env.obs, env.observed), axis=2)
        env.step(np.tanh(seen @ weights).astype(np.float32))
        total += float(env.reward.mean())
    return total / steps


def train(updates, seed=0, deviation=0.05):
    """Evolution strategy in its simplest form: moves the weights to where the reward is larger."""
    stream, weights, curve = np.random.default_rng(seed), np.zeros((7, 2)), []
    for _ in range(updates):
        ways = stream.standard_normal((4, *weights.shape))
        gains = [mean_reward(weights + deviation * way) - mean_reward(weights - deviation * way) for way in ways]
        weights += 0.2 * sum(gain * way for gain, way in zip(gains, ways)) / np.std(gains)
        curve.append(mean_reward(weights))
    return weights, curve


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("four-rooms.html"), help="animation of an episode")
    parser.add_argument("--episodes", type=int, default=40, help="episodes of scripted navigation")
    parser.add_argument("--updates", type=int, default=5, help="updates of the training")
    flags = parser.parse_args()
    murmurate.check_scenario(FourRooms)
    murmurate.sim(FourRooms, "orca", episodes=1, animate=flags.out)
    results = murmurate.sim(FourRooms, "orca", mode="offboard", episodes=flags.episodes)
    print(f"orca: {results.success_rate:.0%} of {results.episodes} episodes, mean return {results.mean_return:.1f}")
    _, curve = train(flags.updates)
    print("training, mean reward of a step:", *(f"{reward:.3f}" for reward in curve))


if __name__ == "__main__":
    main()
