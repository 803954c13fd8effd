"""Contracts of format 3, their files and what is refused before a module is exported. Needs neither torch nor ONNX."""

import importlib.util
import json
import pathlib
import shutil

import pytest

import murmurate
from murmurate import _contract, _files, _graph
from murmurate._hops import Refused
from murmurate._program import finished

DATA = pathlib.Path(__file__).parents[2] / "tests" / "onnx" / "data"
FIELDS = ["goal-minus-position", "position-plus-velocity", "filter-and-lag"]


def names(entry):
    return [[one.name for one in part] for part in entry.parts]


def test_a_parameter_is_the_channel_of_its_name_or_what_is_said():
    goal, velocity = _contract.observed(["goal", "velocity"], {"goal": "goal-minus-position"}, [], "policy")
    assert (names(goal), goal.inputs[0].source, goal.shape) == ([["goal"]], "goal-minus-position", (2,))
    assert (names(velocity), velocity.inputs[0].unit, velocity.inputs[0].frame) == ([["velocity"]], "m/s", "policy")
    yaw_rate, lidar = _contract.observed(
        ["yaw_rate", "lidar"], {"lidar": {"source": "scan", "shape": [32], "unit": "m", "frame": "body"}}, [], "world"
    )
    assert (yaw_rate.inputs[0].source, yaw_rate.inputs[0].frame) == ("yaw-rate", None)
    assert (lidar.inputs[0].name, lidar.inputs[0].source, lidar.shape) == ("lidar", "scan", (32,))


def test_an_observation_of_a_training_is_made_of_channels():
    (whole,) = _contract.observed(["x"], None, FIELDS, "policy")
    assert names(whole) == [["goal-minus-position"], ["position", "velocity"], ["filter"], ["lag"]] and whole.shape == (6,)
    # Two parameters share the inputs that are the same.
    first, second = _contract.observed(["x", "y"], {"x": ["position", "velocity"], "y": ["velocity", "lag"]}, [], "policy")
    assert first.inputs[1] is second.inputs[0]
    (body,) = _contract.observed(["x"], ["velocity", {"source": "velocity", "frame": "body"}], [], "policy")
    assert [one.frame for one in body.inputs] == ["policy", "body"] and len({one.name for one in body.inputs}) == 2


@pytest.mark.parametrize(
    "parameters, given, words",
    [
        (["x"], None, "what 'x' takes is missing: it is no channel"),
        (["x"], "nonsense", "'x': 'nonsense' is none of the channels .*; give its shape and unit"),
        (["x"], [], "'x' has no channel"),
        (["x"], 3, "'x': 3 is neither the name of a channel nor its fields"),
        (["x"], {"y": "goal"}, r"no module has a parameter 'y' \(they have x\)"),
        (["x", "y"], ["goal"], r"give one entry for each of the parameters \(they are x, y\)"),
        (["x"], {"x": {"source": "scan", "shape": [3], "unit": "cm"}}, "unit: 'cm' is none of m, m/s"),
        (["x"], {"x": {"source": "scan", "shape": [0], "unit": "m"}}, "shape: 0 is no whole number of at least 1"),
        (["x"], {"x": {"source": "velocity", "frame": "map"}}, "frame: 'map' is none of policy, world, body"),
        (["x"], {"x": {"source": "velocity", "units": "m"}}, "there is no field 'units', but source"),
    ],
)
def test_wrong_observations_are_refused_by_name(parameters, given, words):
    with pytest.raises(Refused, match=f"^observations: .*{words}"):
        _contract.observed(parameters, given, [], "policy")


@pytest.mark.parametrize(
    "edges, sign, words",
    [
        ("age", None, "edges: 'age' is no list"),
        (["mass"], None, "edges: 'mass' is none of relative-position"),
        (["relative-position"], None, "sign: missing: what the module was trained with, of own-minus-theirs and theirs-minus-own"),
        (["age"], "plus", "sign: 'plus' is none of"),
    ],
)
def test_wrong_edges_are_refused_by_name(edges, sign, words):
    with pytest.raises(Refused, match=words):
        _graph._edges(edges, sign, "policy")


ACTION = {"action": "velocity", "limit": 1.0, "speed_limit": None, "choices": (), "distribution": None, "frame": "policy"}


@pytest.mark.parametrize(
    "change, words",
    [
        ({"action": "force"}, "action: 'force' is none of velocity"),
        ({"limit": None}, "limit: missing"),
        ({"limit": -1}, "limit: -1 is no number above zero"),
        ({"limit": "fast"}, "limit: 'fast' is no number above zero"),
        ({"action": "acceleration"}, "speed_limit: missing"),
        ({"action": "choice"}, r"choices: give one velocity \[x, y\]"),
        ({"action": "choice", "choices": [1, 2]}, "choices: give one velocity"),
        ({"distribution": "beta"}, "distribution: 'beta' is none of none, diagonal-normal"),
    ],
)
def test_wrong_actions_are_refused_by_name(change, words):
    with pytest.raises(Refused, match=words):
        _graph._action(ACTION | change, None)


def test_a_contract_is_read_by_the_program_as_it_was_meant(tmp_path):
    shutil.copy(DATA / "recurrent.onnx", tmp_path / "p.onnx")
    goal, velocity = _contract.observed(["goal", "velocity"], {"goal": "goal-minus-position"}, [], "policy")
    edges = _graph._edges(["relative-position", "relative-velocity", "age"], "own-minus-theirs", "policy")
    contract = _contract.Contract(
        name='of "two" \\ words ü', graphs={"graph": "p.onnx"}, rate_hz=20.0, radius_m=2.5, hold_s=0.25, max_neighbours=4, pad="exact",
        observation=[*goal.inputs, *velocity.inputs], edges=edges, message=6, state=12, after_gap_s=1e-1,
        message_form={"name": "a pair", "encoding": "f16"},
        action=_graph._action(ACTION, None), license="MIT", source=None,
    )  # fmt: skip
    file = tmp_path / "p.policy.toml"
    file.write_text(contract.text(None), encoding="utf-8")
    told = json.loads(finished(["policy", "check", str(file), "--json"]))["manifest"]
    assert (told["name"], told["license"], told["hold_s"]) == (contract.name, "MIT", 0.25)
    assert told["state"] == {"floats": 12, "after_gap_s": 0.1} and told["message"]["floats"] == 6
    assert (told["message"]["name"], told["message"]["encoding"]) == ("a pair", "f16")
    assert told["edges"]["sign"] == "own-minus-theirs" and told["observation"]["goal"]["source"] == "goal-minus-position"
    assert "source" not in told["observation"]["velocity"] and told["action"]["limit"] == 1.0
    file.write_text(contract.text("0" * 64), encoding="utf-8")
    with pytest.raises(ValueError, match="SHA-256"):
        finished(["policy", "check", str(file)])


def test_a_policy_of_format_3_runs_in_a_simulation():
    results = murmurate.sim("swap", DATA / "field.policy.toml", episodes=2, repeats=1)
    assert (results.episodes, results.aborted) == (2, 0)


def test_names_of_files_are_checked_and_all_files_are_replaced(tmp_path):
    ends = {"encode": ".encode.onnx", "act": ".act.onnx"}
    for name, words in (("p.toml", "is not NAME.policy.toml"), (".policy.toml", "is not NAME"), ("my own.policy.toml", "'my own' is not"), ("no/p.policy.toml", "no folder")):
        with pytest.raises(ValueError, match=f"^file: .*{words}"):
            _files.paths_of(tmp_path / name, ends)
    with pytest.raises(ValueError, match="^file: a int is no path"):
        _files.paths_of(3, ends)
    paths = _files.paths_of(tmp_path / "p.policy.toml", ends)
    assert {field: path.name for field, path in paths.items()} == {
        "contract": "p.policy.toml", "encode": "p.encode.onnx", "act": "p.act.onnx",
    }  # fmt: skip
    made = {field: tmp_path / f"new-{field}" for field in paths}
    for field, path in made.items():
        path.write_text(field)
    paths["act"].write_text("before")
    _files.replace(made, paths)
    assert {field: path.read_text() for field, path in paths.items()} == {field: field for field in paths}
    assert len(list(tmp_path.iterdir())) == 3


def test_what_an_export_needs_is_named(tmp_path):
    if all(importlib.util.find_spec(name) for name in ("torch", "onnx", "onnxscript")):
        pytest.skip("torch, onnx and onnxscript are here")
    with pytest.raises(ValueError, match="an export to ONNX needs .*: pip install"):
        murmurate.export_graph(tmp_path / "p.policy.toml", object(), limit=1.0)
    with pytest.raises(ValueError, match="^step: missing; give step, or encode and act"):
        murmurate.export_graph(tmp_path / "p.policy.toml")
