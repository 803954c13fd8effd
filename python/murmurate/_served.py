"""A policy object of this process as a policy file: its contract, and a socket on which it answers."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import socket
import tempfile
import threading
from collections.abc import Iterator, Mapping
from typing import Any


def is_object(policy: Any) -> bool:
    """Returns whether a policy is an object of Python, and not a name or a file."""
    return policy is not None and not isinstance(policy, (str, os.PathLike))


@contextlib.contextmanager
def served(policy: Any) -> Iterator[pathlib.Path]:
    """Serves a policy object, and yields the file by which the program finds it. Its attribute ``contract`` is the contract.

    Raises:
        ValueError: It has no contract.
    """
    contract = getattr(policy, "contract", None)
    if not isinstance(contract, Mapping):
        raise ValueError(
            "policy: the object has no contract: give it an attribute 'contract', a dict with the fields of "
            "docs/policy-format-3.md without 'graph'"
        )
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        address = os.path.join(folder, "policy")
        listener.bind(address)
        listener.listen()
        file = pathlib.Path(folder, "object.policy.toml")
        file.write_text(json.dumps({"format": 3, **contract, "python": f"unix:{address}"}))
        thread = threading.Thread(target=_answer, args=(listener, policy), daemon=True)
        thread.start()
        try:
            yield file
        finally:
            # A thread that waits for a connection ends with the socket.
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)


def _answer(listener: socket.socket, policy: Any) -> None:
    # Not with the package: it is a program of its own, too.
    from .serve import serve

    while True:
        try:
            stream, _ = listener.accept()
        except OSError:
            return
        with stream, contextlib.suppress(OSError):
            serve(lambda _contract: policy, stream)
