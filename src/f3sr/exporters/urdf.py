"""URDF: every object as a robot of one link, in a folder of its own with scale baked in, and ``poses.json``.

Metres, Z up; the link's frame is the object frame. Every convex part is a collision of its own. Paths are relative.
Friction is stated for PyBullet (``contact``) and for Drake (``drake:proximity_properties``). URDF holds one body:
``poses.json`` says where each stands in the scene.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree as ET

from f3sr.core.transforms import Array, quaternion_from_rotation
from f3sr.exporters.exported_scene import ExportedObject, ExportedScene
from f3sr.exporters.obj_looks import hull_path, mesh_files, visual_path
from f3sr.exporters.xml_text import document, inertia_of, numbers
from f3sr.scene import GRAVITY

ORIGIN = {"xyz": "0 0 0", "rpy": "0 0 0"}


class Urdf:
    """The ``Exporter`` of URDF."""

    name = "urdf"

    def files(self, exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
        yield "poses.json", json.dumps(_poses(exported), indent=1, allow_nan=False).encode() + b"\n"
        for o in exported.objects:
            yield f"{o.name}/{o.name}.urdf", _urdf(o)
            yield from ((f"{o.name}/{path}", data) for path, data in mesh_files(o))


def _urdf(o: ExportedObject) -> bytes:
    body = o.body
    root = ET.Element("robot", {"name": o.name, "xmlns:drake": "http://drake.mit.edu"})
    link = ET.SubElement(root, "link", name=o.name)
    sliding, spinning, rolling = body.friction
    contact = ET.SubElement(link, "contact")
    ET.SubElement(contact, "lateral_friction", value=numbers(sliding))
    ET.SubElement(contact, "spinning_friction", value=numbers(spinning))
    ET.SubElement(contact, "rolling_friction", value=numbers(rolling))
    ET.SubElement(contact, "restitution", value=numbers(o.object.restitution))
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=numbers(body.center), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=numbers(body.mass))
    ET.SubElement(inertial, "inertia", inertia_of(body.inertia))
    for look in o.looks:
        visual = ET.SubElement(link, "visual", name=f"visual_{look.number:02d}")
        ET.SubElement(visual, "origin", ORIGIN)
        ET.SubElement(ET.SubElement(visual, "geometry"), "mesh", filename=visual_path(look), scale="1 1 1")
        material = ET.SubElement(visual, "material", name=f"{o.name}_{look.number:02d}")
        if look.png is None:
            ET.SubElement(material, "color", rgba=numbers([*look.rgb, 1]))
        else:
            ET.SubElement(material, "texture", filename=visual_path(look).replace(".obj", ".png"))
    for k in range(len(body.parts)):
        collision = ET.SubElement(link, "collision", name=f"hull_{k:03d}")
        ET.SubElement(collision, "origin", ORIGIN)
        mesh = ET.SubElement(ET.SubElement(collision, "geometry"), "mesh", filename=hull_path(k), scale="1 1 1")
        ET.SubElement(mesh, "drake:declare_convex")
        proximity = ET.SubElement(collision, "drake:proximity_properties")
        ET.SubElement(proximity, "drake:mu_dynamic", value=numbers(sliding))
        ET.SubElement(proximity, "drake:mu_static", value=numbers(sliding))
    return document(root, declared=True)


def _poses(exported: ExportedScene) -> dict[str, Any]:
    """Where the objects stand, and what else a world has."""
    return {
        "units": "m",
        "up": "z",
        "quaternion": "xyzw",
        "gravity": [0.0, 0.0, -GRAVITY],
        "ground": {"height": 0.0, "friction": float(exported.scene.ground.friction)},
        "objects": [
            {
                "id": o.id,
                "label": o.label,
                "name": o.name,
                "urdf": f"{o.name}/{o.name}.urdf",
                "fixed": o.body.fixed,
                "position": list(map(float, o.object.T_world_object[:3, 3])),
                "orientation": _xyzw(o.object.T_world_object[:3, :3]),
            }
            for o in exported.objects
        ],
    }


def _xyzw(R: Array) -> list[float]:
    w, x, y, z = map(float, quaternion_from_rotation(R))
    return [x, y, z, w]
