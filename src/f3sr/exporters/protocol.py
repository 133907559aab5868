"""The Exporter Protocol: a scene and its physics to files of one format. ``EXPORTERS`` finds exporters by name.

A package holds only the files of those in ``WRITTEN`` (``scene_package/package.py``).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from f3sr.backends.registry import Kind
from f3sr.exporters.exported_scene import ExportedScene


class Exporter(Protocol):
    """Yields files and writes none: the caller writes them into a folder, all or none."""

    @property
    def name(self) -> str:
        """What users call the format: lower case, as in the registry."""
        ...

    def files(self, exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
        """Every file with its path relative to the folder, with ``/``, one at a time: together they may be large.

        World vertices [m] are ``T_world_object @ v`` of the meshes in ``exported.objects``, Z up. Equal scenes give
        equal bytes.
        """
        ...


EXPORTERS = Kind(
    name="exporter",
    protocol=Exporter,
    built_in={
        "glb": "f3sr.exporters.glb:Glb",
        "mjcf": "f3sr.exporters.mjcf_objects:MjcfObjects",
        "robosuite": "f3sr.exporters.robosuite:Robosuite",
        "sdf": "f3sr.exporters.sdf:Sdf",
        "urdf": "f3sr.exporters.urdf:Urdf",
        "usd": "f3sr.exporters.usd:Usd",
    },
)
