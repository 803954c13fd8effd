"""The policy of the team in numpy: what `murmurate` computes for it, from `experiment.json` and `weights.npy`."""

import numpy as np


def activated(kind, x):
    """Returns the activation `kind` of x, in the words of policy files."""
    if kind in (None, "linear"):
        return x
    if kind == "relu":
        return np.maximum(x, np.float32(0))
    if kind == "tanh":
        return np.tanh(x)
    if kind == "elu":
        return np.where(x > 0, x, np.expm1(np.minimum(x, np.float32(0))))
    return np.where(x > 0, x, x * np.float32(kind["leaky-relu"]))


def sigmoid(x):
    return np.float32(1) / (np.float32(1) + np.exp(-x))


class Actor:
    """Policy of a team: one step of all robots, with their messages to each other in between."""

    def __init__(self, experiment, weights, seed=0):
        self.policy = experiment["policy"]
        self.constant = np.array([1.0, experiment["safety"]["lag_s"]], np.float32)  # filter on, lag of the drive [s]
        self.tensors, at = {}, 0
        for tensor in experiment["tensors"]:
            count = int(np.prod(tensor["shape"]))
            self.tensors[tensor["name"]] = weights[at : at + count].reshape(tensor["shape"])
            at += count
        if at != weights.size:
            raise ValueError(f"weights.npy: {weights.size} floats; experiment.json names {at}")
        self.random = np.random.default_rng(seed)
        self.reset()

    def reset(self):
        """Forgets all steps before, as at the start of an episode."""
        self.state = None

    def network(self, name, layers, x):
        """Applies the perceptron `name` to the rows of x."""
        depth = len(layers["widths"]) - 1
        for layer in range(depth):
            key = f"{name}.{2 * layer}"
            x = x @ self.tensors[key + ".weight"].T + self.tensors[key + ".bias"]
            x = activated(layers.get("output_activation" if layer + 1 == depth else "activation"), x)
        return x

    def observed(self, position, velocity, goal):
        """Returns the encoder's input of each robot; all arguments are of shape [robots, 2], in policy frames."""
        values = {
            "goal-minus-position": goal - position,
            "position": position,
            "position-plus-velocity": position + velocity,
            "velocity": velocity,
            "filter-and-lag": np.broadcast_to(self.constant, position.shape),
        }
        return np.concatenate([values[entry] for entry in self.policy["observation"]], 1)

    def remembered(self, x):
        """Returns the state of each robot after the step, by a gated recurrent unit."""
        floats = self.policy["memory"]["floats"]
        before = np.zeros((len(x), floats), np.float32) if self.state is None else self.state
        given = x @ self.tensors["memory.input.weight"].T + self.tensors["memory.input.bias"]
        kept = before @ self.tensors["memory.state.weight"].T + self.tensors["memory.state.bias"]
        [gr, gz, gn], [kr, kz, kn] = np.split(given, 3, 1), np.split(kept, 3, 1)
        reset, update = sigmoid(gr + kr), sigmoid(gz + kz)
        self.state = (np.float32(1) - update) * np.tanh(gn + reset * kn) + update * before
        return self.state

    def edges(self, offset, relative_velocity):
        """Returns the edge features of the neighbours of one robot: messages of this step, so of age zero."""
        values = {
            "age": np.zeros((len(offset), 1), np.float32),
            "relative-position": offset,
            "distance": np.linalg.norm(offset, axis=1, keepdims=True).astype(np.float32),
            "relative-velocity": relative_velocity,
        }
        features = [values[feature] for feature in self.policy.get("edge", [])]
        return np.concatenate(features, 1) if features else np.zeros((len(offset), 0), np.float32)

    def hop(self, name, hop, own, senders, edges):
        """Returns the output of a hop for one robot with the input `own`, from the inputs of its neighbours."""
        if hop.get("self_loop"):
            mean = hop["self_loop"] == "mean-edge" and len(edges)
            loop = edges.mean(0, keepdims=True) if mean else np.zeros((1, edges.shape[1]), np.float32)
            senders, edges = np.concatenate([senders, own[None]]), np.concatenate([edges, loop])
        if hop.get("relative"):
            senders = np.concatenate([senders - own, np.zeros((1, own.size), np.float32)])
        parts = {"own": np.broadcast_to(own, senders.shape), "sender": senders, "edge": edges}

        def each(network):
            layers = hop[network]
            given = np.concatenate([parts[part] for part in layers["inputs"]], 1)
            return self.network(f"{name}.{network}", layers, given)

        messages = each("message") if hop.get("message") else senders
        heads, kind = hop.get("heads") or 1, hop["aggregation"]
        if not len(messages):
            total = np.zeros(messages.shape[1], np.float32)
        elif kind in ("sum", "mean", "max"):
            total = getattr(messages, kind)(0)
        else:
            if kind == "softmax":
                scores = each("score")
            else:
                query = self.network(f"{name}.query", hop["query"], own[None]).reshape(1, heads, -1)
                keys = each("key").reshape(len(messages), heads, -1)
                scores = (query * keys).sum(2) / np.sqrt(np.float32(query.shape[2]))
            scores = np.exp(scores - scores.max(0))
            shares = scores / scores.sum(0)
            total = (shares[:, :, None] * messages.reshape(len(messages), heads, -1)).sum(0).ravel()
        if not hop.get("update"):
            return total
        parts = {"own": own, "messages": total}
        layers = hop["update"]
        whole = np.concatenate([parts[part] for part in layers["inputs"]])
        return self.network(f"{name}.update", layers, whole[None])[0]

    def deviation(self, x):
        if self.policy.get("deviation", "log") == "log":
            most = self.policy.get("log_std_max")
            return np.exp(x if most is None else np.minimum(x, most))
        return np.logaddexp(x + np.log(np.expm1(0.99)), 0) + 0.01

    def step(self, position, velocity, goal, half_turn):
        """Returns the wanted velocity of each robot [m/s], and what each says.

        `position`, `velocity` and `goal` have the shape [robots, 2] and are in the team's frame; `half_turn` says which
        robots see it turned by half a turn. A robot hears those within `radius_m`, in the order of their numbers.
        """
        sign = np.where(np.asarray(half_turn), -1.0, 1.0).astype(np.float32)[:, None]
        position, velocity, goal = (np.asarray(given, np.float32) for given in (position, velocity, goal))
        observed = self.observed(*(sign * given for given in (position, velocity, goal)))
        latent = self.network("encoder", self.policy["encoder"], observed)
        if self.policy.get("memory"):
            latent = self.remembered(latent)
        said = [latent]
        for number, hop in enumerate(self.policy["hops"]):
            rows = []
            for robot in range(len(position)):
                offset = position - position[robot]
                near = np.hypot(offset[:, 0], offset[:, 1]) <= self.policy["radius_m"]
                near[robot] = False
                edges = self.edges(sign[robot] * offset[near], sign[robot] * (velocity - velocity[robot])[near])
                rows.append(self.hop(f"hops.{number}", hop, latent[robot], latent[near], edges))
            latent = np.stack(rows)
            said.append(latent)
        outputs = self.network("decoder", self.policy["decoder"], latent) if self.policy.get("decoder") else latent
        action = outputs[:, :2]
        if self.policy["draw"] == "sample":
            action = action + self.random.standard_normal(action.shape) * self.deviation(outputs[:, 2:])
        if self.policy.get("action") == "acceleration":
            action = sign * velocity + np.clip(action, -1, 1) / self.policy["rate_hz"]
        elif self.policy["distribution"] == "tanh-normal":
            action = self.policy["limit_m_s"] * np.tanh(action)
        return sign * action, np.concatenate(said[:-1], 1)
