"""Export of any PyTorch module to a policy of format 3: an ONNX graph, or two, and a contract."""

from __future__ import annotations

import hashlib
import json
import math
import os
import pathlib
import tempfile
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from ._contract import (
    DIRECTED,
    DISTRIBUTIONS,
    FEATURES,
    FRAMES,
    IDS,
    KINDS,
    PADS,
    ROLES,
    SIGNS,
    Contract,
    Observed,
    among,
    observed,
    positive,
    whole,
)
from ._files import CONTRACT, paths_of, replace
from ._hops import Refused, checked, evaluated
from ._like import Seen, environment_of, seen_through
from ._program import finished

if TYPE_CHECKING:
    from torch import nn

    from ._module import VecEnv

#: Ends of the graphs' names by the graphs' roles, and their fields in a contract.
ENDS = {"step": ".onnx", "encode": ".encode.onnx", "act": ".act.onnx"}
FIELDS = {"step": "graph", "encode": "encode", "act": "act"}
#: Communication radius without an environment [m].
RADIUS_M = 2.0


def export_graph(
    file: str | os.PathLike[str],
    step: nn.Module | None = None,
    *,
    encode: nn.Module | None = None,
    act: nn.Module | None = None,
    like: Any = None,
    observations: Any = None,
    normalize: Any = None,
    stack: int = 1,
    stack_start: Literal["zeros", "first"] = "zeros",
    edges: Sequence[str] = (),
    sign: Literal["own-minus-theirs", "theirs-minus-own"] | None = None,
    message: int | None = None,
    message_name: str | None = None,
    encoding: Literal["f32", "f16", "bf16", "int8"] | None = None,
    missing: Literal["whole", "last", "zero"] | None = None,
    state: int | None = None,
    action: Literal["velocity", "acceleration", "twist", "choice"] = "velocity",
    limit: float | None = None,
    speed_limit: float | None = None,
    choices: Sequence[Sequence[float]] = (),
    distribution: Literal["none", "diagonal-normal"] | None = None,
    frame: Literal["policy", "world", "body"] = "policy",
    rate_hz: float = 20.0,
    radius_m: float | None = None,
    hold_s: float | None = None,
    max_neighbours: int | None = None,
    pad: Literal["exact", "max"] = "exact",
    after_gap_s: float | None = None,
    id: Literal["one-hot", "number"] | None = None,
    robots: int | None = None,
    name: str | None = None,
    license: str | None = None,
    source: str | None = None,
) -> pathlib.Path:
    """Writes a policy of format 3 from PyTorch modules: a contract NAME.policy.toml, and NAME.onnx beside it.

    Either one module computes a whole step, and its message is heard in the next one; or ``encode`` makes the message and
    ``act`` the action, after the messages of the same step are heard. They are called with keyword arguments: **the names of the
    parameters of forward say what a module takes**. ``messages`` [R, K, M], ``edges`` [R, K, E], ``heard`` [R, K],
    ``own_message`` [R, M], ``state`` [R, S] and ``id`` [R, N] are these inputs of a graph; every other parameter is an observation [R, ...].
    A module returns a tensor, a tuple in the order action, message, state_next of those that it has, or a dictionary.

    Before a file is written or replaced, the program loads the policy and makes its own checks, and the graphs answer as the
    modules within 1e-5, over 64 steps with state, messages, and 0 to ``max_neighbours`` neighbours.

    Args:
        file: Contract to write, or to replace: NAME.policy.toml.
        step: Module of a whole step.
        encode: Module of the message, in place of ``step``.
        act: Module of the action, in place of ``step``.
        like: Environment in which the policy was trained, a :class:`murmurate.VecEnv` or one of the faces. A parameter that is no
            channel takes its whole observation; radius, hold time and limit are its own.
        observations: What parameters observe: by their names, or for the only one: a channel such as "goal-minus-position", a list
            of channels that are put one after the other, or a dictionary with ``source``, ``shape``, ``unit`` and ``frame``, and
            of a sense, such as a lidar, also ``stale_after_s``, ``if_stale``, ``miss``, ``range_m`` and ``from_rad``. A
            parameter without an entry is the channel of its name, with "_" for "-".
        normalize: (mean, standard deviation) or (mean, standard deviation, limit) of what a parameter observes, by its
            name, or for the only one. The graph then takes what is not normalised.
        stack: Number of frames of each observation that the module gets in one row, the oldest first. The state keeps them.
        stack_start: What stands for frames before the first: zeros, or copies of the first.
        edges: Features of an edge, in the module's order: "relative-position" [m], "relative-velocity" [m/s], "age" [s], "distance"
            [m], "bearing" [rad].
        sign: Sign of relative positions and velocities; without a default.
        message: Number of floats of a message; of ``encode`` it is found by running it.
        message_name: Name of what the floats mean, which policies of other roles that understand them share.
        encoding: Encoding to which the floats are rounded before they are sent; None takes "f32".
        missing: Use of a message of which parts get lost, if it travels in parts; None takes "whole".
        state: Number of floats of the state; None takes the attribute ``state_floats`` of the module, else none.
        action: Kind of action; a "choice" is the largest output.
        limit: Largest value along each axis [m/s], for accelerations [m/s²]; None takes that of ``like``.
        speed_limit: Largest speed along each axis [m/s]; needed for accelerations.
        choices: Velocities [x, y] of a choice [m/s], one for each output.
        distribution: What the outputs are: the action, or means and then log standard deviations; None takes what their number
            says, 2 or 4.
        frame: Frame of observations, edges and actions; that of a twist is "body".
        rate_hz: Steps per second.
        radius_m: Communication radius [m]; None takes that of ``like``, else 2.
        hold_s: Longest time for which a message is used [s]; None takes that of ``like``, else 0.2, or four steps if that is longer.
        max_neighbours: Largest number of neighbours; None takes all others of the team of ``like``, else 8.
        pad: "max" for modules that need always ``max_neighbours`` places.
        after_gap_s: Longest pause after which the state still holds [s]; None takes 0.5, or two steps.
        id: Form of the robot's place in its team, the input ``id``: "one-hot" with ``robots`` floats, or a "number" from 0 on.
        robots: Number of robots of the largest team; needed for "one-hot". A larger team is refused.
        name, license, source: For people; None takes NAME for the first.

    Each module is in training or evaluation afterwards as it was before.

    Raises:
        ValueError: An argument is wrong, by name; a module cannot be exported; the program refuses the policy, such as one that
            is not finite without a neighbour; or module and graph differ, by name of the tensor. No file is changed then.
    """
    roles: dict[str, Any] = {"step": step} if encode is None and act is None else {"encode": encode, "act": act}
    paths = paths_of(file, {FIELDS[role]: ENDS[role] for role in roles})
    # The arguments by their names.
    given = dict(locals())
    try:
        if step is not None and len(roles) == 2:
            raise Refused("step", None, "one module makes a whole step; leave out 'encode' and 'act', or it")
        for role, module in roles.items():
            if module is None:
                raise Refused(role, None, "missing; give step, or encode and act")
        from ._onnx import check_packages

        check_packages()
        # A module that was compiled is exported as it was before.
        modules = {role: checked(getattr(module, "_orig_mod", module), role) for role, module in roles.items()}
        with evaluated(list(modules.values())):
            contract, ready = _contract(modules, given, {FIELDS[role]: paths[FIELDS[role]].name for role in roles})
            _write(paths, contract, ready)
    except Refused as refused:
        raise ValueError(str(refused)) from None
    return paths["contract"]


def _contract(modules: dict[str, nn.Module], given: dict[str, Any], graphs: dict[str, str]) -> tuple[Contract, dict[str, Any]]:
    """Returns the contract of modules with these arguments, and the modules with the inputs and outputs of graphs."""
    from ._wrapped import Stack, Wrapped, parameters_of

    core, seen = None, None
    if given["like"] is not None:
        core, transforms = environment_of(given["like"])
        seen = seen_through(transforms, core)
    frame = among("frame", given["frame"], FRAMES)
    needed = {role: parameters_of(module, role)[0] for role, module in modules.items()}
    own = {role: [name for name in names if name not in ROLES] for role, names in needed.items()}
    parameters = list(dict.fromkeys(name for names in own.values() for name in names))
    fields = [] if core is None else list(core.observation_fields)
    takes = observed(parameters, given["observations"], fields, frame)
    of_parameter = dict(zip(parameters, takes))

    stack = Stack(whole("stack", given["stack"], 1), among("stack_start", given["stack_start"], ("zeros", "first")) == "first")
    if stack.frames > 1 and len(modules) == 2:
        raise Refused("stack", None, "frames are stacked for 'step' alone; keep them in the state of 'encode' and 'act'")
    state = given["state"]
    if state is None:
        state = max(getattr(module, "state_floats", 0) for module in modules.values())
    state = whole("state", state, 0) + stack.floats(takes)
    message = given["message"]
    if message is None:
        message = max(getattr(module, "message_floats", 0) for module in modules.values())
    contract = _without_modules(given, core, graphs)
    contract.observation = list({one.name: one for each in takes for one in each.inputs}.values())
    contract.message, contract.state = whole("message", message, 0), state
    told = {"name": given["message_name"], "encoding": given["encoding"], "missing": given["missing"]}
    contract.message_form = {field: said for field, said in told.items() if said is not None}
    norms = _norms(given["normalize"], takes, frame, core, seen)

    ready: dict[str, Any] = {}
    for role, module in modules.items():
        some = [of_parameter[name] for name in own[role]]
        made = Wrapped(module, role, contract, some, {name: norms[name] for name in own[role] if name in norms}, stack)
        ready[role] = made
        if role == "encode":
            if contract.message not in (0, made.floats["message"]):
                raise Refused("message", None, f"{contract.message} floats, and encode makes {made.floats['message']}")
            contract.message = made.floats["message"]
        _check_outputs(made, contract, given["distribution"])
    return contract, ready


def _check_outputs(made: Any, contract: Contract, distribution: str | None) -> None:
    """Checks the widths of the outputs of a module, of which the distribution follows where it is not given."""
    floats = made.floats.get("action")
    if floats is not None:
        if distribution is None and contract.action["kind"] != "choice":
            contract.action["distribution"] = "diagonal-normal" if floats == 4 else "none"
        if floats != contract.action_floats:
            what = contract.action["kind"] if contract.action["kind"] == "choice" else contract.action["distribution"]
            raise Refused(made.role, made.module, f"its action has {floats} floats; {contract.action_floats} are expected ({what})")
    for name, expected in (("message", contract.message), ("state_next", contract.state)):
        if made.floats.get(name, expected) != expected:
            raise Refused(made.role, made.module, f"its '{name}' has {made.floats[name]} floats; {expected} are expected")


def _without_modules(given: dict[str, Any], core: VecEnv | None, graphs: dict[str, str]) -> Contract:
    """Returns the contract of these arguments, as far as they say it without the modules."""
    rate_hz = positive("rate_hz", given["rate_hz"])
    of_env = lambda field, other: other if core is None else round(getattr(core, field), 6)
    default = lambda field, other: positive(field, other if given[field] is None else given[field])
    neighbours = given["max_neighbours"]
    if neighbours is None:
        neighbours = 8 if core is None else min(64, max(1, core.num_robots - 1))
    name = given["name"]
    return Contract(
        name=pathlib.Path(given["paths"]["contract"]).name.removesuffix(CONTRACT) if name is None else str(name),
        graphs=graphs,
        rate_hz=rate_hz,
        radius_m=default("radius_m", of_env("radius_m", RADIUS_M)),
        hold_s=default("hold_s", of_env("hold_s", max(0.2, 4.0 / rate_hz))),
        max_neighbours=whole("max_neighbours", neighbours, 1),
        pad=among("pad", given["pad"], PADS),
        observation=[],
        edges=_edges(given["edges"], given["sign"], given["frame"]),
        message=0,
        state=0,
        after_gap_s=default("after_gap_s", max(0.5, 2.0 / rate_hz)),
        action=_action(given, of_env("limit_m_s", None)),
        license=given["license"],
        source=given["source"],
        robots=_robots(given["id"], given["robots"]),
    )


def _robots(form: str | None, most: int | None) -> dict[str, Any] | None:
    """Returns the table of the robots of a team, if the policy tells them apart."""
    if form is None:
        if most is not None:
            raise Refused("robots", None, "it is for policies that tell robots apart; give id='one-hot' or id='number'")
        return None
    if most is None and among("id", form, IDS) == "one-hot":
        raise Refused("robots", None, "missing: the number of robots of the largest team, which is the size of 'id'")
    return {"id": among("id", form, IDS)} | ({} if most is None else {"most": whole("robots", most, 1)})


def _edges(features: Any, sign: str | None, frame: str) -> dict[str, Any] | None:
    if isinstance(features, str) or not isinstance(features, Sequence):
        raise Refused("edges", None, f"{features!r} is no list; give one, such as ['relative-position', 'age']")
    if not features:
        return None
    for feature in features:
        among("edges", feature, list(FEATURES))
    if sign is None and any(feature in DIRECTED for feature in features):
        raise Refused("sign", None, f"missing: what the module was trained with, of {' and '.join(SIGNS)}")
    sign = among("sign", "theirs-minus-own" if sign is None else sign, SIGNS)
    return {"features": list(features), "sign": sign, "frame": frame}


def _action(given: dict[str, Any], limit: float | None) -> dict[str, Any]:
    """Returns the table of the action."""
    kind = among("action", given["action"], list(KINDS))
    frame = "body" if kind == "twist" else given["frame"]
    speed_limit = None if given["speed_limit"] is None else positive("speed_limit", given["speed_limit"])
    if kind == "choice":
        try:
            choices = [[float(axis) for axis in one] for one in given["choices"]]
        except (TypeError, ValueError):
            choices = []
        if not choices or any(len(one) != 2 for one in choices):
            raise Refused("choices", None, "give one velocity [x, y] in m/s for each output")
        return {"kind": kind, "frame": frame, "speed_limit": speed_limit, "choices": choices, "distribution": "none"}
    if given["limit"] is not None:
        limit = positive("limit", given["limit"])
    if limit is None or (kind == "acceleration" and given["limit"] is None):
        raise Refused("limit", None, "missing: the largest value along each axis [m/s], for accelerations [m/s²]")
    if kind == "acceleration" and speed_limit is None:
        raise Refused("speed_limit", None, "missing: the largest speed along each axis [m/s]")
    distribution = among("distribution", given["distribution"] or "none", DISTRIBUTIONS)
    table = {"kind": kind, "unit": KINDS[kind], "frame": frame, "limit": limit, "speed_limit": speed_limit}
    return table | {"distribution": distribution}


def _norms(given: Any, takes: Sequence[Observed], frame: str, core: VecEnv | None, seen: Seen | None) -> dict[str, Any]:
    """Returns the normalisation of each parameter that has one: the argument's own, or that around the environment."""
    from ._wrapped import Affine, norm_of

    parameters = {each.parameter: each for each in takes}
    if given is not None and not isinstance(given, Mapping):
        if len(parameters) != 1:
            raise Refused("normalize", None, f"give one entry for each of the parameters {', '.join(parameters)}")
        given = {next(iter(parameters)): given}
    norms: dict[str, Any] = {}
    for name, entry in (given or {}).items():
        if name not in parameters:
            raise Refused("normalize", None, f"no module observes '{name}' (they observe {', '.join(parameters)})")
        norms[name] = norm_of("normalize", entry, math.prod(parameters[name].shape))
    if core is not None and seen is not None and not seen.is_raw:
        fields = list(core.observation_fields)
        for each in takes:
            if each.parameter in norms:
                continue
            if each != observed([each.parameter], fields, fields, frame)[0]:
                why = f"its ObservationNorm is of the whole observation, and '{each.parameter}' takes another; give normalize="
                raise Refused("like", None, why)
            norms[each.parameter] = Affine(0.0 * seen.scale, seen.scale, seen.loc)
    return norms


def _write(paths: dict[str, pathlib.Path], contract: Contract, ready: dict[str, Any]) -> None:
    """Writes graphs and contract, if the program takes them and they answer as the modules do."""
    from ._engine import differing
    from ._onnx import graph_of, inputs_of
    from ._parity import TOLERANCE, compare
    from ._wrapped import axes, example

    data = {
        role: graph_of(made, role, example(made.inputs, contract), axes(made.inputs, contract))
        for role, made in ready.items()
    }
    # What a module takes and does not use is no input of its graph.
    used = {name for graph in data.values() for name in inputs_of(graph)}
    contract.observation = [one for one in contract.observation if one.name in used]
    _, samples = compare(ready, data, contract)
    with tempfile.TemporaryDirectory(dir=paths["contract"].absolute().parent) as folder:
        made = {field: pathlib.Path(folder) / path.name for field, path in paths.items()}
        digest = hashlib.sha256()
        for role, graph in data.items():
            made[FIELDS[role]].write_bytes(graph)
            digest.update(graph)
        made["contract"].write_text(contract.text(digest.hexdigest()), encoding="utf-8")
        try:
            json.loads(finished(["policy", "check", str(made["contract"]), "--json"]))
        except ValueError as error:
            # The file that the program has read is gone when the error is read.
            raise ValueError(str(error).replace(str(made["contract"]), str(paths["contract"]))) from None
        differs = differing(data, samples, TOLERANCE)
        if differs is not None:
            sample, output, over = differs
            why = f"{sample.said} its output '{output}' differs by more than {over:.0e} between PyTorch and the program"
            raise Refused(sample.role, ready[sample.role].module, why)
        replace(made, paths)
