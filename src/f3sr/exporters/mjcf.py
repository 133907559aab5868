"""MJCF: the scene as a MuJoCo file, the model of ``mujoco_model.build_spec`` with textured visual meshes.

Bodies and their free joints have the names of ``export_names``. MuJoCo 3.3 and later read it. Its convex parts are
``grown_hulls``: it has no contact margin, which MJX refuses and other importers drop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np

from f3sr.core.transforms import Array, quaternion_from_rotation
from f3sr.exporters.collision_parts import collision_files, grown_path
from f3sr.exporters.exported_scene import ExportedObject, ExportedScene
from f3sr.exporters.looks import ExportedLook
from f3sr.exporters.mjcf_view import add_camera, add_keyframe, add_lamp, add_sky, add_view
from f3sr.exporters.obj import part_to_obj, to_obj
from f3sr.exporters.xml_text import document, numbers
from f3sr.physics.mujoco_model import (
    CONDIM,
    GROUND_NAME,
    IMPRATIO,
    SOLIMP,
    Body,
    PhysicsConfig,
    ground_contact_friction,
    part_name,
)
from f3sr.scene import GRAVITY

VISUAL_GROUP, COLLISION_GROUP = 2, 3
"""MuJoCo's viewers show groups 0 to 2 from the start."""
GREY = (0.8, 0.8, 0.8)
"""Of the ground."""

FilePath = Callable[[ExportedObject, str, int], str]
"""Where a file lies, of an object, ``visual`` or ``collision``, and a number; without suffix, relative to scene.xml."""


class Mjcf:
    """The ``Exporter`` of a package's ``scene.xml`` and all that it names: meshes, textures, convex parts."""

    name = "mjcf"

    def files(self, exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
        for o in exported.objects:
            yield from collision_files(o.id, o.body).items()
            for k, part in enumerate(o.colliders):
                yield f"{in_package(o, 'collision', k)}.obj", part_to_obj(part).encode()
            yield from visual_files(o, in_package)
        yield "scene.xml", to_mjcf(exported, in_package, add_plane)


def in_package(o: ExportedObject, kind: str, k: int) -> str:
    """Where a package keeps the files that ``scene.xml`` names."""
    return f"visual/{o.id:02d}_{k:02d}" if kind == "visual" else grown_path(o.id, k).removesuffix(".obj")


def to_mjcf(exported: ExportedScene, path: FilePath, add_ground: Callable[[ET.Element, ExportedScene], None]) -> bytes:
    """``scene.xml``, which names files at their ``path``, on a ground of one kind."""
    scene = exported.scene
    root = ET.Element("mujoco", model="scene")
    ET.SubElement(root, "compiler", angle="radian", balanceinertia="true")
    add_options(root, exported.physics)
    camera = scene.camera
    add_view(root, exported.bounds, camera.T_world_camera[:3, 2], (camera.width, camera.height))
    add_classes(root, exported.physics, scene.ground.friction)
    asset, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    add_sky(asset)
    add_lamp(world, exported.bounds)
    add_camera(world, camera)
    add_ground(world, exported)
    for o in exported.objects:
        add_object(asset, world, o, path)
    add_keyframe(root, [named_body(o) for o in exported.objects])
    return document(root)


def visual_files(o: ExportedObject, path: FilePath) -> Iterator[tuple[str, bytes]]:
    """The visual meshes and textures of an object."""
    for look in o.looks:
        stem = path(o, "visual", look.number)
        yield f"{stem}.obj", _visual_obj(look).encode()
        if look.png is not None:
            yield f"{stem}.png", look.png


def named_body(o: ExportedObject) -> Body:
    """The body under the object's exported name."""
    return replace(o.body, name=o.name)


def add_options(root: ET.Element, config: PhysicsConfig) -> None:
    """Engine settings."""
    option = ET.SubElement(
        root,
        "option",
        timestep=numbers(config.timestep),
        gravity=numbers([0, 0, -GRAVITY]),
        cone="elliptic",
        impratio=numbers(IMPRATIO),
        integrator="Euler",
    )
    ET.SubElement(option, "flag", multiccd="enable")


def add_classes(root: ET.Element, config: PhysicsConfig, ground_friction: float) -> None:
    """The geoms' settings as two classes."""
    default = ET.SubElement(root, "default")
    collision = ET.SubElement(default, "default", {"class": "collision"})
    ET.SubElement(
        collision,
        "geom",
        group=str(COLLISION_GROUP),
        condim=str(CONDIM),
        solref=numbers(config.solref),
        solimp=numbers(SOLIMP),
        rgba="0.5 0.6 0.8 0.5",
    )
    visual = ET.SubElement(default, "default", {"class": "visual"})
    # Visual geoms touch nothing; these are stated all the same, so that no geom carries MuJoCo's defaults.
    ET.SubElement(
        visual,
        "geom",
        group=str(VISUAL_GROUP),
        contype="0",
        conaffinity="0",
        mass="0",
        friction=numbers(ground_contact_friction(ground_friction)),
        solref=numbers(config.solref),
    )


def add_plane(world: ET.Element, exported: ExportedScene) -> None:
    """The ground as a plane. MuJoCo Warp keeps more corners of a mesh on it than on a box: a bottle turned by 1.7
    degrees on a box."""
    _add_ground(world, exported, type="plane", size="20 20 0.1", pos=numbers([0, 0, exported.ground_height]))


def add_box(world: ET.Element, exported: ExportedScene, bounds: Array, **attributes: str) -> None:
    """The ground under what lies within ``bounds`` (2, 3) [m], as a box. Of a mesh on a plane MuJoCo keeps corners only
    that are far from each other, and bodies tremble as those change."""
    ground = exported.ground_under(bounds)
    half = numbers([side / 2 for side in ground.sides])
    _add_ground(world, exported, type="box", size=half, pos=numbers(ground.middle), **attributes)


def _add_ground(world: ET.Element, exported: ExportedScene, **attributes: str) -> None:
    geom = ET.SubElement(world, "geom", {"class": "collision"}, name=GROUND_NAME)
    geom.attrib |= {
        "friction": numbers(ground_contact_friction(exported.scene.ground.friction)),
        "group": "0",
        "rgba": numbers([*GREY, 1]),
        **attributes,
    }


def add_object(asset: ET.Element, world: ET.Element, o: ExportedObject, path: FilePath) -> None:
    """An object's body with its free joint, explicit inertia and geoms, and the files that they name."""
    body = named_body(o)
    T, moment = body.T_world_body, body.inertia
    quaternion = quaternion_from_rotation(T[:3, :3])
    node = ET.SubElement(world, "body", name=body.name, pos=numbers(T[:3, 3]), quat=numbers(quaternion))
    if not body.fixed:
        ET.SubElement(node, "freejoint", name=body.name)
    moments = [moment[0, 0], moment[1, 1], moment[2, 2], moment[0, 1], moment[0, 2], moment[1, 2]]
    ET.SubElement(node, "inertial", pos=numbers(body.center), mass=numbers(body.mass), fullinertia=numbers(moments))
    for look in o.looks:
        _visual(asset, node, look, f"{o.name}_visual_{look.number:02d}", path(o, "visual", look.number))
    for k in range(len(body.parts)):
        name = part_name(body.name, k)
        ET.SubElement(asset, "mesh", name=name, file=f"{path(o, 'collision', k)}.obj", inertia="shell")
        attributes = {"type": "mesh", "mesh": name, "friction": numbers(body.friction)}
        ET.SubElement(node, "geom", {"class": "collision"}, name=name, **attributes)


def _visual_obj(look: ExportedLook) -> str:
    """A vertex is repeated where there are fewer than the four MuJoCo wants."""
    n = len(look.vertices)
    rows = np.concatenate([np.arange(n), np.full(max(0, 4 - n), n - 1)])
    uv = None if look.mesh.uv is None else look.mesh.uv[rows]
    return to_obj(look.vertices[rows], look.faces, uv)


def _visual(asset: ET.Element, node: ET.Element, look: ExportedLook, name: str, stem: str) -> None:
    """A look and its geom."""
    add_look(asset, look, name, stem)
    ET.SubElement(node, "geom", {"class": "visual"}, name=name, type="mesh", mesh=name, material=name)


def add_look(asset: ET.Element, look: ExportedLook, name: str, stem: str) -> None:
    """The mesh, texture and material of a look, all of one name."""
    ET.SubElement(asset, "mesh", name=name, file=f"{stem}.obj", inertia="shell")
    material = ET.SubElement(asset, "material", name=name, rgba=numbers([*look.rgb, 1]), specular="0")
    if look.png is not None:
        ET.SubElement(asset, "texture", name=name, type="2d", file=f"{stem}.png")
        material.set("texture", name)
