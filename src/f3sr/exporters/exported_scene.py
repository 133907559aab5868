"""What every exporter writes: one description of a scene and its objects, so that all formats say the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from f3sr.contact.stable_facets import resting_turn
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array, quaternion_from_rotation
from f3sr.exporters.export_names import export_name
from f3sr.exporters.grown_hulls import grown
from f3sr.exporters.looks import ExportedLook, looks_of
from f3sr.physics.mujoco_model import DEFAULT_PHYSICS, Body, PhysicsConfig, body_of
from f3sr.scene import GROUND, Scene, SceneObject

GROUND_REACH, LEAST_GROUND = 4.0, 4.0
"""Sides of the ground as a multiple of the diagonal of what stands on it, and at least [m]. Engines of single precision
know contacts to some 1e-7 of its size: on 40 m lemons drifted by 2 mm."""
GROUND_DEPTH = 0.1
"""How deep the ground is solid [m]: nothing on it is so fast that it falls through."""


@dataclass(frozen=True, kw_only=True)
class GroundBox:
    """The ground as a box: its middle and its sides, (x, y, z) [m]. docs/exporting.md says who has a plane instead."""

    middle: tuple[float, float, float]
    sides: tuple[float, float, float]


@dataclass(frozen=True, eq=False, kw_only=True)
class ExportedObject:
    """An object in metres, scale baked in: how it looks and what physics needs."""

    object: SceneObject
    name: str
    """What files, prims, links and bodies are called; ``export_names`` states the rule."""
    margin: float = DEFAULT_PHYSICS.margin
    """Contact margin with which the scene was settled [m]."""

    @property
    def id(self) -> int:
        return self.object.id

    @property
    def label(self) -> str:
        """As the package has it: any text."""
        return self.object.label

    @cached_property
    def body(self) -> Body:
        """Mass, centre, inertia, friction and convex parts, in the object frame."""
        return body_of(self.object)

    @cached_property
    def parts(self) -> tuple[ConvexPart, ...]:
        """The body's convex parts, their corners in single precision, as files hold them: a package and what is read of
        it give the same."""
        return tuple(replace(p, vertices=p.vertices.astype(np.float32).astype(float)) for p in self.body.parts)

    @cached_property
    def standing(self) -> Array:
        """R (3, 3) from the object frame to the world, z up, as the object rests alone on level ground.

        It is turned from its pose in the scene, where it may lean, onto the nearest facet of its hull that carries it.
        """
        leaning = self.object.T_world_object[:3, :3]
        hull = ConvexPart.hull_of(np.concatenate([part.vertices for part in self.parts]))
        turn = resting_turn(hull, self.body.center, leaning, max_tilt=np.pi)
        return leaning if turn is None else turn @ leaning

    @cached_property
    def colliders(self) -> tuple[ConvexPart, ...]:
        """Its parts, grown by the margin: what touches in programs that have none."""
        down = -self.standing[2]
        footing = np.array([*down, -max((part.vertices @ down).max() for part in self.parts)])
        return tuple(grown(part, self.margin, footing) for part in self.parts)

    @property
    def looks(self) -> tuple[ExportedLook, ...]:
        """Its visual mesh, one piece per material. It is large and made anew each time, so that a scene's are never
        held together."""
        return looks_of(self.object)

    @cached_property
    def bounds(self) -> Array:
        """Lowest and highest corner (2, 3) of its visual mesh in the object frame [m]."""
        return self.object.scale * self.object.mesh.bounds

    @cached_property
    def principal_inertia(self) -> tuple[Array, Array]:
        """Moments (3,) [kg m2], ascending, and the unit quaternion (4,) wxyz, w >= 0, of the frame of their axes."""
        moments, axes = np.linalg.eigh(self.body.inertia)
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])  # right-handed
        quaternion = quaternion_from_rotation(axes)
        return moments, quaternion if quaternion[0] >= 0 else -quaternion


@dataclass(frozen=True, eq=False, kw_only=True)
class ExportedScene:
    """A scene as exporters get it. ``objects`` are in the order of their ids."""

    scene: Scene
    objects: tuple[ExportedObject, ...]
    physics: PhysicsConfig = DEFAULT_PHYSICS
    background: NDArray[np.uint8] | None = None
    """The photo completed behind its objects (H, W, 3) sRGB, where the package has it."""
    mesh_files: Mapping[int, str] = field(default_factory=dict[int, str])
    """Where the package keeps the mesh of an object, by id."""
    date: str = ""
    """Of the package, as YYYY-MM-DD; formats that want a date of their making state it."""

    @classmethod
    def of(
        cls,
        scene: Scene,
        physics: PhysicsConfig = DEFAULT_PHYSICS,
        *,
        background: NDArray[np.uint8] | None = None,
        mesh_files: Mapping[int, str] | None = None,
        date: str = "",
    ) -> Self:
        """The scene with a name for every object."""
        return cls(
            scene=scene,
            objects=tuple(
                ExportedObject(object=o, name=export_name(o.id, o.label), margin=physics.margin) for o in scene
            ),
            physics=physics,
            background=background,
            mesh_files=mesh_files or {},
            date=date,
        )

    @property
    def ground_height(self) -> float:
        """Height of what touches of the ground [m]: it is grown as the bodies are."""
        return self.physics.margin

    def ground_under(self, bounds: Array) -> GroundBox:
        """The ground around what lies within ``bounds`` (2, 3) [m]."""
        side = max(LEAST_GROUND, GROUND_REACH * float(np.linalg.norm(bounds[1] - bounds[0])))
        x, y, _ = map(float, bounds.mean(0))
        return GroundBox(middle=(x, y, self.ground_height - GROUND_DEPTH / 2), sides=(side, side, GROUND_DEPTH))

    @cached_property
    def names(self) -> Mapping[int, str]:
        """Names by id, the ground included."""
        return {GROUND: "ground", **{o.id: o.name for o in self.objects}}

    @cached_property
    def bounds(self) -> Array:
        """Lowest and highest corner (2, 3) of all objects in the world [m]."""
        corners = np.concatenate([o.object.bounds_world for o in self.objects])
        return np.stack([corners.min(0), corners.max(0)])
