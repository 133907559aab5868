"""URDF: every object as a robot of one link, in a folder of its own with scale baked in, and ``poses.json``.

Metres, Z up; the link's frame is the object frame. Every convex part is a collision of its own, in ``HULL_UNIT``.
Paths are relative.
Contacts are stated for PyBullet (``contact``) and for Drake (``drake:proximity_properties``). URDF holds one body:
``poses.json`` says where each stands in the scene, and ``ground.urdf`` is what they stand on.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from f3sr.core.transforms import Array, quaternion_from_rotation
from f3sr.exporters.drake_contact import depth_of, drake_contact
from f3sr.exporters.exported_scene import ExportedObject, ExportedScene
from f3sr.exporters.obj_looks import hull_path, mesh_files, visual_path
from f3sr.exporters.xml_text import document, inertia_of, numbers
from f3sr.physics.mujoco_model import GROUND_NAME, ground_contact_friction
from f3sr.scene import GRAVITY

ORIGIN = {"xyz": "0 0 0", "rpy": "0 0 0"}
GROUND = "ground.urdf"
"""Beside ``poses.json``."""
WORLD = "world"
"""URDF's name of what never moves."""
HULL_UNIT = 1e-3
"""Unit of the files of convex parts [m], which URDF's ``scale`` states: PhysX drops every corner that is within .0007
units of a file of the rest of a hull, before it scales. Of hulls in metres it dropped half of the corners."""


class Urdf:
    """The ``Exporter`` of URDF."""

    name = "urdf"

    def files(self, exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
        yield "poses.json", json.dumps(_poses(exported), indent=1, allow_nan=False).encode() + b"\n"
        yield GROUND, _ground(exported)
        for o in exported.objects:
            yield f"{o.name}/{o.name}.urdf", _urdf(o)
            yield from ((f"{o.name}/{path}", data) for path, data in mesh_files(o, hull_unit=HULL_UNIT))


def _urdf(o: ExportedObject) -> bytes:
    body = o.body
    root = ET.Element("robot", {"name": o.name, "xmlns:drake": "http://drake.mit.edu"})
    link = ET.SubElement(root, "link", name=o.name)
    sliding, spinning, rolling = body.friction
    contact = ET.SubElement(link, "contact")
    for tag, value in bullet_friction(sliding, spinning, rolling).items():
        ET.SubElement(contact, tag, value=numbers(value))
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
    for k, part in enumerate(o.colliders):
        collision = ET.SubElement(link, "collision", name=f"hull_{k:03d}")
        ET.SubElement(collision, "origin", ORIGIN)
        mesh = ET.SubElement(ET.SubElement(collision, "geometry"), "mesh", filename=hull_path(k))
        mesh.set("scale", numbers([HULL_UNIT] * 3))
        ET.SubElement(mesh, "drake:declare_convex")
        proximity = ET.SubElement(collision, "drake:proximity_properties")
        ET.SubElement(proximity, "drake:mu_dynamic", value=numbers(sliding))
        ET.SubElement(proximity, "drake:mu_static", value=numbers(sliding))
        for name, value in drake_contact(depth_of(part)).items():
            ET.SubElement(proximity, f"drake:{name}", {} if value is None else {"value": value})
    return document(root, declared=True)


def _ground(exported: ExportedScene) -> bytes:
    """The ground as a box: PyBullet grows what lies on its planes by a millimetre. It is fixed to URDF's link
    ``world``, which PyBullet, Drake and ROS take for what never moves."""
    root = ET.Element("robot", {"name": GROUND_NAME, "xmlns:drake": "http://drake.mit.edu"})
    ET.SubElement(root, "link", name=WORLD)
    joint = ET.SubElement(root, "joint", name=f"{GROUND_NAME}_to_{WORLD}", type="fixed")
    ET.SubElement(joint, "parent", link=WORLD)
    ET.SubElement(joint, "child", link=GROUND_NAME)
    link = ET.SubElement(root, "link", name=GROUND_NAME)
    contact = ET.SubElement(link, "contact")
    for tag, value in bullet_friction(*ground_contact_friction(exported.scene.ground.friction)).items():
        ET.SubElement(contact, tag, value=numbers(value))
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", ORIGIN)
    ET.SubElement(inertial, "mass", value="1")
    ET.SubElement(inertial, "inertia", inertia_of(np.eye(3)))
    collision = ET.SubElement(link, "collision", name=GROUND_NAME)
    ground = exported.ground_under(exported.bounds)
    ET.SubElement(collision, "origin", xyz=numbers(ground.middle), rpy="0 0 0")
    box = ET.SubElement(ET.SubElement(collision, "geometry"), "box")
    box.set("size", numbers(ground.sides))
    return document(root, declared=True)


def bullet_friction(sliding: float, spinning: float, rolling: float) -> dict[str, float]:
    """What two equal bodies state so that PyBullet finds between them what is given: it multiplies sliding frictions,
    and adds each body's spinning and rolling friction times the other's sliding one."""
    own = float(np.sqrt(sliding))
    other = 2 * own if own > 0 else 1.0
    return {
        "lateral_friction": own,
        "spinning_friction": spinning / other,
        "rolling_friction": rolling / other,
    }


def _poses(exported: ExportedScene) -> dict[str, Any]:
    """Where the objects stand, and what else a world has."""
    return {
        "units": "m",
        "up": "z",
        "quaternion": "xyzw",
        "gravity": [0.0, 0.0, -GRAVITY],
        "timestep": exported.physics.timestep,
        "ground": {"height": 0.0, "friction": float(exported.scene.ground.friction), "urdf": GROUND},
        "objects": [
            {
                "id": o.id,
                "label": o.label,
                "name": o.name,
                "urdf": f"{o.name}/{o.name}.urdf",
                "fixed": o.body.fixed,
                "friction": float(o.object.friction),
                "restitution": float(o.object.restitution),
                "position": list(map(float, o.object.T_world_object[:3, 3])),
                "orientation": _xyzw(o.object.T_world_object[:3, :3]),
            }
            for o in exported.objects
        ],
    }


def _xyzw(R: Array) -> list[float]:
    w, x, y, z = map(float, quaternion_from_rotation(R))
    return [x, y, z, w]
