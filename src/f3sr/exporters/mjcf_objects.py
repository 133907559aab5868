"""MJCF for users: the whole scene, and every object as a model of its own in the layout of MuJoCo Menagerie.

``scene.xml`` is the package's, with its files in the folders of the objects. ``mug_03/mug_03.xml`` is one body that
stands on z = 0 alone, turned as in the scene, or as little as it takes to stand. ``mug_03/scene.xml`` puts it on a
ground.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np

from f3sr.core.transforms import pose, transform
from f3sr.exporters.exported_scene import ExportedObject, ExportedScene
from f3sr.exporters.mjcf import (
    add_box,
    add_classes,
    add_object,
    add_options,
    named_body,
    to_mjcf,
    visual_files,
)
from f3sr.exporters.mjcf_view import add_keyframe, add_lamp, add_sky, add_view
from f3sr.exporters.obj import part_to_obj
from f3sr.exporters.thumbnail import thumbnail_png
from f3sr.exporters.xml_text import document, numbers

ASSETS = "assets"


class MjcfObjects:
    """The ``Exporter`` of ``scene.xml`` and of a folder per object."""

    name = "mjcf"

    def files(self, exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
        yield (
            "scene.xml",
            to_mjcf(
                exported,
                lambda o, kind, k: f"{o.name}/{ASSETS}/{in_assets(o, kind, k)}",
                lambda world, exported: add_box(world, exported, exported.bounds),
            ),
        )
        for o in exported.objects:
            for path, data in (*visual_files(o, in_assets), *_collision_files(o)):
                yield f"{o.name}/{ASSETS}/{path}", data
            alone = standing_alone(o)
            yield f"{o.name}/{o.name}.xml", _model(alone, exported)
            yield f"{o.name}/scene.xml", _scene(alone, exported)
            yield f"{o.name}/{o.name}.png", thumbnail_png(o.object, exported.scene.camera)


def in_assets(_: ExportedObject, kind: str, k: int) -> str:
    """A file's name in the folder of assets of its object."""
    return f"{kind}_{k:02d}"


def standing_alone(o: ExportedObject) -> ExportedObject:
    """The object above the origin, at rest on the ground: turned from the scene's pose as far as it takes to stand."""
    T = pose(o.standing)
    T[2, 3] = o.margin - min(transform(T, part.vertices)[:, 2].min() for part in o.colliders)
    middle = transform(T, o.bounds.mean(0)[None])[0]
    T[:2, 3] = -middle[:2]
    return replace(o, object=replace(o.object, T_world_object=T))


def _collision_files(o: ExportedObject) -> Iterator[tuple[str, bytes]]:
    for k, part in enumerate(o.colliders):
        yield f"{in_assets(o, 'collision', k)}.obj", part_to_obj(part).encode()


def _model(o: ExportedObject, exported: ExportedScene) -> bytes:
    """The object alone; its files lie in ``assets``."""
    root = ET.Element("mujoco", model=o.name)
    compiler = ET.SubElement(root, "compiler", angle="radian", balanceinertia="true")
    compiler.attrib |= {"meshdir": ASSETS, "texturedir": ASSETS}
    add_options(root, exported.physics)
    add_classes(root, exported.physics, exported.scene.ground.friction)
    asset, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    add_object(asset, world, o, in_assets)
    return document(root)


def _scene(o: ExportedObject, exported: ExportedScene) -> bytes:
    """The object on a ground, seen from the photo's side."""
    root = ET.Element("mujoco", model=f"{o.name} scene")
    ET.SubElement(root, "include", file=f"{o.name}.xml")
    add_view(root, o.object.bounds_world, exported.scene.camera.T_world_camera[:3, 2])
    asset, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    add_sky(asset)
    ET.SubElement(
        asset, "texture", name="ground", type="2d", builtin="checker", mark="edge", width="300", height="300"
    ).attrib |= {"rgb1": numbers([0.75] * 3), "rgb2": numbers([0.7] * 3), "markrgb": numbers([0.85] * 3)}
    size = 1 / float(np.linalg.norm(o.bounds[1] - o.bounds[0]))
    ET.SubElement(
        asset, "material", name="ground", texture="ground", texuniform="true", texrepeat=numbers([size, size])
    )
    add_lamp(world, o.object.bounds_world)
    add_box(world, exported, o.object.bounds_world, material="ground")
    add_keyframe(root, [named_body(o)])
    return document(root)
