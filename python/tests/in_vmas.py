"""Drives VMAS's `navigation` by a policy file of format 2, and by a policy of BenchMARL that was trained there.

    python python/tests/in_vmas.py FILE [--robots 4] [--environments 500] [--steps 200]
    python python/tests/in_vmas.py --mappo MINUTES [--robots 4]          (pip install benchmarl)

A team succeeds once all its robots are at their goals, by VMAS's own rule; `clean` are the successes without a collision, by
VMAS's own penalty for it. A policy file observes what VMAS's observation has: goal minus position, velocity and the 12 rays
of the lidar. Neighbours are all others, and messages are perfect. Its velocity becomes the force that leads to it within a
step, as far as VMAS allows one.
"""

import argparse
import json
import struct
import sys
import tempfile
import time

import torch
import vmas

try:
    from benchmarl.experiment import Callback
except ImportError:
    Callback = object

STEP_S, DRAG, RANGE_M = 0.1, 0.25, 0.35


class File:
    """Networks of a policy file of format 2 with one hop, as functions of torch."""

    def __init__(self, path):
        data = open(path, "rb").read()
        (length,) = struct.unpack("<Q", data[:8])
        header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
        self.manifest = json.loads(header.pop("__metadata__")["murmurate"])
        assert self.manifest["format"] == 2 and len(self.manifest["hops"]) == 1, "one hop of format 2"
        self.tensors = {
            name: torch.frombuffer(bytearray(body[at["data_offsets"][0] : at["data_offsets"][1]]), dtype=torch.float32)
            .reshape(at["shape"]) for name, at in header.items()
        }

    def network(self, name, manifest, x):
        layers = len(manifest["widths"]) - 1
        for layer in range(layers):
            x = x @ self.tensors[f"{name}.{2 * layer}.weight"].T + self.tensors[f"{name}.{2 * layer}.bias"]
            kind = manifest.get("activation" if layer < layers - 1 else "output_activation")
            x = {None: lambda x: x, "relu": torch.relu, "tanh": torch.tanh}[kind](x)
        return x

    def act(self, positions, velocities, goals, scans):
        """Velocities of all robots [N, R, 2] from positions, velocities, goals [N, R, 2] and scans [N, R, K]."""
        manifest, hop = self.manifest, self.manifest["hops"][0]
        fields = {"goal-minus-position": goals - positions, "velocity": velocities,
                  "filter-and-lag": torch.zeros_like(positions)}
        entries = [fields[entry] if isinstance(entry, str) else scans for entry in manifest["observation"]]
        h = self.network("encoder", manifest["encoder"], torch.cat(entries, -1))
        robots = h.shape[1]
        offsets = positions[:, None] - positions[:, :, None]
        edges = {"age": torch.zeros(*offsets.shape[:3], 1), "relative-position": offsets}
        parts = {"own": h[:, :, None].expand(-1, -1, robots, -1), "sender": h[:, None].expand(-1, robots, -1, -1),
                 "edge": torch.cat([edges[feature] for feature in manifest["edge"]], -1)}
        messages = self.network("hops.0.message", hop["message"], torch.cat([parts[part] for part in hop["message"]["inputs"]], -1))
        near = (offsets.norm(dim=-1) <= manifest["radius_m"]) & ~torch.eye(robots, dtype=torch.bool)
        parts = {"own": h, "messages": (messages * near[..., None]).sum(2)}
        h = self.network("hops.0.update", hop["update"], torch.cat([parts[part] for part in hop["update"]["inputs"]], -1))
        limit = manifest["limit_m_s"]
        return self.network("decoder", manifest["decoder"], h)[..., :2].clamp(-limit, limit)


def of_file(path):
    policy = File(path)

    def act(env, observations):
        all_of = torch.stack(observations, 1)
        positions, velocities = all_of[..., :2], all_of[..., 2:4]
        # VMAS gives how much nearer than its range an echo is, from the x axis on; policies get distances, from behind on.
        scans = (RANGE_M - all_of[..., 6:]).roll(-(all_of.shape[-1] - 6) // 2, -1)
        wanted = policy.act(positions, velocities, positions - all_of[..., 4:6], scans)
        force = (wanted - velocities * (1 - DRAG)) / STEP_S
        return list(force.clamp(-1, 1).unbind(1))

    return act


class Budget(Callback):
    """Ends a training by `TimeoutError` once it has used so many seconds of processor time, and counts its frames."""

    def __init__(self, seconds):
        super().__init__()
        self.end, self.frames = time.process_time() + seconds, 0

    def on_batch_collected(self, batch):
        self.frames += batch.numel()

    def on_train_end(self, training_td, group):
        if time.process_time() >= self.end:
            raise TimeoutError


def of_mappo(minutes, robots):
    """MAPPO of BenchMARL with the settings of its fine-tuned example for VMAS, for so many minutes of processor time."""
    from benchmarl.algorithms import MappoConfig
    from benchmarl.environments import VmasTask
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig
    from tensordict import TensorDict
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    config = ExperimentConfig.get_from_yaml()
    config.sampling_device = config.train_device = config.buffer_device = "cpu"
    config.share_policy_params, config.max_n_frames, config.max_n_iters = True, 10**9, None
    config.gamma, config.lr = 0.9, 5e-5
    config.on_policy_collected_frames_per_batch, config.on_policy_n_envs_per_worker = 60_000, 600
    config.on_policy_n_minibatch_iters, config.on_policy_minibatch_size = 45, 4096
    config.evaluation = config.render = config.create_json = False
    config.loggers, config.checkpoint_interval = [], 0
    task = VmasTask.NAVIGATION.get_from_yaml()
    task.config["n_agents"], task.config["max_steps"] = robots, 100
    algorithm = MappoConfig.get_from_yaml()
    algorithm.share_param_critic, algorithm.entropy_coef, algorithm.critic_coef, algorithm.lmbda = True, 0, 1, 0.9
    network = MlpConfig(num_cells=[256, 256], layer_class=torch.nn.Linear, activation_class=torch.nn.Tanh)
    config.save_folder = tempfile.mkdtemp()
    began = time.process_time()
    budget = Budget(60 * minutes)
    experiment = Experiment(task=task, algorithm_config=algorithm, model_config=network, critic_model_config=network, seed=0,
                            config=config, callbacks=[budget])
    try:
        experiment.run()
    except TimeoutError:
        pass
    print(f"MAPPO: {budget.frames} frames in {(time.process_time() - began) / 60:.1f} CPU minutes", file=sys.stderr)

    def act(env, observations):
        seen = TensorDict({"agents": TensorDict({"observation": torch.stack(observations, 1)}, [env.num_envs, robots])},
                          [env.num_envs])
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            return list(experiment.policy(seen)["agents", "action"].unbind(1))

    return act


def judge(act, robots, environments, steps):
    env = vmas.make_env("navigation", num_envs=environments, device="cpu", continuous_actions=True, seed=12345, n_agents=robots)
    observations = env.reset()
    over, touched = torch.zeros(environments, dtype=torch.bool), torch.zeros(environments, dtype=torch.bool)
    when = torch.full((environments,), steps)
    for step in range(steps):
        observations = env.step(act(env, observations))[0]
        hit = torch.stack([agent.agent_collision_rew < 0 for agent in env.scenario.world.agents]).any(0)
        touched |= hit & ~over
        arrived = env.scenario.done() & ~over
        when[arrived] = step + 1
        over |= arrived
    median_s = when[over].float().median().item() * STEP_S if over.any() else None
    share = over.float().mean().item()
    return {"success": share, "clean": (over & ~touched).float().mean().item(), "makespan_median_s": median_s}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("file", nargs="?")
    parser.add_argument("--mappo", type=float, metavar="MINUTES")
    parser.add_argument("--robots", type=int, default=4)
    parser.add_argument("--environments", type=int, default=500)
    parser.add_argument("--steps", type=int, default=200)
    given = parser.parse_args()
    torch.set_num_threads(1)
    act = of_file(given.file) if given.file else of_mappo(given.mappo, given.robots)
    with torch.no_grad():
        print(json.dumps(judge(act, given.robots, given.environments, given.steps)))


if __name__ == "__main__":
    main()
