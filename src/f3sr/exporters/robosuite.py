"""Objects for robosuite and robocasa: a folder each with a MJCF file that their object classes read.

The body's frame is the middle of the object's box, and z = up where it rests alone, so samplers that turn it about z
keep it at rest. Its convex parts are geoms of group 0, what is seen of group 1. ``bottom_site``, ``top_site`` and
``horizontal_radius_site`` tell robosuite its size, the region ``reg_bbox`` tells robocasa. It has no joint: both add
one. Metres, Z up; mass and inertia are explicit.
"""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree import ElementTree as ET

import numpy as np

from f3sr.core.transforms import Array, pose, quaternion_from_rotation, transform
from f3sr.exporters.exported_scene import ExportedObject, ExportedScene
from f3sr.exporters.mjcf import add_look, visual_files
from f3sr.exporters.obj import part_to_obj
from f3sr.exporters.thumbnail import thumbnail_png
from f3sr.exporters.xml_text import document, numbers
from f3sr.physics.mujoco_model import CONDIM, SOLIMP, PhysicsConfig, part_name

ASSETS = "assets"
MODEL = "model.xml"
"""As robocasa names it."""
COLLISION, VISUAL = "0", "1"
"""Groups by which both tell what touches from what is seen."""


class Robosuite:
    """The ``Exporter`` of ``red_mug_03/model.xml``, what it names, and a picture."""

    name = "robosuite"
    folder = "robosuite_objects"
    """Not the name alone: robosuite takes paths with a folder ``robosuite`` for those of its own files."""

    def files(self, exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
        for o in exported.objects:
            for path, data in visual_files(o, _in_assets):
                yield f"{o.name}/{path}", data
            for k, part in enumerate(o.body.parts):
                yield f"{o.name}/{_in_assets(o, 'collision', k)}.obj", part_to_obj(part).encode()
            yield f"{o.name}/{MODEL}", _model(o, exported.physics)
            yield f"{o.name}/{o.name}.png", thumbnail_png(o.object, exported.scene.camera)


def _in_assets(_: ExportedObject, kind: str, k: int) -> str:
    return f"{ASSETS}/{kind}_{k:02d}"


def upright(o: ExportedObject) -> tuple[Array, Array, float]:
    """T (4, 4) from the object's frame to the middle of its box, as it rests alone.

    Half the sides (3,) of that box [m], and the largest distance of any point from its vertical axis [m], come with
    it."""
    R = o.standing
    points = np.concatenate([o.object.scale * o.object.mesh.vertices, *(part.vertices for part in o.body.parts)]) @ R.T
    low, high = points.min(0), points.max(0)
    middle = (low + high) / 2
    radius = float(np.linalg.norm((points - middle)[:, :2], axis=1).max())
    return pose(R, -middle), (high - low) / 2, radius


def _model(o: ExportedObject, config: PhysicsConfig) -> bytes:
    T, half, radius = upright(o)
    R, inertia = T[:3, :3], T[:3, :3] @ o.body.inertia @ T[:3, :3].T
    place = {"pos": numbers(T[:3, 3]), "quat": numbers(quaternion_from_rotation(R))}
    root = ET.Element("mujoco", model=o.name)
    ET.SubElement(root, "compiler", angle="radian", balanceinertia="true")
    asset, outer = ET.SubElement(root, "asset"), ET.SubElement(ET.SubElement(root, "worldbody"), "body")
    body = ET.SubElement(outer, "body", name="object")
    center = transform(T, o.body.center[None])[0]
    moments = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    ET.SubElement(body, "inertial", pos=numbers(center), mass=numbers(o.body.mass), fullinertia=numbers(moments))
    for look in o.looks:
        name = f"visual_{look.number:02d}"
        add_look(asset, look, name, _in_assets(o, "visual", look.number))
        geom = ET.SubElement(body, "geom", name=name, type="mesh", mesh=name, material=name)
        geom.attrib |= place | {"group": VISUAL, "contype": "0", "conaffinity": "0", "mass": "0"}
    for k in range(len(o.body.parts)):
        name = part_name("collision", k)
        ET.SubElement(asset, "mesh", name=name, file=f"{_in_assets(o, 'collision', k)}.obj", inertia="shell")
        geom = ET.SubElement(body, "geom", name=name, type="mesh", mesh=name)
        geom.attrib |= place | {"group": COLLISION, "condim": str(CONDIM), "friction": numbers(o.body.friction)}
        geom.attrib |= {"solref": numbers(config.solref), "solimp": numbers(SOLIMP), "rgba": "0.5 0.6 0.8 0.5"}
    region = ET.SubElement(body, "geom", name="reg_bbox", type="box", pos="0 0 0", size=numbers(half), rgba="0 0 0 0")
    region.attrib |= {"group": VISUAL, "contype": "0", "conaffinity": "0", "mass": "0"}
    sites = {"bottom": (0, 0, -half[2]), "top": (0, 0, half[2]), "horizontal_radius": (radius, radius, 0)}
    for name, at in sites.items():
        ET.SubElement(outer, "site", name=f"{name}_site", pos=numbers(at), size="0.002", rgba="0 0 0 0")
    return document(root)
