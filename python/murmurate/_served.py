"""A policy object of this process as a policy file: its contract, and a socket on which it answers."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any


def is_object(policy: Any) -> bool:
    """Returns whether a policy is an object of Python, and not a name or a file."""
    return policy is not None and not isinstance(policy, (str, os.PathLike))


def is_factory(policy: Any) -> bool:
    """Returns whether a policy is a factory: called without arguments, it makes a policy object."""
    return callable(policy) and not any(hasattr(policy, name) for name in ("step", "encode"))


@contextlib.contextmanager
def served(policy: Any) -> Iterator[tuple[pathlib.Path, str]]:
    """Serves a policy object, or one of a factory for each job; yields the file by which the program finds it, and its name.

    The attribute ``contract`` of the object is the contract.

    Raises:
        ValueError: It has no contract.
    """
    first = policy() if is_factory(policy) else policy
    made = [first]

    def make() -> Any:
        if not is_factory(policy):
            return policy
        return made.pop() if made else policy()

    contract = getattr(first, "contract", None)
    if not isinstance(contract, Mapping) or isinstance(first, type):
        raise ValueError(
            "policy: the object has no contract: give an object with an attribute 'contract', a dict with the fields of "
            "docs/policy-format-3.md without 'graph', or a function without arguments that returns such objects"
        )
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        address = os.path.join(folder, "policy")
        listener.bind(address)
        listener.listen()
        file = pathlib.Path(folder, "object.policy.toml")
        file.write_text(json.dumps({"format": 3, **contract, "python": f"unix:{address}"}))
        thread = threading.Thread(target=_accept, args=(listener, make), daemon=True)
        thread.start()
        try:
            yield file, str(contract.get("name", ""))
        finally:
            # A thread that waits for a connection ends with the socket.
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)


def _accept(listener: socket.socket, make: Callable[[], Any]) -> None:
    """Answers each connection, which is that of one job, on a thread of its own."""
    while True:
        try:
            stream, _ = listener.accept()
        except OSError:
            return
        threading.Thread(target=_answer, args=(stream, make), daemon=True).start()


def _answer(stream: socket.socket, make: Callable[[], Any]) -> None:
    # Not with the package: it is a program of its own, too.
    from .serve import serve

    with stream, contextlib.suppress(OSError):
        serve(lambda _contract: make(), stream)
