"""MJCF: the scene as a MuJoCo file, the model of ``mujoco_model.build_spec`` with textured visual meshes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import Material, Mesh
from f3sr.core.transforms import Array, quaternion_from_rotation
from f3sr.exporters.collision_parts import collision_files, collision_path
from f3sr.exporters.colour_atlas import AtlasConfig, ColourAtlas, bake_colours
from f3sr.exporters.obj import to_obj
from f3sr.io.gltf_writer import png_of
from f3sr.io.images import encode_png
from f3sr.physics.mujoco_model import (
    CONDIM,
    DEFAULT_PHYSICS,
    GROUND_NAME,
    IMPRATIO,
    SOLIMP,
    Body,
    PhysicsConfig,
    body_of,
    ground_contact_friction,
    part_name,
)
from f3sr.scene import GRAVITY, Scene, SceneObject

VISUAL_GROUP, COLLISION_GROUP = 2, 3
"""MuJoCo's viewers show groups 0 to 2 from the start."""

LEAST_AREA = 1e-12
"""[m2]: faces of one material with less than this cannot be seen, and MuJoCo refuses a mesh of them."""


@dataclass(frozen=True, kw_only=True)
class Mjcf:
    """The ``Exporter`` of ``scene.xml`` with all that it names: visual meshes, textures and convex parts."""

    atlas: AtlasConfig = field(default_factory=AtlasConfig)
    name = "mjcf"

    def files(self, scene: Scene, physics: PhysicsConfig) -> Iterator[tuple[str, bytes]]:
        for o in scene:
            yield from collision_files(o.id, body_of(o)).items()
        yield from to_mjcf(scene, physics, self.atlas)


def to_mjcf(
    scene: Scene, config: PhysicsConfig = DEFAULT_PHYSICS, atlas: AtlasConfig | None = None
) -> Iterator[tuple[str, bytes]]:
    """The visual meshes and textures of ``scene.xml``, then itself, each with its relative path.

    One at a time, for together they are large. It also names the convex parts of ``collision_files``, which belong
    beside it.
    """
    root = ET.Element("mujoco", model="scene")
    ET.SubElement(root, "compiler", angle="radian", balanceinertia="true")
    _options(root, config, scene.ground.friction)
    asset, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    _surroundings(world, scene)
    for o in scene:
        body = body_of(o)
        node = _body(world, body)
        for look in _looks(o, atlas):
            yield from look.files
            _visual(asset, node, look)
        _collision(asset, node, body, o.id)
    ET.indent(root)
    yield "scene.xml", ET.tostring(root) + b"\n"


def _options(root: ET.Element, config: PhysicsConfig, ground_friction: float) -> None:
    """Engine settings, and the geoms' settings as two classes."""
    option = ET.SubElement(
        root,
        "option",
        timestep=_text(config.timestep),
        gravity=_text([0, 0, -GRAVITY]),
        cone="elliptic",
        impratio=_text(IMPRATIO),
        integrator="Euler",
    )
    ET.SubElement(option, "flag", multiccd="enable")
    default = ET.SubElement(root, "default")
    collision = ET.SubElement(default, "default", {"class": "collision"})
    ET.SubElement(
        collision,
        "geom",
        group=str(COLLISION_GROUP),
        condim=str(CONDIM),
        solref=_text(config.solref),
        solimp=_text(SOLIMP),
        rgba="0.5 0.6 0.8 0.5",
    )
    visual = ET.SubElement(default, "default", {"class": "visual"})
    # Visual geoms touch nothing; their friction is stated all the same, so that no geom carries MuJoCo's default of 1.
    ET.SubElement(
        visual,
        "geom",
        group=str(VISUAL_GROUP),
        contype="0",
        conaffinity="0",
        mass="0",
        friction=_text(ground_contact_friction(ground_friction)),
    )


def _surroundings(world: ET.Element, scene: Scene) -> None:
    """Light, the photo's camera (its principal point taken as central) and the ground plane."""
    ET.SubElement(world, "light", directional="true", pos="0 0 3", dir="0.2 0.3 -1")
    camera = scene.camera
    R = camera.T_world_camera[:3, :3]
    ET.SubElement(
        world,
        "camera",
        name="photo",
        pos=_text(camera.center),
        xyaxes=_text([*R[:, 0], *-R[:, 1]]),
        fovy=_text(float(np.degrees(2 * np.arctan(camera.height / 2 / camera.K[1, 1])))),
    )
    plane = ET.SubElement(world, "geom", {"class": "collision"}, name=GROUND_NAME, type="plane", size="20 20 0.1")
    plane.attrib |= {
        "friction": _text(ground_contact_friction(scene.ground.friction)),
        "group": "0",
        "rgba": "0.8 0.8 0.8 1",
    }


def _body(world: ET.Element, body: Body) -> ET.Element:
    """The body with its free joint and explicit inertia."""
    T, moment = body.T_world_body, body.inertia
    quaternion = quaternion_from_rotation(T[:3, :3])
    node = ET.SubElement(world, "body", name=body.name, pos=_text(T[:3, 3]), quat=_text(quaternion))
    if not body.fixed:
        ET.SubElement(node, "freejoint", name=body.name)
    moments = [moment[0, 0], moment[1, 1], moment[2, 2], moment[0, 1], moment[0, 2], moment[1, 2]]
    ET.SubElement(node, "inertial", pos=_text(body.center), mass=_text(body.mass), fullinertia=_text(moments))
    return node


def _collision(asset: ET.Element, node: ET.Element, body: Body, id: int) -> None:
    for k in range(len(body.parts)):
        name = part_name(body.name, k)
        ET.SubElement(asset, "mesh", name=name, file=collision_path(id, k), inertia="shell")
        attributes = {"type": "mesh", "mesh": name, "friction": _text(body.friction)}
        ET.SubElement(node, "geom", {"class": "collision"}, name=name, **attributes)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Look:
    """The faces of an object that share a material: their files, and their colour."""

    name: str
    files: Sequence[tuple[str, bytes]]
    mesh: str
    texture: str | None
    rgb: Sequence[float]


def _looks(o: SceneObject, atlas: AtlasConfig | None) -> Iterator[_Look]:
    """One visual mesh per material in use. MuJoCo knows no vertex colours: they become a texture, where the material
    has none. Else their mean stands for them."""
    mesh = o.mesh
    assert mesh.face_material is not None
    for k in np.unique(mesh.face_material):
        faces = mesh.faces[mesh.face_material == k]
        if _area(o.scale * mesh.vertices[faces]) < LEAST_AREA:
            continue
        material, stem = mesh.materials[k], f"visual/{o.id:02d}_{k:02d}"
        painted = None if material.texture is None or mesh.uv is None else material
        baked, colour = (None, (1.0, 1.0, 1.0)) if mesh.vertex_colors is None else _baked(mesh, faces, painted, atlas)
        png = encode_png(baked.texture) if baked else png_of(painted) if painted else None
        files = [(f"{stem}.obj", _visual_obj(mesh, faces, o.scale, baked).encode())]
        if png is not None:
            files.append((f"{stem}.png", png))
        yield _Look(
            name=f"visual_{o.id:02d}_{k:02d}",
            files=files,
            mesh=f"{stem}.obj",
            texture=None if png is None else f"{stem}.png",
            rgb=(np.asarray(material.base_color) * colour).tolist(),
        )


def _baked(
    mesh: Mesh, faces: NDArray[np.int32], painted: Material | None, atlas: AtlasConfig | None
) -> tuple[ColourAtlas | None, Sequence[float]]:
    """The vertex colours of some faces as a texture, or as one colour: their own, or their mean under a texture."""
    colours = mesh.vertex_colors
    assert colours is not None
    used = colours[np.unique(faces)]
    if painted is None and (used != used[0]).any():
        baked = bake_colours(mesh.vertices, faces, colours, atlas)
        if baked is not None:
            return baked, (1.0, 1.0, 1.0)
    return None, (used.mean(0) / 255).tolist()


def _visual_obj(mesh: Mesh, faces: NDArray[np.int32], scale: float, baked: ColourAtlas | None) -> str:
    """The chosen faces in metres; a vertex is repeated where there are fewer than the four MuJoCo wants."""
    used, inverse = np.unique(faces, return_inverse=True)
    used = np.concatenate([used, np.repeat(used[-1:], max(0, 4 - len(used)))])
    vertices, own = scale * mesh.vertices[used], inverse.reshape(-1, 3).astype(np.int32)
    if baked is not None:
        return to_obj(vertices, own, baked.uv, baked.uv_faces)
    return to_obj(vertices, own, None if mesh.uv is None else mesh.uv[used])


def _area(triangles: Array) -> float:
    """Of triangles (m, 3, 3)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _visual(asset: ET.Element, node: ET.Element, look: _Look) -> None:
    """The mesh, texture and material of a look, and its geom."""
    ET.SubElement(asset, "mesh", name=look.name, file=look.mesh, inertia="shell")
    material = ET.SubElement(asset, "material", name=look.name, rgba=_text([*look.rgb, 1]), specular="0")
    if look.texture is not None:
        ET.SubElement(asset, "texture", name=look.name, type="2d", file=look.texture)
        material.set("texture", look.name)
    attributes = {"type": "mesh", "mesh": look.name, "material": look.name}
    ET.SubElement(node, "geom", {"class": "visual"}, name=look.name, **attributes)


def _text(values: float | Iterable[float] | Array) -> str:
    """Numbers at full precision."""
    return " ".join(repr(float(v)) for v in np.atleast_1d(np.asarray(values, float)))
