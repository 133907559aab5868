"""SDF (SDFormat 1.9) for Gazebo and Drake: every object as a model folder, and ``scene.sdf``, a world with all.

Metres, Z up; a model's frame is the object frame. Every convex part is a collision of its own, declared convex for
Drake. Fixed objects are static. The world has a ground, a lamp and, for Gazebo, the photo's camera.
"""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree import ElementTree as ET

import numpy as np

import f3sr
from f3sr.core.camera import Camera
from f3sr.core.transforms import Array
from f3sr.exporters.drake_contact import depth_of, drake_contact
from f3sr.exporters.export_names import export_text
from f3sr.exporters.exported_scene import ExportedObject, ExportedScene
from f3sr.exporters.mjcf_view import LAMP
from f3sr.exporters.obj_looks import hull_path, mesh_files, visual_path
from f3sr.exporters.xml_text import document, inertia_of, numbers
from f3sr.scene import GRAVITY

VERSION = "1.9"
CAMERA_AXES = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Columns: our camera's axes (x right, y down, z forward) in those of SDF's cameras (x forward, y left, z up)."""
NEAR, FAR = 0.01, 1000.0
"""Planes of the camera [m]."""


class Sdf:
    """The ``Exporter`` of SDF."""

    name = "sdf"

    def files(self, exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
        yield "scene.sdf", _world(exported)
        for o in exported.objects:
            yield f"{o.name}/model.config", _config(o)
            yield f"{o.name}/model.sdf", _model_file(o)
            yield from ((f"{o.name}/{path}", data) for path, data in mesh_files(o))


def _model_file(o: ExportedObject) -> bytes:
    root = _sdf()
    _add_model(root, o, "")
    return document(root, declared=True)


def _add_model(parent: ET.Element, o: ExportedObject, folder: str) -> ET.Element:
    """The model of an object, its files in ``folder``, empty or with ``/`` at its end."""
    body = o.body
    model = ET.SubElement(parent, "model", name=o.name)
    if body.fixed:
        _add(model, "static", "true")
    link = ET.SubElement(model, "link", name="link")
    inertial = ET.SubElement(link, "inertial")
    _add(inertial, "pose", numbers([*body.center, 0, 0, 0]))
    _add(inertial, "mass", numbers(body.mass))
    moments = ET.SubElement(inertial, "inertia")
    for name, value in inertia_of(body.inertia).items():
        _add(moments, name, value)
    for look in o.looks:
        visual = ET.SubElement(link, "visual", name=f"visual_{look.number:02d}")
        _add_mesh(visual, f"{folder}{visual_path(look)}")
        material = ET.SubElement(visual, "material")
        _add(material, "diffuse", numbers([*look.rgb, 1]))
        if look.png is not None:
            metal = ET.SubElement(ET.SubElement(material, "pbr"), "metal")
            _add(metal, "albedo_map", f"{folder}{visual_path(look)}".replace(".obj", ".png"))
            _add(metal, "roughness", "0.8")
            _add(metal, "metalness", "0")
    for k, part in enumerate(o.colliders):
        collision = ET.SubElement(link, "collision", name=f"hull_{k:03d}")
        ET.SubElement(_add_mesh(collision, f"{folder}{hull_path(k)}"), "drake:declare_convex")
        _add_contact(collision, body.friction[0], depth_of(part))
    return model


def _add_contact(collision: ET.Element, sliding: float, depth: float) -> None:
    """Friction, which Gazebo's engines and Drake all read, and what makes areas touch in Drake; ``depth`` as there."""
    ode = ET.SubElement(ET.SubElement(ET.SubElement(collision, "surface"), "friction"), "ode")
    _add(ode, "mu", numbers(sliding))
    _add(ode, "mu2", numbers(sliding))
    drake = ET.SubElement(collision, "drake:proximity_properties")
    for name, value in drake_contact(depth).items():
        ET.SubElement(drake, f"drake:{name}").text = value


def _config(o: ExportedObject) -> bytes:
    root = ET.Element("model")
    _add(root, "name", o.name)
    _add(root, "version", "1.0")
    ET.SubElement(root, "sdf", version=VERSION).text = "model.sdf"
    _add(ET.SubElement(root, "author"), "name", f"f3sr {f3sr.__version__}")
    _add(root, "description", f"object {o.id}: {export_text(o.label) or 'no label'}")
    return document(root, declared=True)


def _world(exported: ExportedScene) -> bytes:
    scene, root = exported.scene, _sdf()
    world = ET.SubElement(root, "world", name="scene")
    physics = ET.SubElement(world, "physics", name="default", type="ignored")
    _add(physics, "max_step_size", numbers(exported.physics.timestep))
    _add(physics, "real_time_factor", "1")
    _add(world, "gravity", numbers([0, 0, -GRAVITY]))
    lamp = ET.SubElement(world, "light", name="lamp", type="directional")
    _add(lamp, "pose", "0 0 3 0 0 0")
    _add(lamp, "diffuse", "0.8 0.8 0.8 1")
    _add(lamp, "specular", "0.1 0.1 0.1 1")
    _add(lamp, "direction", numbers(LAMP))
    _add(lamp, "cast_shadows", "true")
    _add_camera(world, scene.camera)
    for o in exported.objects:
        # Not included: every program looks for included models in other places, but for meshes beside the file.
        T = o.object.T_world_object
        _add(_add_model(world, o, f"{o.name}/"), "pose", numbers([*T[:3, 3], *rpy_of(T[:3, :3])]))
    _add_ground(world, exported)
    return document(root, declared=True)


def _add_ground(world: ET.Element, exported: ExportedScene) -> None:
    """Its top, for collisions a box: Drake 1.51 crashes on a plane below many convex meshes."""
    ground = exported.ground_under(exported.bounds)
    model = ET.SubElement(world, "model", name="ground")
    _add(model, "static", "true")
    link = ET.SubElement(model, "link", name="link")
    collision = ET.SubElement(link, "collision", name="collision")
    _add(collision, "pose", numbers([*ground.middle, 0, 0, 0]))
    box = ET.SubElement(ET.SubElement(collision, "geometry"), "box")
    _add(box, "size", numbers(ground.sides))
    _add_contact(collision, exported.scene.ground.friction, ground.sides[2] / 2)
    visual = ET.SubElement(link, "visual", name="visual")
    _add(visual, "pose", numbers([*ground.middle[:2], 0, 0, 0, 0]))
    plane = ET.SubElement(ET.SubElement(visual, "geometry"), "plane")
    _add(plane, "normal", "0 0 1")
    _add(plane, "size", numbers(ground.sides[:2]))
    _add(ET.SubElement(visual, "material"), "diffuse", "0.8 0.8 0.8 1")


def _add_camera(world: ET.Element, camera: Camera) -> None:
    """The photo's camera as a sensor of a static model, its principal point included."""
    R = camera.T_world_camera[:3, :3] @ CAMERA_AXES.T
    model = ET.SubElement(world, "model", name="photo_camera")
    _add(model, "static", "true")
    _add(model, "pose", numbers([*camera.center, *rpy_of(R)]))
    link = ET.SubElement(model, "link", name="link")
    sensor = ET.SubElement(link, "sensor", name="photo", type="camera")
    _add(sensor, "topic", "photo")
    node = ET.SubElement(sensor, "camera")
    _add(node, "horizontal_fov", numbers(float(2 * np.arctan(camera.width / 2 / camera.K[0, 0]))))
    image = ET.SubElement(node, "image")
    _add(image, "width", str(camera.width))
    _add(image, "height", str(camera.height))
    clip = ET.SubElement(node, "clip")
    _add(clip, "near", numbers(NEAR))
    _add(clip, "far", numbers(FAR))
    intrinsics = ET.SubElement(ET.SubElement(node, "lens"), "intrinsics")
    K = camera.K
    for name, value in {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "s": K[0, 1]}.items():
        _add(intrinsics, name, numbers(value))


def rpy_of(R: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw [rad] of a rotation (3, 3): R = Rz(yaw) Ry(pitch) Rx(roll).

    Where the pitch is a right angle only yaw - roll or yaw + roll counts, and roll is 0."""
    pitch = float(np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-12:
        return 0.0, pitch, float(np.arctan2(-R[0, 1], R[1, 1]))
    return float(np.arctan2(R[2, 1], R[2, 2])), pitch, float(np.arctan2(R[1, 0], R[0, 0]))


def _sdf() -> ET.Element:
    return ET.Element("sdf", {"version": VERSION, "xmlns:drake": "http://drake.mit.edu"})


def _add(node: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(node, tag).text = text


def _add_mesh(node: ET.Element, path: str) -> ET.Element:
    mesh = ET.SubElement(ET.SubElement(node, "geometry"), "mesh")
    _add(mesh, "uri", path)
    return mesh
