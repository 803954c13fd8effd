"""Studies, trainings and sweeps: what they return, what they keep, and what becomes of a process that is killed."""

import contextlib
import filecmp
import os
import pathlib
import signal
import subprocess
import sys
import threading
import time

import pytest
from needs import need

import murmurate
from murmurate._program import finished, words_of
from murmurate._study import _axes

SMALL = {"layouts": 2, "repeats": 2, "ranges_m": [1, 2], "policy": "orca"}
#: A training that takes seconds, most of them for its evaluations.
TINY = {
    "preset": "published",
    "robots": 2,
    "steps": 2000,
    "threads": 1,
    "set": ["ppo.environments=64", "ppo.decisions=8", "ppo.minibatch=128"],
}


def same(one, other):
    """Whether two folders hold the same files with the same bytes."""
    compared = filecmp.dircmp(one, other)
    files = [name for name in compared.common_files if not filecmp.cmp(one / name, other / name, shallow=False)]
    alone = compared.left_only + compared.right_only
    assert not files and not alone, (files, alone)
    return all(same(one / name, other / name) for name in compared.common_dirs)


def test_flags_are_words():
    words = words_of({"delay_ms": 20, "watch": True, "policy": ["a", "b"], "record": None, "quiet": False})
    assert words == ["--delay-ms=20", "--watch", "--policy=a", "--policy=b"]


def test_a_study_in_parts_is_that_of_one_process(tmp_path):
    whole = murmurate.study("range", out=tmp_path / "whole", **SMALL)
    parts = murmurate.study("range", out=tmp_path / "parts", executor="processes", workers=2, **SMALL)
    assert parts.rows == whole.rows and same(tmp_path / "whole", tmp_path / "parts")
    assert whole.columns["name"] == ["1m", "2m", "everyone"] and len(whole.columns["success_rate"]) == 3
    assert murmurate.study("range", executor="processes", workers=1, **SMALL).rows == whole.rows


def test_a_sweep_in_parts_is_that_of_one_process(tmp_path):
    flags = {"axis": {"robots": [2, 3], "loss": [0, 0.5]}, "mode": "onboard-adhoc", "episodes": 2}
    whole = murmurate.study("sweep", out=tmp_path / "whole", **flags)
    parts = murmurate.study("sweep", out=tmp_path / "parts", executor="processes", workers=2, **flags)
    assert parts.rows == whole.rows and same(tmp_path / "whole", tmp_path / "parts")
    assert whole.columns["at"] == [{"robots": robots, "loss": loss} for loss in (0, 0.5) for robots in (2, 3)]


@pytest.mark.parametrize(
    "axis, words",
    [
        ([("robots", [2, 3])], "axis: a list is no dictionary from names to lists of values"),
        ({"robots": [2, None]}, "axis: a value of 'robots' is None"),
        ({"radio": "wifi"}, "axis: 'radio' has 'wifi', which is no list of values"),
        ({"robots": 3}, "axis: 'robots' has 3, which is no list of values"),
    ],
)
def test_wrong_axes_are_refused(axis, words):
    with pytest.raises(ValueError, match=words):
        murmurate.study("sweep", axis=axis)


def test_axes_write_values_as_flags_do():
    assert _axes({"loss": (0, 0.5), "deployment.flag": [True, False]}) == ["loss=0,0.5", "deployment.flag=true,false"]


def test_a_study_on_ray_is_that_of_one_process(tmp_path, monkeypatch):
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    ray = need("ray")
    whole = murmurate.study("range", out=tmp_path / "whole", **SMALL)
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        begun = threading.Thread(target=kill_one_worker)
        begun.start()
        murmurate.study("range", out=tmp_path / "ray", executor="ray", workers=2, **SMALL)
        begun.join()
        options = {**TINY, "seeds": [0, 1], "over": {"ppo.clip": [0.1, 0.2]}, "workers": 2}
        begun = threading.Thread(target=kill_one_worker)
        begun.start()
        swept = murmurate.sweep("passage", out=tmp_path / "swept", executor="ray", **options)
        begun.join()
    finally:
        ray.shutdown()
    alone = murmurate.sweep("passage", out=tmp_path / "alone", **options)
    assert same(tmp_path / "whole", tmp_path / "ray") and [point for point, _ in swept] == [point for point, _ in alone]
    for (_, one), (_, other) in zip(swept, alone):
        assert one.policy.read_bytes() == other.policy.read_bytes()


def kill_one_worker():
    """Kills the first worker of Ray that is seen to run the program."""
    until = time.monotonic() + 60
    while time.monotonic() < until:
        for child in children():
            with contextlib.suppress(OSError):
                os.kill(parent_of(child), signal.SIGKILL)
                return
        time.sleep(0.02)


def children():
    """Process numbers of the programs that run as children of this process or of a worker of Ray."""
    found = []
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if b"murmurate._child" in (process / "cmdline").read_bytes().split(b"\0"):
                found.append(int(process.name))
    return sorted(found)


def parent_of(process):
    """Process number of the parent of a process."""
    stat = pathlib.Path(f"/proc/{process}/stat").read_text(encoding="utf-8")
    return int(stat.rsplit(")", 1)[1].split()[1])


def kill_once_saved(folder):
    """Begins to wait, in a thread that is returned, for a checkpoint in a folder, and then kills one training."""

    def wait():
        until = time.monotonic() + 60
        while not any(folder.rglob("checkpoint.bin")) and time.monotonic() < until:
            time.sleep(0.02)
        for child in children()[:1]:
            os.kill(child, signal.SIGKILL)

    thread = threading.Thread(target=wait)
    thread.start()
    return thread


def test_a_training_goes_on_where_it_was_killed(tmp_path):
    options = {**TINY, "fields": {"ppo.clip": 0.1}, "seed": 5}
    whole = murmurate.train("passage", out=tmp_path / "whole", **options)
    assert whole.decisions == 2048 and len(whole.evaluation) == 2 and len(whole.curve["success"]) == 4
    killed = kill_once_saved(tmp_path / "halves")
    with pytest.raises(ChildProcessError, match="killed by signal 9"):
        murmurate.train("passage", out=tmp_path / "halves", **options)
    killed.join()
    halves = murmurate.train("passage", out=tmp_path / "halves", **options)
    assert halves.policy.read_bytes() == whole.policy.read_bytes()


def test_a_sweep_has_a_folder_for_each_point_and_survives_the_loss_of_a_process(tmp_path):
    options = {**TINY, "seeds": [0, 1], "over": {"ppo.clip": [0.1, 0.2]}}
    plain = murmurate.sweep("passage", out=tmp_path / "plain", workers=2, **options)
    assert [point for point, _ in plain] == [{"ppo.clip": c, "seed": s} for c in (0.1, 0.2) for s in (0, 1)]
    assert (tmp_path / "plain" / "ppo.clip=0.1,seed=0" / "policy.safetensors").exists()
    killed = kill_once_saved(tmp_path / "other")
    other = murmurate.sweep("passage", out=tmp_path / "other", workers=2, **options)
    killed.join()
    weights = [training.policy.read_bytes() for _, training in plain]
    assert [training.policy.read_bytes() for _, training in other] == weights and len(set(weights)) == 4


def test_ctrl_c_saves(tmp_path):
    script = f"import murmurate; murmurate.train('passage', steps=10**9, threads=1, seed=1, out={str(tmp_path)!r})"
    # Where this test itself runs in the background, SIGINT is ignored, and a child would inherit that.
    listens = lambda: signal.signal(signal.SIGINT, signal.default_int_handler)  # noqa: E731
    child = subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.PIPE, text=True, preexec_fn=listens)
    try:
        until = time.monotonic() + 60
        while not (tmp_path / "checkpoint.bin").exists() and time.monotonic() < until:
            time.sleep(0.05)
        first = (tmp_path / "checkpoint.bin").stat().st_mtime_ns
        child.send_signal(signal.SIGINT)
        _, said = child.communicate(timeout=60)
    finally:
        child.kill()
    assert "KeyboardInterrupt" in said and child.returncode != 0
    assert (tmp_path / "checkpoint.bin").stat().st_mtime_ns > first, "saved once more"


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda out: murmurate.study("nothing"), "nothing"),
        (lambda out: murmurate.study("range", ranges_m=-1), "ranges-m"),
        (lambda out: murmurate.study("range", executor="cloud"), "executor: 'cloud'"),
        (lambda out: murmurate.study("network", executor="processes"), "'network' has no parts"),
        (lambda out: murmurate.study("range", executor="processes", workers=0), "workers: 0"),
        (lambda out: murmurate.study("range", executor="ray"), "out: missing"),
        (lambda out: murmurate.train("nowhere", out=out, steps=5), "nowhere"),
        (lambda out: murmurate.train(out=out), "--steps"),
        (lambda out: murmurate.train(out=out, steps=5, fields={"ppo.clap": 1}), "clap"),
        (lambda out: murmurate.train(out=out, steps=5, resume=True), "cannot resume"),
        (lambda out: murmurate.sweep(out=out, steps=5, over={"ppo.clip": ["a/b"]}), "name of a folder"),
        (lambda out: murmurate.sweep(out=out, steps=5, over={"ppo.clip": [-1]}), "clip"),
    ],
)
def test_mistakes_are_named(call, words, tmp_path):
    with pytest.raises(ValueError, match=words):
        call(tmp_path / "out")


@pytest.mark.parametrize("module", ["signal", "json", "random", "numpy", "murmurate", "ctypes"])
def test_a_child_takes_no_module_from_the_current_folder(module, tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / f"{module}.py").write_text("raise SystemExit('a module of the user')")
    script = tmp_path / "run.py"
    out = tmp_path / "out"
    script.write_text(
        "import murmurate\n"
        f"training = murmurate.train(out={str(out)!r}, preset='published', robots=2, steps=500, threads=1,\n"
        "    set=['ppo.environments=16', 'ppo.decisions=8', 'ppo.minibatch=128'])\n"
        "print(training.decisions, murmurate.study('range', layouts=1, repeats=1, ranges_m=[1], policy='orca').study)\n"
    )
    environment = {**os.environ, "RAY_AUTH_MODE": "disabled"}
    environment.pop("PYTHONPATH", None)
    said = subprocess.run([sys.executable, script], cwd=folder, capture_output=True, text=True, timeout=300, env=environment)
    assert said.stdout.split()[-1:] == ["range"] and int(said.stdout.split()[0]) >= 500, said.stderr


def test_the_processes_of_a_launch_take_no_module_from_the_current_folder_either(tmp_path):
    for module in ("signal", "json", "murmurate"):
        (tmp_path / f"{module}.py").write_text("raise SystemExit('a module of the user')")
    team = pathlib.Path(__file__).parents[2] / "teams" / "offboard.toml"
    sets = ["--set", f"team={2000 + os.getpid() % 60_000}", "--set", "episodes=1", "--set", "robots=2"]
    command = [sys.executable, "-P", "-m", "murmurate", "launch", team, *sets, "--json", "--quiet"]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert said.returncode == 0 and '"episodes":1' in said.stdout, said.stderr


def test_a_source_folder_without_the_compiled_module_says_so(tmp_path):
    source = pathlib.Path(murmurate.__file__).parent
    (tmp_path / "murmurate").mkdir()
    for file in source.glob("*.py"):
        (tmp_path / "murmurate" / file.name).write_bytes(file.read_bytes())
    said = subprocess.run([sys.executable, "-c", "import murmurate"], cwd=tmp_path, capture_output=True, text=True)
    words = "is the package's source, without its compiled module; run Python in another folder"
    # Where another package brings a module of its own, that is taken.
    assert words in said.stderr or said.returncode == 0, said.stderr


@pytest.mark.parametrize("file", [pathlib.Path, str])
def test_paths_are_taken_as_texts_are(file, tmp_path):
    config = tmp_path / "mine.toml"
    config.write_text(finished(["train", "passage", "--print-config", "--preset", "published", "--robots", "2"]))
    sets = ["ppo.environments=16", "ppo.decisions=8", "ppo.minibatch=128"]
    training = murmurate.train(out=file(tmp_path / "out"), config=file(config), steps=500, threads=1, set=sets)
    assert murmurate.sim(policy=file(training.policy), robots=2, episodes=1, repeats=1).episodes == 1
    assert murmurate.VecEnv(config=file(config), penalties=1).num_robots == 2
