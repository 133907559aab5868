"""The objects and cameras of a GLB with a node per object, hostile until checked (glTF 2.0, sections 3.5 and 3.10).

Objects are the branches below the deepest node that holds all meshes, so wrappers such as "world" are no objects, and
parts below an object's node stay together. Each branch is read as a file of its own by the one glTF reader.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, pose, rotation_from_quaternion
from f3sr.errors import InputError
from f3sr.files import limited_file, strict_json
from f3sr.files.bounds import MAX_OBJECTS
from f3sr.io.assets import MAX_SCENE_FACES, MAX_SCENE_TEXTURE_PIXELS
from f3sr.io.gltf_reader import MAX_PARTS, MAX_TREE_BYTES
from f3sr.io.mesh_files import mesh_of_glb

ACCEPTED = "a GLB with a node per object"
HEAD = 20
"""Bytes before the JSON chunk: the file's header, and the chunk's."""
MAX_DEPTH = 200
"""Most levels of nodes: exporters nest a few."""
LENIENT = ConfigDict(extra="ignore", allow_inf_nan=False)
Index = Annotated[int, Field(ge=0, strict=True)]
Name = Annotated[str, Field(max_length=1000)]
Numbers = Annotated[list[float], Field(max_length=16)]
T = TypeVar("T")


@dataclass(frozen=True, eq=False, kw_only=True)
class GlbObject:
    """A branch of the file: its name, which may be empty, and its triangles in the file's frame."""

    name: str
    mesh: Mesh


@dataclass(frozen=True, eq=False, kw_only=True)
class GlbCamera:
    """A perspective camera: ``T_file_camera`` (4, 4) rigid, looking along its own -Z, +Y up in the picture."""

    name: str
    T_file_camera: Array
    yfov: float
    """Vertical angle of view [rad]."""
    aspect: float | None
    """Width over height, where told."""


@dataclass(frozen=True, eq=False, kw_only=True)
class GlbScene:
    """What a file shows, in its own frame: +Y up [m]."""

    objects: tuple[GlbObject, ...]
    cameras: tuple[GlbCamera, ...]


def read_glb_scene(file: Path) -> GlbScene:
    """Objects and cameras of the default scene. Raises InputError, naming the file, for what is broken."""
    data = limited_file.read(file, accepted=ACCEPTED)
    tree, rest = _parts(file, data)
    nodes = _Nodes(file, _document(file, tree))
    branches = nodes.branches()
    if not 1 <= len(branches) <= MAX_OBJECTS:
        raise InputError(file, found=f"{len(branches)} objects", accepted=f"1 to {MAX_OBJECTS}")
    return GlbScene(
        objects=tuple(_object(file, tree, rest, nodes, branch) for branch in branches),
        cameras=tuple(nodes.cameras()),
    )


def count_objects(file: Path) -> int:
    """How many objects the nodes tell, without reading their triangles. Raises InputError."""
    tree, _ = _parts(file, limited_file.read(file, accepted=ACCEPTED))
    return len(_Nodes(file, _document(file, tree)).branches())


# --- the JSON part ------------------------------------------------------------------------------------------------


class _GlbNode(BaseModel):
    model_config = LENIENT
    name: Name = ""
    children: list[Index] = []
    mesh: Index | None = None
    camera: Index | None = None
    matrix: Numbers | None = None
    translation: Numbers = [0.0, 0.0, 0.0]
    rotation: Numbers = [0.0, 0.0, 0.0, 1.0]
    scale: Numbers = [1.0, 1.0, 1.0]


class _GlbPerspective(BaseModel):
    model_config = LENIENT
    yfov: Annotated[float, Field(gt=0, lt=np.pi)]
    aspectRatio: Annotated[float, Field(gt=0.01, lt=100)] | None = None


class _GlbLens(BaseModel):
    model_config = LENIENT
    perspective: _GlbPerspective | None = None


class _GlbNamed(BaseModel):
    model_config = LENIENT
    name: Name = ""


class _GlbRoots(BaseModel):
    model_config = LENIENT
    nodes: list[Index] = []


class _GlbTree(BaseModel):
    model_config = LENIENT
    scene: Index = 0
    scenes: Annotated[list[_GlbRoots], Field(min_length=1)]
    nodes: Annotated[list[_GlbNode], Field(min_length=1, max_length=MAX_PARTS)]
    meshes: list[_GlbNamed] = []
    cameras: list[_GlbLens] = []


def _parts(file: Path, data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON tree, and the chunks after it as they are. Their lengths are checked where a branch is read."""
    length = int.from_bytes(data[12:16], "little")
    if data[:4] != b"glTF" or data[16:HEAD] != b"JSON" or HEAD + length > len(data):
        raise InputError(file, found="no GLB of version 2", accepted=ACCEPTED)
    if length > MAX_TREE_BYTES:
        raise InputError(file, found=f"{length:,} bytes of JSON", accepted=f"at most {MAX_TREE_BYTES:,}")
    try:
        tree = strict_json.loads(data[HEAD : HEAD + length])
    except ValueError as error:
        raise InputError(file, found=f"no valid JSON ({error})", accepted=ACCEPTED) from None
    if not isinstance(tree, dict):
        raise InputError(file, found="JSON that is no object", accepted=ACCEPTED)
    return {str(key): value for key, value in tree.items()}, data[HEAD + length :]


def _document(file: Path, tree: Mapping[str, Any]) -> _GlbTree:
    try:
        return _GlbTree.model_validate(tree)
    except ValidationError as error:
        found, _ = strict_json.problem(error, "scenes and nodes")
        raise InputError(file, found=found, accepted=ACCEPTED) from error


# --- the tree of nodes --------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Branch:
    """A node with what hangs below it, or alone, and the nodes above it from a root on."""

    node: int
    above: tuple[int, ...]
    alone: bool = False


class _Nodes:
    """The nodes of the default scene, each reached once."""

    def __init__(self, file: Path, document: _GlbTree) -> None:
        self.file, self.document = file, document
        self.roots = self._at(document.scenes, document.scene, "scene").nodes
        self.order = list(self._walk())
        self.with_mesh = set[int]()
        for node, above in self.order:
            if self.node(node).mesh is not None:
                self.with_mesh |= {node, *above}

    def node(self, index: int) -> _GlbNode:
        return self._at(self.document.nodes, index, "node")

    def branches(self) -> list[_Branch]:
        """What hangs below the deepest node that holds all meshes; that node too where it has one itself."""
        above, level = (), [n for n in self.roots if n in self.with_mesh]
        while len(level) == 1 and self.node(level[0]).mesh is None:
            above = (*above, level[0])
            level = [n for n in self.node(level[0]).children if n in self.with_mesh]
        if len(level) != 1:
            return [_Branch(node=n, above=above) for n in level]
        # One node that has a mesh: a support with things on it, or a single object.
        below = [n for n in self.node(level[0]).children if n in self.with_mesh]
        own = _Branch(node=level[0], above=above, alone=True)
        return [own, *(_Branch(node=n, above=(*above, level[0])) for n in below)]

    def name(self, branch: _Branch) -> str:
        """The node's name, else its mesh's."""
        node = self.node(branch.node)
        if node.name or node.mesh is None:
            return node.name
        return self._at(self.document.meshes, node.mesh, "mesh").name

    def cameras(self) -> Iterator[GlbCamera]:
        """Perspective cameras in the order of the nodes."""
        for index, above in self.order:
            node = self.node(index)
            if node.camera is None:
                continue
            lens = self._at(self.document.cameras, node.camera, "camera").perspective
            if lens is not None:
                steps = [self._matrix(step) for step in (*above, index)]
                rigid = self._rigid(steps[0] if len(steps) == 1 else np.linalg.multi_dot(steps))
                yield GlbCamera(name=node.name, T_file_camera=rigid, yfov=lens.yfov, aspect=lens.aspectRatio)

    def _walk(self) -> Iterator[tuple[int, tuple[int, ...]]]:
        """Nodes with those above them, parents first; raises InputError for what is no tree."""
        stack: list[tuple[int, tuple[int, ...]]] = [(n, ()) for n in reversed(self.roots)]
        visited = set[int]()
        while stack:
            index, above = stack.pop()
            if index in visited or len(above) > MAX_DEPTH:
                found = f"node {index} reached twice" if index in visited else f"more than {MAX_DEPTH} levels"
                raise InputError(self.file, found=found, accepted="a tree of nodes")
            visited.add(index)
            yield index, above
            stack += [(child, (*above, index)) for child in reversed(self.node(index).children)]

    def _matrix(self, index: int) -> Array:
        node = self.node(index)
        sizes = (len(node.translation), len(node.rotation), len(node.scale), len(node.matrix or range(16)))
        if sizes != (3, 4, 3, 16):
            raise InputError(self.file, found=f"a transform of node {index}", accepted="3, 4, 3 or 16 numbers")
        if node.matrix is not None:
            return np.array(node.matrix, float).reshape(4, 4).T
        x, y, z, w = node.rotation
        R = rotation_from_quaternion([w, x, y, z]) if any(node.rotation) else np.eye(3)
        return pose(R * np.array(node.scale), node.translation)

    def _rigid(self, M: Array) -> Array:
        """A camera's place without scale (glTF: a camera's transform should have none)."""
        lengths = np.linalg.norm(M[:3, :3], axis=0)
        if not (np.isfinite(M).all() and (lengths > 1e-9).all()):
            raise InputError(self.file, found="a camera of no size, or at no place", accepted="a rigid transform")
        R = M[:3, :3] / lengths
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
            raise InputError(self.file, found="a camera that is mirrored or sheared", accepted="a rigid transform")
        U, _, V = np.linalg.svd(R)
        return pose(U @ V, M[:3, 3])

    def _at(self, items: list[T], index: int, what: str) -> T:
        if index >= len(items):
            raise InputError(self.file, found=f"{what} {index} of {len(items)}", accepted=ACCEPTED)
        return items[index]


# --- one branch as a file -----------------------------------------------------------------------------------------


def _object(file: Path, tree: dict[str, Any], rest: bytes, nodes: _Nodes, branch: _Branch) -> GlbObject:
    """The branch by the one glTF reader: the same file with the other nodes cut off."""
    cut = [dict(node) for node in tree["nodes"]]
    path = (*branch.above, branch.node)
    for index, following in pairwise(path):
        cut[index].pop("mesh", None)
        cut[index]["children"] = [following]
    if branch.alone:
        cut[branch.node].pop("children", None)
    text = json.dumps({**tree, "nodes": cut, "scene": 0, "scenes": [{"nodes": [path[0]]}]}).encode()
    text += b" " * (-len(text) % 4)
    total = HEAD + len(text) + len(rest)
    head = b"glTF" + b"".join(n.to_bytes(4, "little") for n in (2, total, len(text))) + b"JSON"
    where = Path(f"{file} node {branch.node}")
    mesh = mesh_of_glb(
        head + text + rest, where, max_faces=MAX_SCENE_FACES, max_texture_pixels=MAX_SCENE_TEXTURE_PIXELS
    )
    return GlbObject(name=nodes.name(branch), mesh=mesh.without_unused())
