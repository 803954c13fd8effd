"""Export of modules as graphs of format 3: parity over 1000 steps, what is folded in, and refusals by name."""

import pathlib
import re

import numpy as np
import pytest
from needs import need

import murmurate
from murmurate import _engine, _onnx, _parity

torch = need("torch")
need("torch_geometric")
need("onnx")
need("onnxscript")
from graphs import GIVEN, MODULES, SENT, Recurrent, compared, convolutions, measured, mlp, noisy  # noqa: E402

nn = torch.nn
OBSERVED = ["goal-minus-position", "velocity"]


@pytest.mark.parametrize("name", [*MODULES, *convolutions()])
def test_a_graph_answers_as_its_module_over_1000_steps_and_runs(name, tmp_path):
    file, worst = measured(name, tmp_path)
    assert worst <= 2e-6
    results = murmurate.sim("swap", file, episodes=1, repeats=1)
    assert (results.episodes, results.aborted) == (1, 0)
    assert all(path.name.startswith("p.") for path in tmp_path.iterdir())


@pytest.mark.parametrize("name", convolutions())
def test_convolutions_of_robots_are_those_of_the_whole_team(name):
    """On a graph that stays as it is, once what is sent has come from all hops."""
    from murmurate._actors import Actor
    from murmurate._hops import edges_of
    from murmurate._probe import Team
    from murmurate._teams import mean_action, modules_of

    torch.manual_seed(3)
    hops, edge = convolutions()[name]
    noisy(hops)
    team = Team(["goal-minus-position", "position", "velocity"], edge)
    encoder, decoder = nn.Linear(6, 16), nn.Linear(16, 4)
    actor = Actor(encoder, hops, decoder, manifest={"distribution": "diagonal-normal", "deviation": "log"})
    with torch.no_grad():
        x = encoder(team.observation)
        for part in hops:
            convolution = hasattr(part, "aggr_module")
            x = part(x, team.index, *([team.edge] if edges_of(part) else [])) if convolution else part(x)
        modules = modules_of(actor, edge, 1.0, 6)
        assert torch.allclose(mean_action(modules, team.observation, team.index, team.edge, steps=8), decoder(x), atol=1e-6)


class Of(nn.Module):
    """Module that computes a function."""

    def __init__(self, forward):
        super().__init__()
        self.net = nn.Linear(4, 2)
        self.forward = forward.__get__(self)


def masked(self, x, messages, heard):
    score = messages[:, :, 0].masked_fill(heard == 0, -torch.inf)
    return self.net(x) + (score.softmax(1).unsqueeze(2) * messages).sum(1), self.net(x)


def divided(self, x, messages, heard):
    return self.net(x) + (messages * heard.unsqueeze(2)).sum(1) / heard.sum(1, keepdim=True), self.net(x)


def branching(self, x):
    return self.net(x) if x.sum() > 0 else -self.net(x)


def random(self, x):
    return self.net(x) + torch.rand_like(x[:, :2])


def peeking(self, x, messages, heard):
    return self.net(x) + messages.mean(1), self.net(x) * heard.sum()


def mixing(self, x):
    return self.net(x) - self.net(x).mean(0)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"step": Of(masked), "message": 2}, "step: Of: with no neighbour heard its output 'action' is not finite; give empty places no"),
        ({"step": Of(divided), "message": 2}, "step: Of: with no neighbour heard its output 'action' is not finite; give empty"),
        ({"step": Of(branching)}, "step: Of: PyTorch cannot export it: "),
        ({"step": Of(random)}, "step: Of: .* its output 'action' differs by .* between PyTorch and the graph"),
        ({"step": Of(peeking), "message": 2}, "what stands in places where 'heard' is 0|robots of one call affect each other"),
        ({"step": Of(mixing)}, "robots of one call affect each other"),
        ({"step": Of(masked)}, "step: Of: it takes 'messages', and there is none; give message=N"),
        ({"step": Recurrent(), "observations": GIVEN, "message": 8, "state": 16}, r"it takes 'edges', and there is none; give edges="),
        ({"step": Recurrent(), "observations": GIVEN, "message": 8, **SENT}, "it takes 'state', and there is none; give state=N"),
        ({"step": Recurrent(), "observations": GIVEN, "message": 9, "state": 16, **SENT}, "step: Recurrent: it does not take goal .*"),
        ({"step": mlp(4, 3)}, r"step: Sequential: its action has 3 floats; 2 are expected \(none\)"),
        ({"step": mlp(5)}, r"step: Sequential: it does not take goal-minus-position \[3, 2\], velocity \[3, 2\]: .*mat1"),
        ({"step": mlp(4), "message": 3}, "step: Sequential: it returns 1 tensors; \\(action, message\\) is expected"),
        ({"step": mlp(4).double()}, "step: Sequential: '0.weight' is torch.float64"),
        ({"step": torch.tanh}, "step: tanh is no module of PyTorch"),
        ({"step": Of(lambda self, *x: self.net(x[0]))}, r"step: Of: its forward takes '\*x'; give a module whose parameters"),
        ({"step": mlp(4), "encode": mlp(4)}, "step: one module makes a whole step"),
        ({"step": None, "encode": mlp(4)}, "act: missing; give step, or encode and act"),
        ({"step": None, "encode": Of(masked), "act": Of(mixing), "observations": {"x": OBSERVED}}, "encode: Of: it takes 'messages', and nothing is heard before it"),
        ({"stack": 0}, "stack: 0 is no whole number of at least 1"),
        ({"normalize": 3}, r"normalize: give \(mean, standard deviation\)"),
        ({"normalize": ([1, 2, 3], 1)}, "normalize: it does not have one number for each of 4 floats"),
        ({"normalize": (0, 0)}, "normalize: its numbers are not finite, or a standard deviation is not above zero"),
        ({"limit": None}, "limit: missing"),
        ({"rate_hz": 5}, "rate_hz: 5 is not 10 to 1000"),
        ({"max_neighbours": 100}, "max_neighbours: 100 is not 1 to 64"),
        ({"like": "passage"}, "like: str is neither a VecEnv nor"),
    ],
)
def test_what_cannot_be_exported_is_refused_by_name_and_changes_no_file(change, words, tmp_path):
    file, graph = tmp_path / "p.policy.toml", tmp_path / "p.onnx"
    file.write_text("before")
    graph.write_text("before")
    given = {"step": mlp(4), "observations": OBSERVED, "limit": 1.0, **change}
    with pytest.raises(ValueError, match=words):
        murmurate.export_graph(file, **given)
    assert file.read_text() == graph.read_text() == "before" and len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("most_nodes", [0, _engine.MOST_NODES])
def test_an_answer_that_differs_in_a_graph_or_in_the_engine_is_named_with_its_size(most_nodes, tmp_path, monkeypatch):
    file, module = tmp_path / "p.policy.toml", mlp(4)

    def other(made, *arguments):
        with torch.no_grad():
            module[2].bias += 1e-3
            data = graph_of(made, *arguments)
            module[2].bias -= 1e-3
        return data

    graph_of = _onnx.graph_of
    with monkeypatch.context() as patch:
        patch.setattr(_onnx, "graph_of", other)
        with pytest.raises(ValueError, match=r"step: Sequential: .*its output 'action' differs by 1.0e-03 between PyTorch and the graph"):
            murmurate.export_graph(file, module, observations=OBSERVED, limit=1.0)
    compare = _parity.compare

    def elsewhere(*arguments):
        worst, samples = compare(*arguments)
        samples[-1].outputs["action"] = samples[-1].outputs["action"] + np.float32(2e-3)
        return worst, samples

    monkeypatch.setattr(_parity, "compare", elsewhere)
    monkeypatch.setattr(_engine, "MOST_NODES", most_nodes)
    with pytest.raises(ValueError, match="its output 'action' differs by more than 1e-03 between PyTorch and the program"):
        murmurate.export_graph(file, module, observations=OBSERVED, limit=1.0)
    assert not list(tmp_path.iterdir())


def answers(file, **inputs):
    """What the graph of a policy answers."""
    graph = _onnx.Session(pathlib.Path(str(file).replace(".policy.toml", ".onnx")).read_bytes())
    return graph.run({name: np.asarray(value, np.float32) for name, value in inputs.items()})


def test_a_normalisation_and_frames_are_those_of_the_trainer(tmp_path):
    """A graph with a state keeps the frames; before the first there are zeros, or copies of it."""
    module = nn.Linear(4, 2, bias=False)
    with torch.no_grad():
        module.weight.copy_(torch.tensor([[1.0, 0, 0, 0], [0, 0, 1, 0]]))
    for start, before in (("zeros", 0.0), ("first", 3.0)):
        file = murmurate.export_graph(
            tmp_path / "p.policy.toml", module, observations="velocity", normalize=([1.0, 0.0], 0.5, 3.0), stack=2, stack_start=start,
            limit=1.0,
        )  # fmt: skip
        state = np.zeros((1, 3 if start == "first" else 2), np.float32)
        first = answers(file, input=[[4.0, 0.0]], state=state)
        assert first["action"].tolist() == [[before, 3.0]], "the limit of the normalisation holds"
        second = answers(file, input=[[1.5, 0.0]], state=first["state_next"])
        assert second["action"].tolist() == [[3.0, 1.0]]


def test_an_observation_norm_around_the_environment_is_folded_in(tmp_path):
    need("torchrl")
    from torchrl.envs import ObservationNorm, TransformedEnv

    from murmurate.torchrl import Env

    scale, loc, module = torch.linspace(0.5, 3, 6), torch.linspace(-1, 2, 6), mlp(6)
    env = TransformedEnv(Env("passage", 1), ObservationNorm(loc=loc, scale=scale, in_keys=[("agents", "observation")]))
    file = murmurate.export_graph(tmp_path / "p.policy.toml", module, like=env)
    seen = torch.randn(8, 6)
    goal, position, both = seen.split(2, 1)
    inputs = {"goal-minus-position": goal, "position": position, "velocity": both - position}
    with torch.no_grad():
        assert np.allclose(answers(file, **inputs)["action"], module(seen * scale + loc).numpy(), atol=1e-5)
    with pytest.raises(ValueError, match="^like: its ObservationNorm is of the whole observation, and 'input' takes another"):
        murmurate.export_graph(tmp_path / "p.policy.toml", mlp(2), like=env, observations="velocity")


def test_what_is_of_the_environment_is_taken_from_it(tmp_path):
    import tomllib

    env = murmurate.VecEnv("swap", num_robots=6)
    file = murmurate.export_graph(tmp_path / "p.policy.toml", mlp(6, 4), like=env)
    told = tomllib.loads(file.read_text())
    assert (told["radius_m"], told["hold_s"], told["max_neighbours"]) == (round(env.radius_m, 6), env.hold_s, 5)
    assert told["action"]["limit"] == round(env.limit_m_s, 6) and told["action"]["distribution"] == "diagonal-normal"
    assert list(told["observation"]) == ["goal-minus-position", "position", "velocity"]
    assert murmurate.sim("swap", file, episodes=1, repeats=1, action="sample").aborted == 0


def test_compiled_modules_and_activations_that_the_engine_lacks_are_written(tmp_path):
    mish = nn.Sequential(nn.Linear(4, 8), nn.Mish(), nn.Linear(8, 2), nn.Mish())
    with compared() as found:
        murmurate.export_graph(tmp_path / "p.policy.toml", torch.compile(mish), observations=OBSERVED, limit=1.0)
    assert found[0] <= 2e-6


def test_small_terms_unused_inputs_and_outputs_that_are_one_tensor_are_kept_right(tmp_path):
    class Module(nn.Module):
        def __init__(self):
            super().__init__()
            self.cell = nn.GRUCell(2, 2)

        def forward(self, velocity, goal, messages, heard, state):
            state = self.cell(velocity, state)
            near = (messages * heard.unsqueeze(2)).sum(1) / (heard.sum(1, keepdim=True) + 1e-9)
            return state + near, state, state

    file = murmurate.export_graph(tmp_path / "p.policy.toml", Module(), message=2, state=2, limit=1.0)
    assert "observation.goal" not in file.read_text()
    outputs = _onnx.Session((tmp_path / "p.onnx").read_bytes()).outputs
    assert outputs == ["action", "message", "state_next"]
    assert str(pathlib.Path(__file__).parent).encode() not in (tmp_path / "p.onnx").read_bytes(), "no folder of this machine"


def test_what_format_2_cannot_hold_becomes_a_graph_where_the_name_permits_it(tmp_path):
    env, gelu = murmurate.VecEnv("passage"), nn.Sequential(nn.Linear(6, 8), nn.GELU())
    with pytest.raises(ValueError, match="encoder: GELU: .*; to write it as a graph of format 3, name the file 'p.policy.toml'"):
        murmurate.export(tmp_path / "p.safetensors", gelu, [], nn.Linear(8, 4), like=env)
    assert murmurate.export(tmp_path / "p", gelu, [], nn.Linear(8, 4), like=env) == tmp_path / "p.policy.toml"
    tanh = nn.Sequential(nn.Linear(6, 8), nn.Tanh())
    assert murmurate.export(tmp_path / "q", tanh, [], nn.Linear(8, 4), like=env) == tmp_path / "q"
    with pytest.raises(ValueError, match="draw: a contract does not say 'sample'"):
        murmurate.export(tmp_path / "r.policy.toml", gelu, [], nn.Linear(8, 4), like=env, draw="sample")
    tanh_normal = {"distribution": "tanh-normal", "deviation": "biased-softplus"}
    file = murmurate.export(tmp_path / "r.policy.toml", gelu, [], nn.Linear(8, 4), like=env, **tanh_normal)
    assert murmurate.sim("passage", file, episodes=1, repeats=1).aborted == 0


def test_a_fixed_number_of_places_and_other_kinds_of_actions_are_written(tmp_path):
    class Fixed(nn.Module):
        def __init__(self):
            super().__init__()
            self.net = nn.Linear(2 + 3 * 2, 2)

        def forward(self, velocity, edges, heard):
            return self.net(torch.cat([velocity, (edges * heard.unsqueeze(2)).flatten(1)], 1))

    given = {"edges": ["relative-position"], "sign": "own-minus-theirs", "max_neighbours": 3, "limit": 1.0}
    with pytest.raises(ValueError, match="step: Fixed: it does not take velocity"):
        murmurate.export_graph(tmp_path / "p.policy.toml", Fixed(), **given)
    file = murmurate.export_graph(tmp_path / "p.policy.toml", Fixed(), pad="max", **given)
    assert murmurate.sim("swap", file, episodes=1, repeats=1).aborted == 0
    kinds = {"acceleration": {"limit": 2.0, "speed_limit": 1.0, "frame": "world"}, "twist": {"limit": 0.5}}
    for action, more in kinds.items():
        murmurate.export_graph(tmp_path / "q.policy.toml", mlp(4), observations=OBSERVED, action=action, **more)
        assert f'kind = "{action}"' in (tmp_path / "q.policy.toml").read_text()


def test_the_first_examples_of_the_page_run(tmp_path, monkeypatch):
    page = (pathlib.Path(__file__).parents[2] / "docs" / "export.md").read_text()
    blocks, names = re.findall(r"```python\n(.*?)```", page, re.DOTALL)[:2], {}
    monkeypatch.chdir(tmp_path)
    for block in blocks:
        exec(block, names)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "gcn.act.onnx", "gcn.encode.onnx", "gcn.policy.toml", "mine.onnx", "mine.policy.toml",
    ]  # fmt: skip


def test_modules_are_in_training_or_evaluation_afterwards_as_they_were(tmp_path):
    module = nn.Sequential(nn.Linear(4, 8), nn.Dropout(0.5), nn.Linear(8, 2))
    module[1].eval()
    before = [part.training for part in module.modules()]
    murmurate.export_graph(tmp_path / "p.policy.toml", module, observations=OBSERVED, limit=1.0)
    assert [part.training for part in module.modules()] == before


def test_without_onnxruntime_the_reference_of_onnx_compares(tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    assert murmurate.export_graph(tmp_path / "p.policy.toml", **MODULES["nn.MultiheadAttention"](), limit=1.0).exists()
    assert _engine.LADDER[0] == _parity.TOLERANCE
