"""The environment in which an exported policy was trained: what it observes there, through transforms and wrappers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ._hops import Refused
from ._module import VecEnv

if TYPE_CHECKING:
    from torch import Tensor

#: Wrappers of Gymnasium, PettingZoo and TorchRL that change neither observations nor actions.
HARMLESS = {
    "BaseWrapper", "BaseParallelWrapper", "ClipReward", "DictInfoToList", "NormalizeReward", "NumpyToTorch",
    "OrderEnforcing", "PassiveEnvChecker", "PettingZooWrapper", "RecordEpisodeStatistics", "RecordVideo", "TimeLimit",
    "TransformReward",
}  # fmt: skip
#: Parts of an observation's keys, by their last word.
OBSERVED = ("observation", "position", "velocity")


@dataclasses.dataclass
class Seen:
    """What a policy reads of an environment's observation: ``scale * observation + loc``.

    Attributes:
        scale, loc: Factors and summands (F,).
    """

    scale: Tensor
    loc: Tensor

    @staticmethod
    def raw(floats: int) -> Seen:
        """The observation itself, of so many floats."""
        import torch

        return Seen(torch.ones(floats), torch.zeros(floats))

    @property
    def is_raw(self) -> bool:
        """Whether it is the observation itself."""
        return bool((self.scale == 1).all() and (self.loc == 0).all())

    def of(self, observation: Tensor) -> Tensor:
        """Returns what the policy reads of observations (..., F)."""
        return observation if self.is_raw else self.scale * observation + self.loc


def environment_of(like: Any) -> tuple[VecEnv, list[Any]]:
    """Returns the environment within ``like``, and the transforms of TorchRL around it, from the inside to the outside.

    Raises:
        Refused: There is none, or a wrapper may change what the policy observes or commands.
    """
    given, transforms = like, []
    for _ in range(100):
        if isinstance(like, VecEnv):
            return like, transforms
        # Its own one: wrappers hand attributes of what they wrap through.
        core = vars(like).get("core") if hasattr(like, "__dict__") else None
        if isinstance(core, VecEnv):
            return core, transforms
        kinds = {kind.__name__ for kind in type(like).__mro__}
        if "TransformedEnv" in kinds:
            transforms[:0] = _flat(like.transform)
            like = like.base_env
            continue
        inner = next((vars(like)[name] for name in ("env", "_env", "par_env", "venv") if name in getattr(like, "__dict__", {})), None)
        if inner is None:
            why = f"{type(given).__name__} is neither a VecEnv nor an environment that has one"
            raise Refused("like", None, why + "; give one environment of a batch" * ("BatchedEnvBase" in kinds))
        if type(like).__name__ not in HARMLESS:
            raise Refused("like", like, _put("it may change what the policy observes or commands"))
        like = inner
    raise Refused("like", None, f"{type(given).__name__} has too many wrappers")


def seen_through(transforms: Sequence[Any], core: VecEnv) -> Seen:
    """Returns what a policy reads of the observation behind these transforms.

    Raises:
        Refused: A transform other than ``ObservationNorm`` changes what the policy observes or commands.
    """
    seen = Seen.raw(core.obs.shape[2])
    for transform in transforms:
        if _touches(transform, ("in_keys_inv", "out_keys_inv"), ("action",)):
            raise Refused("like", transform, _put("it changes what the policy commands"))
        if not _touches(transform, ("out_keys",), OBSERVED):
            continue
        keys = [_last(key) for key in transform.out_keys]
        if type(transform).__name__ != "ObservationNorm" or keys != ["observation"] or transform.in_keys != transform.out_keys:
            raise Refused("like", transform, _put("it changes what the policy observes"))
        seen = _normalised(transform, seen, core)
    return seen


def _normalised(transform: Any, seen: Seen, core: VecEnv) -> Seen:
    """Returns what is read behind an ``ObservationNorm``, of what is read before it."""
    import torch

    shape = tuple(core.obs.shape)
    try:
        with torch.no_grad():
            zeros, ones = torch.zeros(shape), torch.ones(shape)
            at, more = (transform._apply_transform(of).detach().cpu().float() for of in (zeros, ones))
    except Exception as error:
        raise Refused("like", transform, f"it cannot be asked what it does: {error}") from None
    scale, loc = more - at, at
    if at.shape != shape or not ((scale == scale[0, 0]).all() and (loc == loc[0, 0]).all()):
        raise Refused("like", transform, "it is another one for each robot; a policy file has one policy for all")
    return Seen(scale[0, 0] * seen.scale, scale[0, 0] * seen.loc + loc[0, 0])


def _flat(transform: Any) -> list[Any]:
    """Returns the transforms of nested compositions."""
    inner = getattr(transform, "transforms", None)
    return [transform] if inner is None else [one for part in inner for one in _flat(part)]


def _touches(transform: Any, lists: Sequence[str], words: Sequence[str]) -> bool:
    """Whether the transform has a key that ends with one of these words in one of these lists."""
    return any(_last(key) in words for name in lists for key in (getattr(transform, name, None) or []))


def _last(key: Any) -> str:
    return key if isinstance(key, str) else str(key[-1])


def _put(why: str) -> str:
    return f"{why}; put that into the first layer of the encoder, and give the environment within"
