"""Packages that a test needs and the package itself does not."""

import importlib
import os

import pytest


def need(name):
    """Imports a package. Where it is absent the tests are skipped, but with FULL_TESTS (``just full-python``) they fail."""
    if os.environ.get("FULL_TESTS"):
        return importlib.import_module(name)
    return pytest.importorskip(name)
