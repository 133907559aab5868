"""GLB: the whole scene as one binary glTF, Y up, metres. A node per object has its id and label in the extras."""

from __future__ import annotations

from collections.abc import Iterator

from f3sr.exporters.exported_scene import ExportedScene
from f3sr.io.gltf_writer import scene_to_glb


class Glb:
    """The ``Exporter`` of ``scene.glb``. It holds no physics."""

    name = "glb"

    def files(self, exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
        yield "scene.glb", scene_to_glb(exported.scene.objects)
