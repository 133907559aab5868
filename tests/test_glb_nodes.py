"""Laws of the nodes of a GLB: which are objects, where they are, cameras, and what is no tree."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from f3sr.core.mesh import Mesh, signed_volume
from f3sr.core.transforms import quaternion_from_rotation, rotation_about
from f3sr.errors import InputError
from f3sr.importing.glb_nodes import count_objects, read_glb_scene
from f3sr.importing.import_source import ImportSource
from f3sr.importing.scene_import import import_output
from producer_outputs import composed_tree, glb_bytes
from scenes import box


def cube(size: float = 1.0) -> Mesh:
    return box(0, size=(size, size, size), at=(0, 0, 0)).mesh


def written(file: Path, nodes: list[dict[str, Any]], roots: list[int], meshes: int = 2, **more: Any) -> Path:
    tree, binary = composed_tree([cube(1.0 + k) for k in range(meshes)])
    file.write_bytes(glb_bytes({**tree, "nodes": nodes, "scenes": [{"nodes": roots}], **more}, binary))
    return file


def test_nested_transforms_instances_and_mirrors_are_where_gltf_says(tmp_path: Path):
    R = rotation_about([1, 2, 3], 0.7)
    w, x, y, z = quaternion_from_rotation(R)
    nodes = [
        {"name": "world", "children": [1, 3], "scale": [2, 2, 2]},
        {"name": "mug", "children": [2], "rotation": [x, y, z, w], "translation": [1, 2, 3]},
        {"name": "body", "mesh": 0, "translation": [0, 0, 5]},
        {"name": "mirrored mug", "mesh": 0, "scale": [-1, 1, 3], "translation": [4, 0, 0]},
    ]
    mug, mirrored = read_glb_scene(written(tmp_path / "a.glb", nodes, [0])).objects
    assert (mug.name, mirrored.name) == ("mug", "mirrored mug")
    v = cube().vertices
    assert np.allclose(mug.mesh.vertices, 2 * ((v + np.array([0, 0, 5])) @ R.T + [1, 2, 3]), atol=1e-5)
    assert np.allclose(mirrored.mesh.vertices, 2 * (v * [-1, 1, 3] + [4, 0, 0]), atol=1e-5)
    for o, volume in ((mug, 8.0), (mirrored, 24.0)):
        assert signed_volume(o.mesh.vertices, o.mesh.faces) == pytest.approx(volume, rel=1e-5), "outward"


def test_objects_are_the_branches_below_the_deepest_common_node(tmp_path: Path):
    parts = [{"name": "scene", "children": [1]}, {"name": "root", "children": [2, 5]},
             {"name": "lamp", "children": [3, 4]}, {"mesh": 0}, {"mesh": 1},
             {"name": "box", "mesh": 0}]  # fmt: skip
    lamp, single = read_glb_scene(written(tmp_path / "a.glb", parts, [0])).objects
    assert (lamp.name, len(lamp.mesh.faces), single.name, len(single.mesh.faces)) == ("lamp", 24, "box", 12)
    parented = [{"name": "table", "mesh": 1, "children": [1, 2]}, {"name": "a", "mesh": 0}, {"name": "b", "mesh": 0}]
    names = [(o.name, len(o.mesh.faces)) for o in read_glb_scene(written(tmp_path / "b.glb", parented, [0])).objects]
    assert names == [("table", 12), ("a", 12), ("b", 12)]
    assert count_objects(tmp_path / "b.glb") == 3


def test_cameras_have_their_place_without_scale(tmp_path: Path):
    R = rotation_about([0, 1, 0], 0.3)
    w, x, y, z = quaternion_from_rotation(R)
    nodes = [
        {"children": [1, 2], "scale": [2, 2, 2]},
        {"mesh": 0},
        {"name": "eye", "camera": 0, "rotation": [x, y, z, w], "translation": [0, 0, 4]},
    ]
    lens = {"type": "perspective", "perspective": {"yfov": 0.6, "znear": 0.1}}
    (camera,) = read_glb_scene(written(tmp_path / "a.glb", nodes, [0], cameras=[lens])).cameras
    assert (camera.name, camera.yfov, camera.aspect) == ("eye", 0.6, None)
    assert np.allclose(camera.T_file_camera[:3, :3], R) and np.allclose(camera.T_file_camera[:3, 3], [0, 0, 8])


BROKEN: dict[str, tuple[list[dict[str, Any]], list[int], str]] = {
    "a loop": ([{"children": [1]}, {"children": [0], "mesh": 0}], [0], "reached twice"),
    "a node with two parents": ([{"children": [2]}, {"children": [2]}, {"mesh": 0}], [0, 1], "reached twice"),
    "a child that is not there": ([{"children": [7], "mesh": 0}], [0], "node 7 of 1"),
    "a mesh that is not there": ([{"mesh": 0}, {"mesh": 9}], [0, 1], "mesh 9 of 2"),
    "no mesh at all": ([{"name": "a"}], [0], "0 objects"),
    "a negative child": ([{"children": [-1], "mesh": 0}], [0], "children"),
    "NaN for a place": ([{"mesh": 0, "translation": [0, 0, 1e999]}], [0], "inf|finite|Infinity"),
    "a deep tree": ([*({"children": [k + 1]} for k in range(300)), {"mesh": 0}], [0], "more than 200 levels"),
    "a lens of pi": ([{"mesh": 0}, {"camera": 0}], [0, 1], "yfov"),
    "a camera of no size": ([{"mesh": 0}, {"camera": 1, "scale": [0, 0, 0]}], [0, 1], "a camera of no size"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_no_scene_is_one_clear_error(name: str, tmp_path: Path):
    nodes, roots, told = BROKEN[name]
    yfov = 3.2 if name == "a lens of pi" else 0.6
    lenses = [{"type": "perspective", "perspective": {"yfov": yfov}}] * 2
    with pytest.raises(InputError, match=told):
        read_glb_scene(written(tmp_path / "a.glb", nodes, roots, cameras=lenses))


def test_equal_names_are_numbered_and_flat_nodes_left_out(tmp_path: Path):
    flat = [1.0, 0.0, 1.0]
    nodes = [
        {"name": "cup", "mesh": 0, "scale": [0.1] * 3, "translation": [0, 0.05, 0]},
        {"name": "cup", "mesh": 0, "scale": [0.1] * 3, "translation": [0.4, 0.05, 0]},
        {"name": "poster", "mesh": 0, "scale": [0.1, 0.1, 0], "translation": [0, 0.5, 0]},
        {"name": "floor", "mesh": 0, "scale": [4 * s for s in flat]},
    ]
    file = written(tmp_path / "a.glb", nodes, [0, 1, 2, 3])
    done = import_output(ImportSource(path=file), tmp_path / "in")
    assert sorted(p.name for p in (tmp_path / "in" / "masks").iterdir()) == ["00_cup_1.png", "01_cup_2.png"]
    assert {(item.label, item.reason.split(":")[0]) for item in done.left_out} == {
        ("poster", "it is flat"),
        ("floor", "it is the ground"),
    }
