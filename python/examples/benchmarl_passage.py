"""IPPO or MAPPO of BenchMARL with a graph network, on a scenario; the trained actor as a policy file.

    python python/examples/benchmarl_passage.py --algorithm mappo --frames 2000000 --out policy.safetensors

pip install ./python benchmarl torch_geometric.
"""

import argparse
import csv
import pathlib
import tempfile
import time

import torch
from benchmarl.algorithms import IppoConfig, MappoConfig
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models import GnnConfig, MlpConfig, SequenceModelConfig
from torch import nn
from torch_geometric.nn import GraphConv, TransformerConv

import murmurate
from murmurate.benchmarl import Task

# Penalties for contacts and nearness grow by stages, else a team learns to stand still: share of the training that a stage
# takes, and the factor on them.
STAGES = [(0.06, 0.04), (0.08, 0.1), (0.26, 0.3), (0.6, 1.0)]
TEAMS, FRAMES = 512, 16384
ALGORITHMS = {"ippo": IppoConfig, "mappo": MappoConfig}


def mlp(*cells):
    return MlpConfig(num_cells=list(cells), activation_class=nn.ReLU, layer_class=nn.Linear)


def actor(kind):
    """An actor, and whether it needs the edges of the task."""
    if kind == "mlp":
        return mlp(64, 64), False
    if kind == "transformer":
        edges = {"position_key": "position", "pos_features": 2, "exclude_pos_from_node_features": True}
        edges |= {"velocity_key": "velocity", "vel_features": 2}
        gnn = GnnConfig(topology="full", self_loops=False, gnn_class=TransformerConv, gnn_kwargs={}, **edges)
        return SequenceModelConfig(model_configs=[gnn, mlp(64, 64)], intermediate_sizes=[64]), True
    gnn = GnnConfig(topology="full", self_loops=False, gnn_class=GraphConv, gnn_kwargs={"aggr": "add"})
    return SequenceModelConfig(model_configs=[mlp(64), gnn, mlp(64)], intermediate_sizes=[32, 64]), False


def settings(folder, frames, lr):
    config = ExperimentConfig.get_from_yaml()
    config.loggers, config.create_json, config.evaluation, config.render = ["csv"], False, False, False
    config.save_folder, config.max_n_frames = str(folder), max(frames, FRAMES)
    config.on_policy_n_envs_per_worker, config.on_policy_collected_frames_per_batch = TEAMS, FRAMES
    config.on_policy_minibatch_size, config.on_policy_n_minibatch_iters = 1024, 3
    config.lr, config.gamma, config.clip_grad_val = lr, 0.995, 0.5
    return config


class Curve(Callback):
    """Minutes and frames since the training began, and the share of ended episodes in which all robots arrived."""

    def __init__(self, begin, frames_before):
        super().__init__()
        self.rows, self.frames_before, self.begin = [], frames_before, begin
        self.over, self.there = 0, 0

    def on_batch_collected(self, batch):
        self.over += batch["next", "done"].sum().item()
        self.there += batch["next", "terminated"].sum().item()
        if self.over and self.experiment.n_iters_performed % 10 == 9:
            frames = self.frames_before + self.experiment.total_frames
            minutes = (time.time() - self.begin) / 60
            deviation = batch["agents", "scale"].mean().item()
            arrived = f"all arrived in {self.there} of {self.over} episodes"
            print(f"\n{minutes:6.1f} min, {frames:9d} frames: {arrived}; deviation {deviation:.2f}", flush=True)
            self.rows.append((minutes, frames, self.there / self.over))
            self.over, self.there = 0, 0


def train(folder, algorithm="mappo", kind="graph", frames=2_000_000, conditions="perfect", seed=0):
    """Trains in stages; returns the last experiment and the rows of its curves. A frame is a decision of a whole team.

    The experiments have their files in the folder.
    """
    torch.set_num_threads(1)  # networks this small are slower on more
    learnt, rows, done, begin = None, [], 0, time.time()
    for stage, (share, factor) in enumerate(STAGES):
        model, edges = actor(kind)
        rule = ALGORITHMS[algorithm].get_from_yaml()
        # A plain normal distribution that begins at half a metre per second.
        rule.use_tanh_normal, rule.scale_mapping = False, "biased_softplus_0.5"
        rule.lmbda, rule.entropy_coef = 0.95, 0.0
        # An action is held for four steps of 50 ms.
        task = Task("passage", edges=edges, repeat=4, conditions=conditions, config="published", penalties=factor)
        curve = Curve(begin, done)
        experiment = Experiment(
            task=task, algorithm_config=rule, model_config=model, critic_model_config=mlp(128, 128),
            seed=seed + stage, config=settings(folder, round(frames * share), (1e-3, 8e-4, 5e-4, 2e-4)[stage]),
            callbacks=[curve],
        )
        # Without it, no team arrives in two million frames, and deviations grow or vanish.
        experiment.losses["agents"].normalize_advantage = True
        if learnt is not None:
            experiment.losses["agents"].load_state_dict(learnt)
        experiment.run()
        learnt = experiment.losses["agents"].state_dict()
        rows, done = rows + curve.rows, done + experiment.total_frames
    return experiment, rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--algorithm", choices=ALGORITHMS, default="mappo")
    parser.add_argument("--actor", choices=["graph", "transformer", "mlp"], default="graph")
    parser.add_argument("--frames", type=int, default=2_000_000)
    parser.add_argument("--conditions", default="perfect")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="policy.safetensors")
    parser.add_argument("--curve", help="CSV file for minutes, decisions and the share of episodes in which all arrived")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        begin = time.time()
        experiment, curve = train(
            folder, arguments.algorithm, arguments.actor, arguments.frames, arguments.conditions, arguments.seed
        )
        if arguments.curve:
            with open(arguments.curve, "w", newline="") as out:
                csv.writer(out).writerows([("minutes", "decisions", "all_arrived"), *curve])
        print(f"trained in {(time.time() - begin) / 60:.1f} min")
        # Robots sample: means can wait for each other, which costs 17 % of the episodes.
        murmurate.export(arguments.out, experiment, draw="sample")
    print(murmurate.sim("passage", arguments.out, mode="sim", episodes=2000, repeats=1))
