"""Where episodes start: scenes at rest that the photo may show, with materials that vary from reset to reset."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Interval

from f3sr.errors import InputError, require_path
from f3sr.files.bounds import MAX_OBJECTS
from f3sr.scene import Scene
from f3sr.scene_package.package import Package, read_package
from f3sr.settings import settings

Share = Annotated[float, Interval(ge=0, le=0.9)]


@settings
class Randomization:
    """What differs from reset to reset, besides the scene that is drawn from the bank. 0 keeps a value."""

    mass: Share = 0.0
    """Of every object: times a factor between 1 - share and 1 / (1 - share), even in its logarithm."""
    friction: Share = 0.0
    """Of every object and the ground, sliding and rolling alike: likewise."""
    light: Annotated[float, Interval(ge=0, le=1.6)] = 0.0
    """Angle by which pictures' light is turned about any axis, at most [rad]."""
    camera: Annotated[float, Interval(ge=0, le=0.5)] = 0.0
    """Distance by which pictures' camera moves sideways and up, at most [share of its distance to the scene]."""


@dataclass(frozen=True, kw_only=True)
class ResetDraw:
    """What one reset drew: the index of the scene in the bank, and factors by object; the ground's friction is last."""

    scene: int
    mass: tuple[float, ...]
    friction: tuple[float, ...]


def draw(rng: np.random.Generator, scenes: int, objects: int, config: Randomization) -> ResetDraw:
    """Equal generators, equal draws."""
    return ResetDraw(
        scene=int(rng.integers(scenes)),
        mass=_factors(rng, objects, config.mass),
        friction=_factors(rng, objects + 1, config.friction),
    )


def _factors(rng: np.random.Generator, count: int, share: float) -> tuple[float, ...]:
    most = -np.log1p(-share)
    return tuple(np.exp(rng.uniform(-most, most, count)).tolist())


def bank_of(package: Package, samples: str | Path | None) -> tuple[Scene, ...]:
    """The scene of a package, and those of a folder of samples that `f3sr sample` wrote of it.

    Raises InputError for a folder without packages or with more than ``MAX_BANK``, and for samples of another scene."""
    if samples is None:
        return (package.scene,)
    folder = require_path("samples", samples)
    found = sorted(f.parent for f in folder.glob("*/scene.json")) if folder.is_dir() else []
    if not found:
        raise InputError(folder, found="no package in it", accepted="a folder that `f3sr sample PACKAGE -o` wrote")
    if len(found) > MAX_BANK:
        raise InputError(folder, found=f"{len(found)} samples", accepted=f"at most {MAX_BANK}: each has its own model")
    scenes = [read_package(f).scene for f in found]
    wanted = [(o.id, o.label) for o in package.scene]
    for f, scene in zip(found, scenes, strict=True):
        if [(o.id, o.label) for o in scene] != wanted:
            raise InputError(f, found="other objects than the package's", accepted=f"samples of {package.folder}")
    return (package.scene, *(_of_package(package.scene, scene) for scene in scenes))


MAX_BANK = MAX_OBJECTS
"""Scenes of a bank at most: each has a model of its own in memory."""


def _of_package(own: Scene, sample: Scene) -> Scene:
    """The package's scene with the poses and shapes of a sample: pictures and the photo stay the package's."""
    return replace(own, objects=sample.objects, ground=sample.ground)
