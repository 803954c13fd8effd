"""The examples and the notebook, in a small form. Each is skipped where what it needs is not installed."""

import functools
import inspect
import json
import pathlib
import sys

import pytest
from needs import need

import murmurate

EXAMPLES = pathlib.Path(__file__).parent.parent / "examples"


@pytest.fixture(autouse=True)
def beside_the_examples(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    yield
    for name in ("ppo", "benchmarl_passage", "four_rooms", "speech"):
        sys.modules.pop(name, None)


@pytest.fixture
def with_torch():
    torch = need("torch")
    need("torch_geometric")
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def test_four_rooms_are_drawn_driven_and_trained_in(tmp_path, monkeypatch, capsys):
    import four_rooms

    source = inspect.getsource(four_rooms.FourRooms).splitlines()
    assert len(source) <= 30, f"{len(source)} lines"
    out = tmp_path / "rooms.html"
    monkeypatch.setattr(sys, "argv", ["four_rooms.py", f"--out={out}", "--episodes=10", "--updates=1"])
    short = functools.partial(four_rooms.mean_reward, steps=10)
    monkeypatch.setattr(four_rooms, "mean_reward", short)
    four_rooms.main()
    said = capsys.readouterr().out
    assert out.read_text().startswith("<!") and "orca: 100% of 10 episodes" in said and "training" in said


@pytest.mark.usefixtures("with_torch")
@pytest.mark.parametrize("conditions", ["perfect", "late"])
def test_a_loop_of_ones_own_trains_and_is_exported(conditions, tmp_path):
    import ppo

    policy, env, curve = ppo.train(decisions=20 * 32 * 16, teams=16, conditions=conditions, say=lambda line: None)
    assert [row[1] for row in curve] == [10 * 32 * 16, 20 * 32 * 16]
    file = ppo.export(tmp_path / "policy.safetensors", policy, env)
    assert murmurate.sim("passage", file, mode="onboard-adhoc", episodes=1, repeats=1).episodes == 1


@pytest.mark.usefixtures("with_torch")
@pytest.mark.parametrize("algorithm, kind", [("ippo", "graph"), ("mappo", "transformer")])
def test_the_experiment_of_benchmarl_trains_and_is_exported(algorithm, kind, tmp_path, monkeypatch):
    need("benchmarl")
    import benchmarl_passage

    monkeypatch.setattr(benchmarl_passage, "TEAMS", 8)
    monkeypatch.setattr(benchmarl_passage, "FRAMES", 64)
    experiment, _ = benchmarl_passage.train(tmp_path, algorithm, kind, frames=256)
    file = murmurate.export(tmp_path / "policy.safetensors", experiment)
    assert murmurate.sim("passage", file, episodes=1, repeats=1).episodes == 1


@pytest.mark.usefixtures("with_torch")
def test_the_notebook_runs_from_top_to_bottom(tmp_path, monkeypatch):
    nbclient, nbformat = need("nbclient"), need("nbformat")
    need("ipykernel")
    need("matplotlib")
    for name, value in (("MINUTES", "0.02"), ("TEAMS", "16"), ("LAYOUTS", "1")):
        monkeypatch.setenv(f"MURMURATE_{name}", value)
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLES), prepend=":")
    notebook = nbformat.read(EXAMPLES / "train_and_run.ipynb", as_version=4)
    # What it writes goes to a folder of the test.
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    pictures = [output for cell in notebook.cells for output in cell.get("outputs", []) if "image/png" in output.get("data", {})]
    assert len(pictures) == 2 and (tmp_path / "policy.safetensors").exists()


@pytest.mark.usefixtures("with_torch")
def test_the_notebook_of_speech_runs_from_top_to_bottom(tmp_path, monkeypatch):
    nbclient, nbformat = need("nbclient"), need("nbformat")
    for package in ("ipykernel", "matplotlib", "vmas"):
        need(package)
    monkeypatch.setenv("MURMURATE_UPDATES", "2")
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLES), prepend=":")
    notebook = nbformat.read(EXAMPLES / "speech.ipynb", as_version=4)
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    pictures = [output for cell in notebook.cells for output in cell.get("outputs", []) if "image/png" in output.get("data", {})]
    assert len(pictures) == 2


@pytest.mark.usefixtures("with_torch")
@pytest.mark.parametrize("task", ["simple_speaker_listener", "simple_reference"])
def test_agents_that_speak_are_trained_and_judged_with_and_without_a_radio(task, tmp_path, monkeypatch):
    need("vmas")
    import speech

    monkeypatch.setattr(speech, "ENVS", 16)
    said = []
    rows = speech.compare(task, range(2), 2, said.append, tmp_path / "rows.json")
    assert len(rows) == 4 and len(said) == 8 and len(json.loads((tmp_path / "rows.json").read_text())) == 4
    with pytest.raises(ValueError, match="seeds: 1 is not 2 to 30"):
        speech.compare(task, range(1), 2)
    assert all(0.1 < row[judge] < 5.0 for row in rows for judge in ("radio", "at once"))
    assert len({row["radio"] for row in rows}) == 4, "no two teams are the same"
