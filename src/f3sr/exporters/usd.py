"""USD: a SimReady prop per object, and ``scene.usda`` that puts them where the photo shows them.

Props keep to NVIDIA's profile Robotics-Prop 4.0.0: one rigid body with full mass properties, guide hulls for
collision and UsdPreviewSurface. Metres, kilograms, Z up; an object's own frame is its root's. Needs the extra ``usd``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import metadata
from importlib.util import find_spec

from f3sr.backends.model_choice import Need
from f3sr.exporters.exported_scene import ExportedScene
from f3sr.exporters.thumbnail import thumbnail_png
from f3sr.exporters.usd_prop import FOLDER, prop_layer, prop_path, texture_path
from f3sr.exporters.usd_scene import scene_layer, scene_pictures
from f3sr.exporters.usd_variants import variant_files


class Usd:
    """The ``Exporter`` of USD."""

    name = "usd"

    def needs(self) -> Sequence[Need]:
        """OpenUSD, of whatever package."""
        if find_spec("pxr") is None:
            return [Need(what="package usd-core", met=False, found="none", remedy="pip install 'f3sr[usd]'")]
        packages = metadata.packages_distributions().get("pxr", [])
        found = ", ".join(f"{name} {metadata.version(name)}" for name in sorted(set(packages)))
        return [Need(what="package usd-core", met=True, found=found or "pxr of no package")]

    def files(self, exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
        yield "scene.usda", scene_layer(exported)
        yield from scene_pictures(exported)
        for o in exported.objects:
            yield prop_path(o), prop_layer(o, exported)
            for look in o.looks:
                if look.png is not None:
                    yield f"{o.name}/{FOLDER}/{texture_path(look)}", look.png
            yield from ((f"{o.name}/{FOLDER}/{path}", data) for path, data in variant_files(o, exported))
            picture = thumbnail_png(o.object, exported.scene.camera)
            yield f"{o.name}/{FOLDER}/.thumbs/256x256/{o.name}.usda.png", picture
