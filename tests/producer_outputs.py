"""Outputs of other programs, written as those programs leave them, of a scene whose truth is known."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, invert_pose, pose, quaternion_from_rotation, rotation_about, transform
from f3sr.io.mesh_files import save_glb
from f3sr.io.sam3d import LOCAL_FROM_GLB, OPENCV_FROM_PYTORCH3D
from f3sr.scene import SceneObject
from f3sr.vision import rasterizer


@dataclass(frozen=True, eq=False, kw_only=True)
class Laid:
    """Objects in an upright world, the camera that sees them, and what it sees."""

    objects: tuple[SceneObject, ...]
    camera: Camera
    photo: NDArray[np.uint8]
    masks: Mapping[int, NDArray[np.bool_]]

    @classmethod
    def of(cls, objects: Sequence[SceneObject], camera: Camera) -> Laid:
        """What the camera sees, unlit."""
        fragments = rasterizer.render(objects, camera)
        colours = np.round(255 * rasterizer.shade(fragments, objects)).astype(np.uint8)
        colours[fragments.ids == rasterizer.EMPTY] = (150, 140, 120)
        return cls(
            objects=tuple(objects),
            camera=camera,
            photo=colours,
            masks={o.id: fragments.ids == o.id for o in objects},
        )

    def in_camera(self, id: int) -> Array:
        """The vertices (n, 3) of an object in OpenCV camera axes."""
        return self.camera.to_camera(next(o for o in self.objects if o.id == id).vertices_world)


def generated(o: SceneObject, *, seed: int = 0) -> tuple[Mesh, Array, float]:
    """An object as image-to-3D models give it: Y-up in a unit box, turned by some yaw; with T and s back into the
    world: x_world = T (s x)."""
    low, high = o.bounds_world
    middle, size = (low + high) / 2, float((high - low).max())
    yaw = rotation_about([0, 0, 1], float(np.random.default_rng(seed + o.id).uniform(-3, 3)))
    R = yaw @ LOCAL_FROM_GLB
    mesh = o.mesh.with_vertices((o.vertices_world - middle) / size @ R)
    return mesh, pose(R, middle), size


def sam3d_pose(T_world_mesh: Array, scale: float, camera: Camera) -> dict[str, Any]:
    """rotation, translation and scale as SAM 3D Objects writes them, (1, n) each."""
    T = camera.T_camera_world @ T_world_mesh
    F = OPENCV_FROM_PYTORCH3D
    R = (F @ T[:3, :3] @ LOCAL_FROM_GLB.T).T
    return {
        "rotation": [quaternion_from_rotation(R).tolist()],
        "translation": [(F @ T[:3, 3]).tolist()],
        "scale": [[scale] * 3],
    }


def write_photo(laid: Laid, file: Path) -> None:
    """The photo as a PNG."""
    Image.fromarray(laid.photo).save(file)


def write_masks(laid: Laid, folder: Path, *, labels: bool = True) -> Path:
    """Black and white masks, by number and label."""
    folder.mkdir(parents=True, exist_ok=True)
    for o in laid.objects:
        name = f"{o.id:02d}_{o.label.replace(' ', '_')}" if labels else str(o.id)
        Image.fromarray(255 * laid.masks[o.id].astype(np.uint8)).save(folder / f"{name}.png")
    return folder


def point_map(laid: Laid) -> NDArray[np.float32]:
    """(H, W, 3) in PyTorch3D axes of the objects and the plane z = 0, NaN beyond."""
    camera = laid.camera
    rows, columns = np.indices((camera.height, camera.width)) + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(camera.K).T
    down = rays @ camera.T_world_camera[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = np.where(down[..., 2] < 0, -camera.center[2] / down[..., 2], np.nan)
    depth = rasterizer.render(laid.objects, camera).depth
    z = np.where(np.isfinite(depth), depth, plane)
    points = rays * np.where(z < 20, z, np.nan)[..., None]
    return (points @ OPENCV_FROM_PYTORCH3D).astype(np.float32)


# --- programs -----------------------------------------------------------------------------------------------------


def write_sam3d(laid: Laid, folder: Path, *, poses: str = "json", points: bool = True) -> Path:
    """image.png, N.png with the mask as alpha, N.glb; poses in N.json, N.npz or poses.json, or none, or in vertices."""
    folder.mkdir(parents=True)
    write_photo(laid, folder / "image.png")
    listed = dict[str, Any]()
    for o in laid.objects:
        alpha = 255 * laid.masks[o.id].astype(np.uint8)
        Image.fromarray(np.dstack([laid.photo, alpha])).save(folder / f"{o.id}.png")
        mesh, T, s = generated(o)
        if poses == "posed":
            mesh = mesh.with_vertices(laid.camera.to_camera(transform(T, s * mesh.vertices)) @ OPENCV_FROM_PYTORCH3D)
        save_glb(mesh, folder / f"{o.id}.glb")
        given = listed[str(o.id)] = sam3d_pose(T, s, laid.camera)
        if poses == "json":
            (folder / f"{o.id}.json").write_text(json.dumps(given))
        if poses == "npz":
            np.savez(folder / f"{o.id}.npz", **{k: np.array(v, np.float32) for k, v in given.items()})
    if poses == "list":
        (folder / "poses.json").write_text(json.dumps(listed))
    (folder / "splat.ply").write_bytes(b"ply\n")
    if points:
        np.save(folder / "pointmap.npy", point_map(laid))
    return folder


def write_comfyui(laid: Laid, folder: Path, *, poses: str = "aligned") -> Path:
    """image.png, object_K/ with mask.npy and mesh.glb; aligned_mesh.glb, or pose.json, or neither; pickles."""
    folder.mkdir(parents=True)
    write_photo(laid, folder / "image.png")
    (folder / "intrinsics.pt").write_bytes(b"PK\x03\x04 a pickle")
    np.save(folder / "pointmap.npy", point_map(laid))
    for k, o in enumerate(laid.objects):
        own = folder / f"object_{k}"
        own.mkdir()
        np.save(own / "mask.npy", laid.masks[o.id].astype(np.float32))
        mesh, T, s = generated(o)
        save_glb(mesh, own / "mesh.glb")
        (own / "pose.pt").write_bytes(b"PK\x03\x04 a pickle")
        if poses == "aligned":
            posed = laid.camera.to_camera(transform(T, s * mesh.vertices)) @ OPENCV_FROM_PYTORCH3D
            save_glb(mesh.with_vertices(posed), own / "aligned_mesh.glb")
        if poses == "json":
            (own / "pose.json").write_text(json.dumps(sam3d_pose(T, s, laid.camera)))
    return folder


def write_comfyui_files(laid: Laid, folder: Path) -> Path:
    """GLBs with a counter from 1 on, in the order of the objects, in output/3D."""
    (folder / "3D").mkdir(parents=True)
    for k, o in enumerate(laid.objects):
        save_glb(generated(o)[0], folder / "3D" / f"Hy3D_{k + 1:05d}_.glb")
    return folder


def write_fal(laid: Laid, folder: Path, *, order: str = "wxyz") -> Path:
    """result.json, and the GLBs under fal's file names."""
    folder.mkdir(parents=True)
    write_photo(laid, folder / "image.png")
    files, metadata = list[dict[str, Any]](), list[dict[str, Any]]()
    for k, o in enumerate(laid.objects):
        mesh, T, s = generated(o)
        save_glb(mesh, folder / f"fal_{k:04d}_xY.glb")
        files.append(
            {"url": f"https://v3.fal.media/files/b/0a/fal_{k:04d}_xY.glb", "content_type": "model/gltf-binary"}
        )
        given = sam3d_pose(T, s, laid.camera)
        if order == "xyzw":
            given["rotation"] = [[*given["rotation"][0][1:], given["rotation"][0][0]]]
        metadata.append({"object_index": k, **given, "camera_pose": None})
    reply = {"model_glb": {"url": "https://v3.fal.media/files/b/0a/scene.glb"}, "individual_glbs": files,
             "metadata": metadata[::-1], "gaussian_splat": {"url": "https://v3.fal.media/files/x.ply"}}  # fmt: skip
    (folder / "result.json").write_text(json.dumps({"data": reply, "requestId": "1"}))
    return folder


def write_trellis(laid: Laid, folder: Path) -> Path:
    """A folder per object, named by its label, with sample.glb."""
    for o in laid.objects:
        own = folder / o.label.replace(" ", "_")
        own.mkdir(parents=True)
        save_glb(generated(o)[0], own / "sample.glb")
    return folder


URDF = """<?xml version='1.0' encoding='utf-8'?>
<robot name="{name}"><link name="{name}">
<visual><origin xyz="0 0 0" rpy="1.5708 0.0 0.0" /><geometry><mesh filename="mesh/{name}.obj" scale="1.0 1.0 1.0" />
</geometry></visual><inertial><mass value="0.3" /></inertial></link></robot>"""


def write_urdf(o: SceneObject, folder: Path) -> Array:
    """NAME.urdf and mesh/NAME.glb, metric and Y-up; returns T (4, 4) from the link to the world."""
    name = o.label.replace(" ", "_")
    (folder / "mesh").mkdir(parents=True)
    mesh, T, s = generated(o)
    save_glb(mesh.with_vertices(s * mesh.vertices), folder / "mesh" / f"{name}.glb")
    (folder / f"{name}.urdf").write_text(URDF.format(name=name))
    return T @ invert_pose(pose(LOCAL_FROM_GLB))


def write_embodiedgen(laid: Laid, folder: Path, *, layout: bool) -> Path:
    """NAME/result/ with a URDF package per object; with layout.json, asset3d/NAME/result/ and poses in the world."""
    position, assets = dict[str, list[float]](), dict[str, str]()
    for o in laid.objects:
        place = f"asset3d/{o.label}/result" if layout else f"{o.label}/result"
        T = write_urdf(o, folder / place)
        w, x, y, z = quaternion_from_rotation(T[:3, :3])
        position[o.label] = [*T[:3, 3].tolist(), x, y, z, w]
        assets[o.label] = place
    if layout:
        first, *others = [o.label for o in laid.objects]
        document = {
            "tree": {"room": [[first, "IN"]], first: [[n, "ON"] for n in others]},
            "relation": {"background": "room", "context": first, "manipulated_objs": others, "distractor_objs": []},
            "objs_mapping": {"room": "background", first: "context"} | dict.fromkeys(others, "manipulated_objs"),
            "assets": {**assets, "room": "background"},
            "position": {**position, "room": [0, 0, 0, 0, 0, 0, 1]},
        }
        (folder / "layout.json").write_text(json.dumps(document))
    return folder


def glb_bytes(tree: dict[str, Any], binary: bytes) -> bytes:
    """A GLB of a JSON tree and a buffer."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = len(text).to_bytes(4, "little") + b"JSON" + text + len(binary).to_bytes(4, "little") + b"BIN\0" + binary
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks


def composed_tree(meshes: Sequence[Mesh]) -> tuple[dict[str, Any], bytes]:
    """Meshes without nodes: positions and indices only."""
    binary, views, accessors, shapes = b"", list[Any](), list[Any](), list[Any]()
    for mesh in meshes:
        vertices, faces = mesh.vertices.astype("<f4"), mesh.faces.astype("<u4")
        for array, kind, component in ((vertices, "VEC3", 5126), (faces, "SCALAR", 5125)):
            data = array.tobytes()
            views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
            count = len(array) if kind == "VEC3" else array.size
            accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": count, "type": kind})
            binary += data
        n = len(accessors)
        shapes.append({"primitives": [{"attributes": {"POSITION": n - 2}, "indices": n - 1}]})
    tree = {"asset": {"version": "2.0"}, "meshes": shapes, "accessors": accessors, "bufferViews": views,
            "buffers": [{"byteLength": len(binary)}], "scene": 0}  # fmt: skip
    return tree, binary


GROUND_SQUARE = Mesh(
    vertices=np.array([[-2.0, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]]),
    faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
)


def write_composed(laid: Laid, file: Path, *, camera: bool = True, ground: bool = True, frame: str = "world") -> Path:
    """A GLB with a node per object below a wrapper: Y-up, or posed in OpenGL's camera axes; a camera, a ground."""
    import trimesh

    scene: Any = trimesh.Scene()
    T = pose(LOCAL_FROM_GLB.T)
    if frame == "camera":
        T = pose(np.diag([1.0, -1, -1])) @ laid.camera.T_camera_world
    shown = [(o.label, o.mesh.with_vertices(transform(T, o.vertices_world))) for o in laid.objects]
    if ground:
        shown.append(("ground", GROUND_SQUARE.with_vertices(transform(T, GROUND_SQUARE.vertices))))
    for name, mesh in shown:
        visual = trimesh.visual.TextureVisuals(uv=mesh.uv, material=_material(mesh)) if mesh.uv is not None else None
        one = trimesh.Trimesh(mesh.vertices, mesh.faces, visual=visual, process=False)
        scene.add_geometry(one, node_name=name, geom_name=name)
    data = bytes(scene.export(file_type="glb"))
    if camera:
        data = with_camera(data, laid.camera)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)
    return file


def with_camera(data: bytes, camera: Camera) -> bytes:
    """A GLB with a camera node; its lens is centred, as glTF has it."""
    length = int.from_bytes(data[12:16], "little")
    tree, rest = json.loads(data[20 : 20 + length]), data[28 + length :]
    T = pose(LOCAL_FROM_GLB.T) @ camera.T_world_camera @ pose(np.diag([1.0, -1, -1]))
    yfov = 2 * float(np.arctan(camera.height / 2 / camera.K[1, 1]))
    tree["cameras"] = [{"type": "perspective", "perspective": {"yfov": yfov, "znear": 0.01,
                        "aspectRatio": camera.width / camera.height}}]  # fmt: skip
    tree["nodes"].append({"name": "Camera", "camera": 0, "matrix": T.T.ravel().tolist()})
    tree["scenes"][0]["nodes"].append(len(tree["nodes"]) - 1)
    return glb_bytes(tree, rest)


def _material(mesh: Mesh) -> Any:
    import trimesh

    texture = mesh.materials[0].texture
    image = Image.fromarray(texture) if texture is not None else None
    return trimesh.visual.material.PBRMaterial(baseColorTexture=image)
