"""Triangle meshes with their appearance, convex parts, and mass properties."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from f3sr.frames import Array, frozen, transform


@dataclass(frozen=True, eq=False, kw_only=True)
class Material:
    """Unlit appearance after glTF: ``base_color`` times the texture times the vertex colour."""

    base_color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear factor per channel in [0, 1], applied to the sRGB texture value as the viewers of this field do."""
    texture: NDArray[np.uint8] | None = None
    """(h, w, 3) sRGB; row 0 is the image's top, where v = 1 in trimesh's bottom-left UV convention."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Mesh:
    """A triangle mesh in one frame.

    ``vertices`` (n, 3) float64; ``faces`` (m, 3) int32; ``uv`` (n, 2) with origin at the image's bottom left;
    ``vertex_colors`` (n, 3) uint8 sRGB; ``face_material`` (m,) int32 indexes ``materials``.
    """

    vertices: Array
    faces: NDArray[np.int32]
    uv: Array | None = None
    vertex_colors: NDArray[np.uint8] | None = None
    materials: tuple[Material, ...] = (Material(),)
    face_material: NDArray[np.int32] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen(self.vertices))
        object.__setattr__(self, "faces", frozen(self.faces, np.int32))
        if self.uv is not None:
            object.__setattr__(self, "uv", frozen(self.uv))
        if self.vertex_colors is not None:
            object.__setattr__(self, "vertex_colors", frozen(self.vertex_colors, np.uint8))
        material = np.zeros(len(self.faces), np.int32) if self.face_material is None else self.face_material
        object.__setattr__(self, "face_material", frozen(material, np.int32))

    def with_vertices(self, vertices: Array) -> Self:
        """The same triangles and appearance at other places."""
        from dataclasses import replace

        return replace(self, vertices=vertices)

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) lowest and highest corner."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])

    @property
    def diagonal(self) -> float:
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @cached_property
    def welded(self) -> tuple[Array, NDArray[np.int32]]:
        """Vertices and faces after merging vertices at equal places (texture seams split them) and dropping
        triangles that collapse."""
        unique, inverse = np.unique(self.vertices, axis=0, return_inverse=True)
        faces = inverse.reshape(-1)[self.faces].astype(np.int32)
        a, b, c = faces.T
        return unique, np.ascontiguousarray(faces[(a != b) & (b != c) & (c != a)])

    @cached_property
    def hull(self) -> ConvexPart:
        """The convex hull of all vertices. Raises ValueError when they span no volume."""
        return ConvexPart.hull_of(self.vertices)

    @cached_property
    def is_solid(self) -> bool:
        """True when the welded surface is closed, consistently wound and outward, so that it has a volume."""
        vertices, faces = self.welded
        return is_closed(faces) and signed_volume(vertices, faces) > 0


@dataclass(frozen=True, eq=False, kw_only=True)
class ConvexPart:
    """A convex polytope: ``vertices`` (n, 3), outward ``faces`` (m, 3); every vertex is a corner."""

    vertices: Array
    faces: NDArray[np.int32]

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen(self.vertices))
        object.__setattr__(self, "faces", frozen(self.faces, np.int32))

    @classmethod
    def hull_of(cls, points: Array) -> Self:
        """The convex hull of points (n, 3). Raises ValueError when they span no volume."""
        from scipy.spatial import ConvexHull, QhullError

        try:
            hull = ConvexHull(points)
        except (QhullError, ValueError) as error:
            raise ValueError(f"{len(points)} points span no volume") from error
        corners = np.sort(hull.vertices)
        faces = np.searchsorted(corners, hull.simplices)
        vertices = points[corners]
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
        faces[inward] = faces[inward][:, ::-1]
        return cls(vertices=vertices, faces=faces.astype(np.int32))

    @cached_property
    def volume(self) -> float:
        return signed_volume(self.vertices, self.faces)

    def moved(self, T: Array) -> ConvexPart:
        """The part under an affine map of positive determinant, T (4, 4)."""
        return ConvexPart(vertices=transform(T, self.vertices), faces=self.faces)


@dataclass(frozen=True, eq=False, kw_only=True)
class MassProperties:
    """Of a solid of density 1: ``volume`` [m3], ``center`` (3,) [m], ``inertia`` (3, 3) [m5] about the centre."""

    volume: float
    center: Array
    inertia: Array


def is_closed(faces: NDArray[np.int32]) -> bool:
    """True when every directed edge occurs once and its reverse once."""
    if not len(faces):
        return False
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    n = int(faces.max()) + 1
    forward, backward = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    forward.sort()
    return bool(np.all(forward[1:] != forward[:-1])) and bool(np.array_equal(forward, np.sort(backward)))


def signed_volume(vertices: Array, faces: NDArray[np.int32]) -> float:
    """Volume enclosed by a closed outward surface (divergence theorem)."""
    v = vertices - vertices.mean(0)
    a, b, c = (v[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def mass_properties(vertices: Array, faces: NDArray[np.int32]) -> MassProperties:
    """Exact polyhedral volume, centre and inertia of a closed outward surface (Eberly 2002, "Polyhedral Mass
    Properties")."""
    origin = vertices.mean(0)
    v = vertices - origin
    a, b, c = (v[faces[:, k]] for k in range(3))
    det = np.einsum("ij,ij->i", a, np.cross(b, c))
    volume = det.sum() / 6
    s = a + b + c
    center = (det[:, None] * s).sum(0) / 24 / volume
    second = sum(np.einsum("i,ij,ik->jk", det, p, p) for p in (a, b, c, s)) / 120
    covariance = second - volume * np.outer(center, center)
    inertia = np.trace(covariance) * np.eye(3) - covariance
    return MassProperties(volume=float(volume), center=center + origin, inertia=(inertia + inertia.T) / 2)


def solid_properties(mesh: Mesh, parts: Sequence[ConvexPart]) -> tuple[MassProperties, bool]:
    """Mass properties of the mesh when it is solid, else of the union of its convex parts.

    Returns the properties in the mesh's frame and whether the visual mesh itself was used.
    """
    if mesh.is_solid:
        return mass_properties(*mesh.welded), True
    return mass_properties(*union(parts)), False


def union(parts: Sequence[ConvexPart]) -> tuple[Array, NDArray[np.int32]]:
    """Vertices and faces of the boolean union of convex parts (manifold3d)."""
    import manifold3d as mf

    # Manifold works in single precision for input meshes: centre and scale to keep its full resolution.
    everything = np.concatenate([p.vertices for p in parts])
    center, size = everything.mean(0), float(np.ptp(everything, axis=0).max())
    solids = [
        mf.Manifold(mf.Mesh(((p.vertices - center) / size).astype(np.float32), p.faces.astype(np.uint32)))
        for p in parts
    ]
    merged = mf.Manifold.batch_boolean(solids, mf.OpType.Add).to_mesh()
    vertices = np.asarray(merged.vert_properties[:, :3], float) * size + center
    return vertices, np.asarray(merged.tri_verts, np.int32)
