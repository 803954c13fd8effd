"""The process of a policy in Python, which a host starts: ``python -m murmurate.serve MODULE:CLASS SOCKET
FOLDER MEGABYTES``.

It answers the host's calls on the socket, one after the other. Frames are those of ``crates/onnx/src/frames.rs``.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import importlib
import inspect
import json
import os
import resource
import socket
import struct
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .policy import Inputs, Outputs, is_two

#: Version of the protocol.
PROTOCOL = 2
#: Kinds of frames.
HELLO, CALL, ANSWER, ERROR, RESET = range(5)
#: Roles of calls, by their numbers.
ROLES = ("step", "encode", "act")
#: Length of a frame, number of the call, kind of frame.
_HEAD = struct.Struct("<IIB")
#: Role, number of robots, number of places for neighbours.
_CALL = struct.Struct("<BII")
#: Robot and seed of a reset.
_RESET = struct.Struct("<HQ")
#: Fields of the inputs that are no observations.
_FIELDS = ("messages", "edges", "heard", "own_message", "state", "id")
#: Fields of the outputs by their names on the socket.
_OUTPUTS = {"action": "action", "message": "message", "state_next": "state"}


def _read(stream: socket.socket, count: int) -> bytes:
    """Returns so many bytes; none at the end of the stream."""
    parts = []
    while count:
        part = stream.recv(count)
        if not part:
            return b""
        parts.append(part)
        count -= len(part)
    return b"".join(parts)


def _digest(policy: Any) -> str:
    """Returns a digest of the source of a policy's class; that of its name where there is no source."""
    try:
        source = inspect.getsource(sys.modules[type(policy).__module__])
    except (KeyError, OSError, TypeError):
        source = type(policy).__qualname__
    return hashlib.sha256(source.encode()).hexdigest()


def _why(error: BaseException) -> str:
    """Returns an exception as one line, with the line of the policy that has raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    last = frames[-1] if frames else None
    place = f" ({os.path.basename(last.filename)}, line {last.lineno})" if last else ""
    return f"{type(error).__name__}: {error}{place}".replace("\n", " ")


class _Server:
    """Answers calls for one policy."""

    def __init__(self, make: Callable[[Mapping[str, Any]], Any]) -> None:
        self._make = make
        self._policy: Any = None
        self._calls: dict[str, Any] = {}
        self._called = False

    def hello(self, body: bytes) -> bytes:
        """Makes the policy for the contract of the host, and greets."""
        said = json.loads(body)
        if said["protocol"] != PROTOCOL:
            raise ValueError(f"the host speaks protocol {said['protocol']}, and this package {PROTOCOL}")
        self._policy = self._make(said["contract"])
        self._calls = {call["role"]: call for call in said["calls"]}
        name = type(self._policy).__qualname__
        return json.dumps(
            {"protocol": PROTOCOL, "name": name, "digest": _digest(self._policy), "two": is_two(self._policy)}
        ).encode()

    def reset(self, body: bytes) -> None:
        """Tells the policy that a robot begins an episode."""
        reset = getattr(self._policy, "reset", None)
        if reset is not None:
            robot, seed = _RESET.unpack(body)
            reset(seed, robot)

    def call(self, body: bytes) -> bytes:
        """Runs one call, and checks the shapes of what comes out."""
        role, robots, places = _CALL.unpack_from(body)
        call = self._calls[ROLES[role]]
        floats = np.frombuffer(body, "<f4", offset=_CALL.size).astype(np.float32)
        observation, fields, at = {}, {}, 0
        for port in call["inputs"]:
            shape = [robots, *([places] if port["of_neighbours"] else []), *port["axes"]]
            count = int(np.prod(shape))
            array = floats[at : at + count].reshape(shape)
            at += count
            (fields if port["name"] in _FIELDS else observation)[port["name"]] = array
        inputs = Inputs(observation=observation, **fields)
        outputs = getattr(self._policy, ROLES[role])(inputs)
        if not isinstance(outputs, Outputs):
            raise TypeError(f"'{ROLES[role]}' has returned {type(outputs).__name__}, not murmurate.Outputs")
        answer = b"".join(_bytes(port, outputs, inputs, robots) for port in call["outputs"])
        if not self._called:
            # What was imported and made lives for ever: the collector need not look at it again.
            self._called = True
            gc.collect()
            gc.freeze()
        return answer

    def serve(self, stream: socket.socket) -> None:
        """Answers until the host ends the connection."""
        while True:
            head = _read(stream, _HEAD.size)
            if not head:
                return
            length, number, kind = _HEAD.unpack(head)
            body = _read(stream, length - 5)
            try:
                if kind == RESET:
                    self.reset(body)
                    continue
                kind, said = ANSWER, (self.hello if kind == HELLO else self.call)(body)
            except Exception as error:
                if kind == RESET:
                    print(f"reset: {_why(error)}", file=sys.stderr, flush=True)
                    continue
                kind, said = ERROR, _why(error).encode()
            stream.sendall(_HEAD.pack(len(said) + 5, number, kind) + said)


def _bytes(port: Mapping[str, Any], outputs: Outputs, inputs: Inputs, robots: int) -> bytes:
    """Returns an output as bytes. A state that is left out stays as it is."""
    field = _OUTPUTS[port["name"]]
    value = getattr(outputs, field)
    if value is None and field == "state":
        value = inputs.state
    if value is None:
        raise ValueError(f"the output '{field}' is missing")
    detach = getattr(value, "detach", None)
    array = np.asarray(detach().cpu() if detach is not None else value, dtype="<f4")
    shape = (robots, *port["axes"])
    if array.shape != shape:
        raise ValueError(f"the output '{field}' has the shape {list(array.shape)}, and the contract says {list(shape)}")
    return array.tobytes()


def serve(make: Callable[[Mapping[str, Any]], Any], stream: socket.socket) -> None:
    """Answers the calls of one host on ``stream`` until it ends the connection. ``make`` makes the policy."""
    _Server(make).serve(stream)


def _limit_memory(megabytes: int) -> None:
    """Makes allocations beyond so many megabytes fail, so that a policy that takes too much does not end others.

    On Linux the limit is that of the memory that the process may write; other systems may not have it.
    """
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_DATA, (megabytes << 20, megabytes << 20))


def _end_with_input() -> None:
    sys.stdin.buffer.read()
    os._exit(1)


def main() -> None:
    """Connects to the host's socket, and answers its calls with the class that is named."""
    name, path, folder, megabytes = sys.argv[1:5]
    _limit_memory(int(megabytes))
    sys.path.insert(0, folder)
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise SystemExit(f"'{name}' is no 'module:Class'")
    make = getattr(importlib.import_module(module), attribute, None)
    if make is None:
        raise SystemExit(f"the module '{module}' has no '{attribute}'")
    # A host that is gone has closed the input, also of a policy that is in the middle of a step.
    threading.Thread(target=_end_with_input, daemon=True).start()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as stream:
        stream.connect(path)
        serve(make, stream)


if __name__ == "__main__":
    main()
