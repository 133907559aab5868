"""The Exporter Protocol: a scene and its physics to files of one format. ``EXPORTERS`` finds exporters by name.

A package holds only the files of those in ``WRITTEN`` (``scene_package/package.py``).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from f3sr.backends.registry import Kind
from f3sr.physics.mujoco_model import PhysicsConfig
from f3sr.scene import Scene


class Exporter(Protocol):
    """Yields files and writes none: the caller writes them into a folder, all or none."""

    @property
    def name(self) -> str:
        """What users call the format: lower case, as in the registry."""
        ...

    def files(self, scene: Scene, physics: PhysicsConfig) -> Iterator[tuple[str, bytes]]:
        """Every file with its path relative to the folder, with ``/``, one at a time: together they may be large.

        World vertices [m] are ``T_world_object @ (scale * v)``, Z up. ``physics`` holds the engine's settings;
        ``physics.mujoco_model.body_of`` gives masses, inertias and convex parts.
        """
        ...


EXPORTERS = Kind(
    name="exporter",
    protocol=Exporter,
    built_in={"glb": "f3sr.exporters.glb:Glb", "mjcf": "f3sr.exporters.mjcf:Mjcf"},
)
