"""What sections of the page share: the result, its sizes, and pictures that are drawn once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from f3sr.metrics.measures import Details, ObjectMeasures
from f3sr.pipeline import Reconstruction
from f3sr.scene import Scene
from f3sr.stages.evaluate import direct_composition
from f3sr.vision.pictures import Backdrop, Image, overlay

SAME = 1e-9
"""Two poses in a camera whose entries differ by less [m] give the same picture."""


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """How large the heavy parts of a page may be."""

    picture: int
    """Longest side of pictures [px]."""
    panels: int
    """Pixels of all single objects' panels together, as if they were square."""
    faces: int
    """Triangles of all meshes in the 3-D view together."""
    texture: int
    """Longest side of textures in the 3-D view [px]."""


@dataclass(frozen=True, eq=False)
class PageData:
    """A result, and what several sections draw from it."""

    result: Reconstruction
    sizes: Sizes

    @property
    def scene(self) -> Scene:
        """Ours."""
        return self.result.scene

    @property
    def given(self) -> Scene:
        """The input as it came."""
        return next(iter(self.result.scenes.values()), self.result.direct)

    @cached_property
    def direct(self) -> Scene:
        """Direct composition, exactly as it is measured."""
        return direct_composition(self.result.direct, self.scene)

    @cached_property
    def backdrop(self) -> Backdrop:
        return Backdrop.of(self.scene, self.sizes.picture)

    @property
    def details(self) -> Details | None:
        return self.result.evaluation.result_details if self.result.evaluation else None

    @property
    def direct_details(self) -> Details | None:
        return self.result.evaluation.direct_details if self.result.evaluation else None

    def overlay(self, scene: Scene) -> Image:
        """Masks against the render; scenes that look alike share one drawing."""
        drawn = next((picture for other, picture in self._overlays if look_alike(other, scene)), None)
        if drawn is None:
            drawn = overlay(scene, self.backdrop)
            self._overlays.append((scene, drawn))
        return drawn

    @cached_property
    def _overlays(self) -> list[tuple[Scene, Image]]:
        return []


@dataclass(frozen=True, eq=False, kw_only=True)
class View:
    """A picture on the page; ``note`` follows its title in the caption."""

    picture: Image
    title: str
    alt: str = ""
    note: str = ""


def look_alike(a: Scene, b: Scene) -> bool:
    """Whether both scenes give the same picture in their own cameras: same intrinsics, same poses in camera axes."""
    if a is b:
        return True
    pairs = zip(a.objects, b.objects, strict=True)
    return np.array_equal(a.camera.K, b.camera.K) and all(
        p.mesh is q.mesh
        and np.abs(a.camera.T_camera_world @ p.T_world_asset - b.camera.T_camera_world @ q.T_world_asset).max() < SAME
        for p, q in pairs
    )


def by_id(details: Details | None) -> Mapping[int, ObjectMeasures]:
    return {o.id: o for o in details.objects} if details else {}
