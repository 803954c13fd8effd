"""Write worlds of CoverageControl's benchmark, and what its own controllers reach on them.

The library is asked through its Python binding alone. A folder gets `worlds.json` (parameters, and for each world its Gaussians,
the robots' starts and the results of the three controllers) and for each world `NN.f32` (the density that the library drew: little
endian, row of equal x after row). With `--paths`, also `NN-NAME.f64`: positions at every step, by step, robot and axis.

    python3 -m venv VENV && VENV/bin/pip install coverage-control numpy
    VENV/bin/python tests/peers/coverage/export.py --out DIR --worlds 20 --steps 600
"""

import argparse
import importlib
import json
import pathlib
import sys
import sysconfig
import tempfile
import time
import types

CONTROLLERS = {"clairvoyant": "ClairvoyantCVT", "centralised": "CentralizedCVT", "decentralised": "DecentralizedCVT"}
# The cost is computed at every tenth step, and holds until the next of them.
COST_EVERY = 10


def library():
    """The library's core. The package itself asks for torch, which the core does without."""
    package = types.ModuleType("coverage_control")
    package.__path__ = [sysconfig.get_paths()["purelib"] + "/coverage_control"]
    sys.modules["coverage_control"] = package
    return importlib.import_module("coverage_control._core")


def parameters(core):
    """The parameters of the published benchmark, and the names under which they are written."""
    asked = core.Parameters()
    asked.pTimeStep = 0.2
    asked.pMaxSigma = 60.0
    written = {
        "side_m": asked.pWorldMapSize * asked.pResolution,
        "resolution_m": asked.pResolution,
        "step_s": asked.pTimeStep,
        "speed_m_s": asked.pMaxRobotSpeed,
        "communication_m": asked.pCommunicationRange,
        "local_map_m": asked.pLocalMapSize * asked.pResolution,
        "sensor_m": asked.pSensorSize * asked.pResolution,
        "truncation": asked.pTruncationBND,
    }
    return asked, written


def features(world):
    """Gaussians of a world: centre, standard deviation and peak of each, before the map is scaled to 1."""
    with tempfile.NamedTemporaryFile() as file:
        world.WriteDistributions(file.name)
        words = pathlib.Path(file.name).read_text().replace("CircularBND", " ").split()
    numbers = [float(word) for word in words]
    return [numbers[at : at + 4] for at in range(0, len(numbers), 4)]


def run(core, asked, world, starts, name, steps):
    """One controller on one world: its result, and the positions at every step."""
    system = core.CoverageSystem(asked, world, starts)
    control = getattr(core, CONTROLLERS[name])(asked, system)
    first = system.GetObjectiveValue()
    costs, total, last, taken, converged, controlled_s = [], 0.0, 1.0, 0, False, 0.0
    positions = [[list(place) for place in system.GetRobotPositions()]]
    for step in range(steps):
        before = time.process_time()
        control.ComputeActions()
        refused = system.StepActions(control.GetActions())
        controlled_s += time.process_time() - before
        if refused:
            break
        taken += 1
        positions.append([list(place) for place in system.GetRobotPositions()])
        converged = control.IsConverged()
        if step % COST_EVERY == 0 or converged:
            last = system.GetObjectiveValue() / first
            costs.append(last)
        total += last
        if converged:
            total += last * (steps - 1 - step)
            break
    return {
        "mean": total / steps,
        "final": last,
        "first_cost": first,
        "steps": taken,
        "converged": converged,
        "costs": costs,
        "cpu_s": controlled_s,
    }, positions


def main():
    """Export, world after world; the file of all is written again after each."""
    flags = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    flags.add_argument("--out", type=pathlib.Path, required=True)
    flags.add_argument("--worlds", type=int, default=20)
    flags.add_argument("--steps", type=int, default=600)
    flags.add_argument("--paths", action="store_true")
    flags = flags.parse_args()
    core = library()
    asked, written = parameters(core)
    flags.out.mkdir(parents=True, exist_ok=True)
    worlds = []
    for at in range(flags.worlds):
        drawn = core.CoverageSystem(asked)
        world, starts = drawn.GetWorldIDFObject(), drawn.GetRobotPositions()
        drawn.GetWorldMap().astype("<f4").tofile(flags.out / f"{at:02}.f32")
        entry = {
            "density": f"{at:02}.f32",
            "features": features(world),
            "starts": [list(place) for place in starts],
            "results": {},
        }
        for name in CONTROLLERS:
            began = time.time()
            entry["results"][name], positions = run(core, asked, world, starts, name, flags.steps)
            if flags.paths:
                array(positions).tofile(flags.out / f"{at:02}-{name}.f64")
            result = entry["results"][name]
            print(
                f"{at:02} {name:13} mean {result['mean']:.4f} final {result['final']:.4f} steps {result['steps']}"
                f" cpu {result['cpu_s']:.1f} s, wall {time.time() - began:.1f} s",
                flush=True,
            )
        worlds.append(entry)
        exported = {"parameters": written, "steps": flags.steps, "cost_every": COST_EVERY, "worlds": worlds}
        (flags.out / "worlds.json").write_text(json.dumps(exported))
    for name in CONTROLLERS:
        means = [entry["results"][name]["mean"] for entry in worlds]
        print(f"{name:13} mean of {len(means)} worlds {sum(means) / len(means):.4f}")


def array(positions):
    """Positions as an array of little-endian numbers."""
    import numpy

    return numpy.array(positions, dtype="<f8")


if __name__ == "__main__":
    main()
