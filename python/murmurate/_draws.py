"""Random numbers of many episodes: each row of an array is drawn from a random stream of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Increment and multipliers of SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014).
_GOLDEN, _FIRST, _SECOND = (np.uint64(number) for number in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))


def _mixed(numbers: NDArray[np.uint64]) -> NDArray[np.uint64]:
    numbers = (numbers ^ (numbers >> np.uint64(30))) * _FIRST
    numbers = (numbers ^ (numbers >> np.uint64(27))) * _SECOND
    return numbers ^ (numbers >> np.uint64(31))


class Draws:
    """Generator of random numbers for n episodes, with methods as those of ``numpy.random.Generator``.

    The first axis of every ``size`` is n, and row i is drawn from the random stream of episode i (SplitMix64): it depends
    neither on n nor on the other episodes. Equal seeds give equal numbers on every machine.
    """

    def __init__(self, seeds: Sequence[int], episodes: Sequence[int]):
        seeds_, episodes_ = (np.array(numbers, np.uint64) for numbers in (seeds, episodes))
        self._keys = _mixed(_mixed(seeds_ + _GOLDEN) + episodes_ * _GOLDEN)
        #: Number of draws from each stream.
        self._drawn = 0

    def _bits(self, size: int | Sequence[int] | None) -> NDArray[np.uint64]:
        """Returns an array of random bits."""
        n = len(self._keys)
        shape = (n,) if size is None else tuple(np.atleast_1d(size).tolist())
        if shape[0] != n:
            raise ValueError(f"size: its first axis is {shape[0]} and not n = {n}: each row is of one episode")
        each = int(np.prod(shape[1:]))
        at = np.arange(self._drawn + 1, self._drawn + each + 1, dtype=np.uint64) * _GOLDEN
        self._drawn += each
        return _mixed(self._keys[:, None] + at).reshape(shape)

    def random(self, size: int | Sequence[int] | None = None) -> NDArray[np.float64]:
        """Returns numbers from 0 to 1, without 1; without a size one for each episode."""
        return (self._bits(size) >> np.uint64(11)) * 2.0**-53

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: int | Sequence[int] | None = None) -> NDArray[np.float64]:
        """Returns numbers from ``low`` to ``high``, which may be arrays that broadcast to ``size``."""
        low, high = np.asarray(low), np.asarray(high)
        return low + (high - low) * self.random(size)

    def integers(self, low: int, high: int | None = None, size: int | Sequence[int] | None = None) -> NDArray[np.int64]:
        """Returns whole numbers from ``low`` to ``high``, without ``high``; with one argument from 0 to it."""
        low, high = (0, low) if high is None else (low, high)
        if high <= low:
            raise ValueError(f"high: {high} is not above {low}")
        return (low + np.floor(self.random(size) * (high - low))).astype(np.int64)

    def permuted(self, x: Any, *, axis: int = 1) -> NDArray[Any]:
        """Returns the array with its entries along ``axis`` shuffled, in each row on its own; its first axis has n rows."""
        x = np.asarray(x)
        if not 0 < axis < x.ndim:
            raise ValueError(f"axis: {axis} is not 1 to {x.ndim - 1}: rows are of one episode each, and stay")
        return np.take_along_axis(x, np.argsort(self.random(x.shape), axis=axis, kind="stable"), axis=axis)

    def orders(self, count: int) -> NDArray[np.int64]:
        """Returns the numbers below ``count`` in an order of its own for each episode (n, count)."""
        return np.argsort(self.random((len(self._keys), count)), axis=1, kind="stable")

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        raise AttributeError(f"rng has no '{name}'; it has random, uniform, integers, permuted and orders")
