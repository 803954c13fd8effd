"""Contracts of policies of format 3: what the inputs and outputs of their graphs mean, as TOML."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from ._hops import Refused

#: Inputs of a graph that are no observations.
ROLES = ("messages", "edges", "heard", "own_message", "state", "id")
#: Channels that every team has: number of floats, unit, and whether they are in a frame.
CHANNELS = {
    "position": (2, "m", True),
    "velocity": (2, "m/s", True),
    "goal": (2, "m", True),
    "goal-minus-position": (2, "m", True),
    "heading": (1, "rad", True),
    "yaw-rate": (1, "rad/s", False),
    "filter": (1, "1", False),
    "lag": (1, "s", False),
    "time-in-episode": (1, "s", False),
}
#: Entries of a training's observation that are made of several channels: their sum, or one after the other.
MADE_OF = {
    "position-plus-velocity": [("position", "velocity")],
    "filter-and-lag": [("filter",), ("lag",)],
}
#: Values of fields that are names.
UNITS = ("m", "m/s", "m/s2", "rad", "rad/s", "s", "1")
FRAMES = ("policy", "world", "body")
SIGNS = ("own-minus-theirs", "theirs-minus-own")
KINDS = {"velocity": "m/s", "acceleration": "m/s2", "twist": "m/s", "choice": None}
DISTRIBUTIONS = ("none", "diagonal-normal")
PADS = ("exact", "max")
IDS = ("one-hot", "number")
#: Number of floats of each feature of an edge.
FEATURES = {"relative-position": 2, "relative-velocity": 2, "age": 1, "distance": 1, "bearing": 1}
#: Features that depend on the sign and the frame.
DIRECTED = ("relative-position", "relative-velocity", "bearing")


#: Fields of an observation that a sense has.
OF_SENSE = ("stale_after_s", "if_stale", "miss", "range_m", "from_rad")


@dataclasses.dataclass(frozen=True)
class Input:
    """Observation that a graph takes: an input with a table of its own in the contract."""

    name: str
    source: str
    shape: tuple[int, ...]
    unit: str
    frame: str | None
    sense: tuple[tuple[str, Any], ...] = ()

    @property
    def floats(self) -> int:
        """Number of floats of a robot."""
        return math.prod(self.shape)


@dataclasses.dataclass(frozen=True)
class Observed:
    """Parameter of a module that takes observations.

    Attributes:
        parameter: Its name.
        parts: What it takes, one after the other; each is the sum of some inputs.
    """

    parameter: str
    parts: tuple[tuple[Input, ...], ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of what it takes of a robot: that of its one part, or all floats in one row."""
        return self.parts[0][0].shape if len(self.parts) == 1 else (sum(part[0].floats for part in self.parts),)

    @property
    def inputs(self) -> list[Input]:
        """Inputs of the graph that it needs."""
        return [one for part in self.parts for one in part]


def among(argument: str, value: Any, names: Sequence[str]) -> str:
    """Returns a value that has to be one of these names."""
    if value not in names:
        raise Refused(argument, None, f"{value!r} is none of {', '.join(names)}")
    return str(value)


def whole(argument: str, value: Any, least: int) -> int:
    """Returns a value that has to be a whole number of at least ``least``."""
    if isinstance(value, bool) or not hasattr(value, "__index__") or int(value) < least:
        raise Refused(argument, None, f"{value!r} is no whole number of at least {least}")
    return int(value)


def positive(argument: str, value: Any) -> float:
    """Returns a value that has to be a finite number above zero."""
    try:
        number = math.nan if isinstance(value, (bool, str, bytes)) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (0 < number < math.inf):
        raise Refused(argument, None, f"{value!r} is no number above zero")
    return number


def observed(parameters: Sequence[str], given: Any, fields: Sequence[str], frame: str) -> list[Observed]:
    """Returns what each of these parameters of a module observes.

    Args:
        parameters: Names of the parameters.
        given: The argument ``observations``: a channel, a list of channels, or one of both for each parameter.
        fields: Entries of the environment's observation; empty without one.
        frame: Frame of what has one.
    """
    if isinstance(given, Mapping):
        unknown = [name for name in given if name not in parameters]
        if unknown:
            taken = ", ".join(parameters) or "none"
            raise Refused("observations", None, f"no module has a parameter '{unknown[0]}' (they have {taken})")
        asked = dict(given)
    elif given is not None:
        if len(parameters) != 1:
            taken = ", ".join(parameters) or "none"
            raise Refused("observations", None, f"give one entry for each of the parameters (they are {taken})")
        asked = {parameters[0]: given}
    else:
        asked = {}
    known: dict[str, Input] = {}
    result = []
    for name in parameters:
        entry = asked.get(name)
        if entry is None:
            channel = name.replace("_", "-")
            if channel in CHANNELS or channel in MADE_OF:
                entry = channel
            elif fields:
                entry = list(fields)
            else:
                why = f"what '{name}' takes is missing: it is no channel; give observations={{'{name}': ...}}"
                raise Refused("observations", None, why)
        result.append(_observed(name, entry, frame, known))
    return result


def _observed(name: str, entry: Any, frame: str, known: dict[str, Input]) -> Observed:
    entries = entry if isinstance(entry, (list, tuple)) else [entry]
    if not entries:
        raise Refused("observations", None, f"'{name}' has no channel")
    alone = len(entries) == 1 and entries[0] not in list(MADE_OF)
    parts: list[tuple[Input, ...]] = []
    for one in entries:
        made_of = MADE_OF.get(one) if isinstance(one, str) else None
        for channels in [(one,)] if made_of is None else made_of:
            parts.append(tuple(_input(name if alone else None, name, channel, frame, known) for channel in channels))
    return Observed(name, tuple(parts))


def _input(name: str | None, parameter: str, entry: Any, frame: str, known: dict[str, Input]) -> Input:
    """Returns the input for a channel: a new one, or one that there is already."""
    fields: dict[str, Any] = {"source": entry} if isinstance(entry, str) else dict(entry) if isinstance(entry, Mapping) else {}
    if not fields or not isinstance(fields.setdefault("source", parameter), str):
        raise Refused("observations", None, f"'{parameter}': {entry!r} is neither the name of a channel nor its fields")
    source = fields["source"]
    known_fields = ("source", "shape", "unit", "frame", *OF_SENSE)
    wrong = [field for field in fields if field not in known_fields]
    if wrong:
        why = f"'{parameter}': there is no field '{wrong[0]}', but {', '.join(known_fields)}"
        raise Refused("observations", None, why)
    if source in CHANNELS:
        floats, unit, framed = CHANNELS[source]
        fields = {"shape": [floats], "unit": unit, "frame": frame if framed else None} | fields
    missing = [field for field in ("shape", "unit") if field not in fields]
    if missing:
        built_in = ", ".join(CHANNELS)
        why = (
            f"'{parameter}': '{source}' is none of the channels that every team has ({built_in}); give its shape and unit, "
            "and stale_after_s if it is a sense"
        )
        raise Refused("observations", None, why)
    shape = fields["shape"] if isinstance(fields["shape"], (list, tuple)) else [fields["shape"]]
    sizes = tuple(whole(f"observations: '{parameter}': shape", size, 1) for size in shape)
    among(f"observations: '{parameter}': unit", fields["unit"], UNITS)
    if fields.get("frame") is not None:
        among(f"observations: '{parameter}': frame", fields["frame"], FRAMES)
    of_sense = tuple((field, fields[field]) for field in OF_SENSE if fields.get(field) is not None)
    if of_sense and "stale_after_s" not in dict(of_sense):
        why = f"'{parameter}': '{of_sense[0][0]}' is of a sense, which needs stale_after_s too"
        raise Refused("observations", None, why)
    made = Input(name or source, source, sizes, fields["unit"], fields.get("frame"), of_sense)
    if made.name in ROLES:
        raise Refused("observations", None, f"'{made.name}' is the name of an input that is no observation")
    if known.get(made.name, made) != made:
        made = dataclasses.replace(made, name=f"{parameter}-{source}-{fields.get('frame')}")
    return known.setdefault(made.name, made)


@dataclasses.dataclass
class Contract:
    """Contract of a policy; its fields are those of the file."""

    name: str
    graphs: dict[str, str]
    rate_hz: float
    radius_m: float
    hold_s: float
    max_neighbours: int
    pad: str
    observation: list[Input]
    edges: dict[str, Any] | None
    message: int
    state: int
    after_gap_s: float
    action: dict[str, Any]
    license: str | None = None
    source: str | None = None
    robots: dict[str, Any] | None = None
    message_form: dict[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def edge_floats(self) -> int:
        """Number of floats of an edge."""
        return 0 if self.edges is None else sum(FEATURES[feature] for feature in self.edges["features"])

    @property
    def id_floats(self) -> int:
        """Number of floats of the input ``id``; none if the policy does not tell robots apart."""
        return 0 if self.robots is None else self.robots["most"] if self.robots["id"] == "one-hot" else 1

    @property
    def action_floats(self) -> int:
        """Number of floats of the output ``action``."""
        if self.action["kind"] == "choice":
            return len(self.action["choices"])
        return 4 if self.action["distribution"] == "diagonal-normal" else 2

    def text(self, sha256: str | None) -> str:
        """Returns the file: ``sha256`` is that of the graphs, one after the other, or None to leave it out."""
        head: dict[str, Any] = {"format": 3, "name": self.name, **self.graphs, "sha256": sha256}
        head |= {"license": self.license, "source": self.source, "rate_hz": self.rate_hz, "radius_m": self.radius_m}
        head |= {"hold_s": self.hold_s, "max_neighbours": self.max_neighbours, "pad": self.pad}
        tables: list[tuple[str, dict[str, Any]]] = []
        for one in self.observation:
            source = None if one.source == one.name else one.source
            table = {"source": source, "shape": list(one.shape), "unit": one.unit, "frame": one.frame, **dict(one.sense)}
            tables.append((f"observation.{_key(one.name)}", table))
        if self.edges is not None:
            tables.append(("edges", self.edges))
        if self.robots is not None:
            tables.append(("robots", self.robots))
        if self.message:
            tables.append(("message", {"floats": self.message, **self.message_form}))
        if self.state:
            tables.append(("state", {"floats": self.state, "after_gap_s": self.after_gap_s}))
        tables.append(("action", self.action))
        return _lines(head) + "".join(f"\n[{name}]\n{_lines(table)}" for name, table in tables)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name)


def _lines(table: Mapping[str, Any]) -> str:
    return "".join(f"{_key(name)} = {_value(value)}\n" for name, value in table.items() if value is not None)


def _value(value: Any) -> str:
    """Returns a value as TOML has it. Texts of JSON are texts of TOML."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_value(one) for one in value)}]"
    if isinstance(value, str):
        return json.dumps(value)
    return repr(value)
