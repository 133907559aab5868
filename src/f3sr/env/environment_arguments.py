"""What an environment is asked for, checked where it enters: no word and no type is taken for another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from f3sr.env.gripper import GripperConfig
from f3sr.env.resets import Randomization
from f3sr.errors import InputError

Control = Literal["velocity", "pose"]
Observed = Literal["state", "pictures", "both"]
Reward = Literal["success", "margin"]
LONGEST_EPISODE = 600
"""[s]"""
REAL = "biuf"
"""Kinds of NumPy's real numbers."""
SIZES = (16, 4096)
"""Least and most pixels of a picture's longer side, as of films."""


def require_arguments(
    *,
    goal: Any,
    gripper: Any,
    control: Any,
    observation: Any,
    reward: Any,
    seconds: Any,
    randomization: Any,
    longest: Any,
    render_mode: Any,
) -> None:
    """Raise InputError for the first argument of an environment that it does not know."""
    _require_one_of("control", control, get_args(Control))
    _require_one_of("observation", observation, get_args(Observed))
    _require_one_of("reward", reward, get_args(Reward))
    _require_one_of("render_mode", render_mode, (None, "rgb_array"))
    if not isinstance(goal, str):
        raise InputError("goal", found=repr(goal), accepted="words, as `f3sr goals PACKAGE` lists them")
    if not isinstance(gripper, bool | GripperConfig):
        raise InputError("gripper", found=repr(gripper), accepted="True, False or a GripperConfig")
    if control == "pose" and gripper is False:
        raise InputError("control", found="'pose' without a gripper", accepted="'velocity'")
    if not (randomization is None or isinstance(randomization, Randomization)):
        raise InputError("randomization", found=repr(randomization), accepted="None or a Randomization")
    if not (isinstance(seconds, int | float | np.floating | np.integer) and 0 < seconds <= LONGEST_EPISODE):
        raise InputError("seconds", found=repr(seconds), accepted=f"more than 0, at most {LONGEST_EPISODE}")
    if not (isinstance(longest, int | np.integer) and SIZES[0] <= longest <= SIZES[1]):
        raise InputError("longest", found=repr(longest), accepted="{} to {} pixels".format(*SIZES))


def require_scene(options: Any, drawn: int, scenes: int) -> int:
    """The ``scene`` that the options of a reset name, else the one that was drawn of ``scenes``."""
    if not (options is None or isinstance(options, Mapping)):
        raise InputError("options", found=repr(options), accepted="a mapping; it may hold scene")
    if unknown := [name for name in options or () if name != "scene"]:
        raise InputError("options", found=", ".join(map(repr, unknown)), accepted="scene")
    index = (options or {}).get("scene", drawn)
    if isinstance(index, bool) or not (isinstance(index, int | np.integer) and 0 <= index < scenes):
        raise InputError("options", found=f"scene {index!r}", accepted=f"0 to {scenes - 1}")
    return int(index)


def require_action(action: Any, shape: tuple[int, ...] | None) -> NDArray[np.float64]:
    """An action as numbers; InputError if it has another shape, is not finite, or is complex or text."""
    try:
        given = np.asarray(action)
    except (TypeError, ValueError):  # of several lengths
        given = np.empty(0)
    if given.shape != shape or given.dtype.kind not in REAL or not np.isfinite(given).all():
        raise InputError("action", found=f"{action!r}", accepted=f"finite values of shape {shape}")
    return given.astype(np.float64)


def require_within(name: str, value: Any, span: tuple[float, float], unit: str) -> None:
    """Raise InputError unless an argument is a number of a range."""
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not (is_number and span[0] <= value <= span[1]):
        raise InputError(name, found=repr(value), accepted=f"{span[0]:g} to {span[1]:g} {unit}")


def _require_one_of(name: str, value: Any, known: Sequence[Any]) -> None:
    if not any(value == each for each in known):
        raise InputError(name, found=repr(value), accepted=", ".join(map(repr, known)))
