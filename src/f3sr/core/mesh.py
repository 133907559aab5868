"""Triangle meshes with their appearance, convex parts, and mass properties."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array, bounds_of, cross, frozen, transform


@dataclass(frozen=True, eq=False, kw_only=True)
class Material:
    """Unlit appearance as in glTF: ``base_color`` times texture times vertex colour."""

    base_color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear factor per channel in [0, 1], applied to the sRGB texture value as the viewers of this field do."""
    texture: NDArray[np.uint8] | None = None
    """(h, w, 3) sRGB; row 0 is the image's top, where v = 1 in trimesh's bottom-left UV convention."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Mesh:
    """A triangle mesh in one frame; scenes hold it in the asset frame, in the asset's unit.

    ``vertices`` (n, 3) float64; ``faces`` (m, 3) int32; ``uv`` (n, 2) with origin at
    the image's bottom left; ``vertex_colors`` (n, 3) uint8 sRGB; ``face_material`` (m,) int32 indexes ``materials``.
    Arrays are read-only.
    """

    vertices: Array
    faces: NDArray[np.int32]
    uv: Array | None = None
    vertex_colors: NDArray[np.uint8] | None = None
    materials: tuple[Material, ...] = (Material(),)
    face_material: NDArray[np.int32] | None = None
    pieces: tuple[ConvexPart, ...] = ()
    """Convex pieces that hold it, in its frame and unit, where its maker knows them; else it is cut into some."""

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
        """The same triangles and appearance with other vertices (n, 3), in any frame and unit."""
        from dataclasses import replace

        return replace(self, vertices=vertices, pieces=())

    def without_unused(self) -> Self:
        """The same triangles without unused vertices: a stray one would enlarge the bounds."""
        from dataclasses import replace

        used = np.unique(self.faces)
        if len(used) == len(self.vertices):
            return self
        return replace(
            self,
            vertices=self.vertices[used],
            faces=np.searchsorted(used, self.faces).astype(np.int32),
            uv=None if self.uv is None else self.uv[used],
            vertex_colors=None if self.vertex_colors is None else self.vertex_colors[used],
        )

    @property
    def has_detail(self) -> bool:
        """Whether colours vary over the surface: it has a texture or vertex colours."""
        textured = self.uv is not None and any(m.texture is not None and m.texture.size > 4 for m in self.materials)
        return textured or self.vertex_colors is not None

    @cached_property
    def bounds(self) -> Array:
        """Lowest and highest corner (2, 3), in the frame and unit of ``vertices``."""
        return bounds_of(self.vertices)

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box, in the unit of ``vertices``: the size of an unscaled object."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @cached_property
    def weld(self) -> tuple[Array, NDArray[np.int32]]:
        """The distinct positions (k, 3) of the vertices, sorted by x, y, z, and the position index (n,) of each vertex.

        Texture seams split vertices, so topology needs positions.
        """
        return places(self.vertices)

    @cached_property
    def welded(self) -> tuple[Array, NDArray[np.int32]]:
        """Vertices (k, 3) and faces (j, 3) with equal positions merged and collapsed triangles dropped."""
        places, place = self.weld
        faces = place[self.faces]
        a, b, c = faces.T
        return places, np.ascontiguousarray(faces[(a != b) & (b != c) & (c != a)])

    @cached_property
    def hull(self) -> ConvexPart:
        """The convex hull of all vertices. Raises ValueError when they span no volume."""
        return ConvexPart.hull_of(self.vertices)

    @cached_property
    def stored_volume(self) -> float:
        """Volume of the surface if each undirected edge has two faces without welding, otherwise infinite."""
        f = self.faces.astype(np.int64)
        edges = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
        _, counts = np.unique(edges[:, 0] * (f.max() + 1) + edges[:, 1], return_counts=True)
        return abs(signed_volume(self.vertices, self.faces)) if (counts == 2).all() else np.inf

    @cached_property
    def is_solid(self) -> bool:
        """Whether the welded surface bounds a solid with a well-defined volume.

        It must be closed, consistently wound and outward. No shell lies in another that faces the same way. It does not
        cross itself so much that no body could have its inertia.
        """
        vertices, faces = self.welded
        if not is_closed(faces) or signed_volume(vertices, faces) <= 0 or has_layers(vertices, faces):
            return False
        return mass_properties(vertices, faces).is_possible

    @cached_property
    def center_of_mass(self) -> Array:
        """(3,) of the solid, or of the hull where the surface bounds none."""
        solid = self.welded if self.is_solid else (self.hull.vertices, self.hull.faces)
        return frozen(mass_properties(*solid).center)


@dataclass(frozen=True, eq=False, kw_only=True)
class ConvexPart:
    """A convex polytope: ``vertices`` (n, 3), outward ``faces`` (m, 3). Every vertex is a corner of the hull."""

    vertices: Array
    faces: NDArray[np.int32]

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen(self.vertices))
        object.__setattr__(self, "faces", frozen(self.faces, np.int32))

    @classmethod
    def hull_of(cls, points: Array) -> Self:
        """The convex hull of points (n, 3). Raises ValueError when they span no volume, MemoryError when qhull does."""
        hull = qhull(points)
        corners = np.sort(hull.vertices)
        faces = np.searchsorted(corners, hull.simplices).astype(np.int32)
        vertices = points[corners]
        # qhull's simplices have no common winding; its equations have outward normals.
        outward = np.einsum("ij,ij->i", area_vectors(vertices[faces]), hull.equations[:, :3])
        faces[outward < 0] = faces[outward < 0][:, ::-1]
        if not _is_closed(faces):  # rounding turns slivers
            faces = _turned_alike(faces, hull.neighbors, int(np.argmax(np.abs(outward))))
        return cls(vertices=vertices, faces=faces)

    @cached_property
    def volume(self) -> float:
        """Enclosed volume, in cubes of the unit of ``vertices``."""
        return signed_volume(self.vertices, self.faces)

    @cached_property
    def centroid(self) -> Array:
        """Centre of volume (3,)."""
        origin = self.vertices.mean(0)
        a, b, c = (self.vertices[self.faces[:, k]] - origin for k in range(3))
        volumes = np.einsum("ij,ij->i", a, cross(b, c))
        return frozen(origin + volumes @ (a + b + c) / (4 * volumes.sum()))

    def above(self, normal: Array, offset: float) -> ConvexPart:
        """The part above the plane ``normal . x = offset``. Raises ValueError if that has no volume."""
        height = self.vertices @ normal - offset
        if (height >= 0).all():
            return self
        # Every directed edge; each edge occurs both ways, so the downward crossing alone finds all.
        start, end = np.concatenate([self.faces, np.roll(self.faces, 1, axis=1)]).reshape(2, -1)
        crossing = (height[start] > 0) & (height[end] < 0)
        start, end = start[crossing], end[crossing]
        share = (height[start] / (height[start] - height[end]))[:, None]
        met = self.vertices[start] + share * (self.vertices[end] - self.vertices[start])
        return ConvexPart.hull_of(np.concatenate([self.vertices[height >= 0], np.unique(met, axis=0)]))

    def moved(self, T: Array) -> ConvexPart:
        """The part under an affine map T (4, 4) of positive determinant: a reflection would turn faces inward."""
        return ConvexPart(vertices=transform(T, self.vertices), faces=self.faces)


@dataclass(frozen=True, eq=False, kw_only=True)
class MassProperties:
    """Of a solid of density 1: ``volume`` [m3], ``center`` (3,) [m], ``inertia`` (3, 3) [m5] about the centre."""

    volume: float
    center: Array
    inertia: Array

    @property
    def is_possible(self) -> bool:
        """Whether a body can have this inertia: principal moments are positive, none exceeds the sum of the others."""
        a, b, c = np.linalg.eigvalsh(self.inertia)
        return bool(a > 0 and a + b >= c * (1 - 1e-9))


QHULL_OPTIONS = ("Qt", "Qt Q12")
"""Tried in order. Near twins of points may leave facets 1e-12 wide, at which Qhull stops without Q12."""


def qhull(points: Array) -> Any:
    """scipy's hull of points (n, 3). Raises ValueError when they span no volume, MemoryError when Qhull does."""
    from scipy.spatial import ConvexHull, QhullError

    for options in QHULL_OPTIONS:
        try:
            return ConvexHull(points, qhull_options=options)
        except (QhullError, ValueError) as error:
            if "insufficient memory" in str(error):
                raise MemoryError(f"hull of {len(points)} points") from error
    raise ValueError(f"{len(points)} points span no volume")


def places(points: Array) -> tuple[Array, NDArray[np.int32]]:
    """The distinct ones (k, 3) of points (n, 3), sorted by x, y, z, and where each point is among them (n,)."""
    # lexsort sorts by its last key first: reversed, x is the first key. Equal points become neighbours.
    order = np.lexsort(points.T[::-1])
    placed = points[order]
    new = np.ones(len(order), np.bool_)
    new[1:] = (placed[1:] != placed[:-1]).any(1)
    place = np.empty(len(order), np.int32)
    # Rank of a place: how many new ones came up to it.
    place[order] = np.cumsum(new) - 1
    return placed[new], place


def area_vectors(triangles: Array) -> Array:
    """Normals (n, 3) of triangles (n, 3, 3), twice as long as their area."""
    return cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def is_closed(faces: NDArray[np.int32]) -> bool:
    """True when every directed edge occurs once and its reverse once."""
    if not len(faces):
        return False
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    n = int(faces.max()) + 1
    # A directed edge as one number, from * n + to.
    forward, backward = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    forward.sort()
    return bool(np.all(forward[1:] != forward[:-1])) and bool(np.array_equal(forward, np.sort(backward)))


@dataclass(frozen=True, kw_only=True)
class Flaws:
    """What keeps a welded surface from being a clean solid, counted."""

    degenerate: int
    """Triangles of no area."""
    doubled: int
    """Triangles whose corners another triangle has too."""
    open: int
    """Edges of a single triangle."""
    shared: int
    """Edges of more than two triangles."""
    turned: int
    """Edges that their two triangles run through in the same direction."""
    layers: bool
    """Nested shells face the same way."""

    def __str__(self) -> str:
        named = {
            "triangles of no area": self.degenerate,
            "doubled triangles": self.doubled,
            "open edges": self.open,
            "edges of more than two triangles": self.shared,
            "edges between triangles that face opposite sides": self.turned,
            "layer or fold within itself": int(self.layers),
        }
        return ", ".join(f"{count:,} {name}" for name, count in named.items() if count) or "facing inward"


def surface_flaws(mesh: Mesh) -> Flaws:
    """Count the flaws of the welded surface of a mesh. A solid may only have triangles of no area."""
    vertices, faces = mesh.welded
    degenerate = len(mesh.faces) - int(area_vectors(vertices[faces]).any(1).sum())
    if mesh.is_solid:
        return Flaws(degenerate=degenerate, doubled=0, open=0, shared=0, turned=0, layers=False)
    n = len(vertices)
    # Three indices as one number would exceed 64 bits; the rank of the first two and the third do not.
    low, middle, high = np.sort(faces, axis=1).astype(np.int64).T
    _, pair = np.unique(low * n + middle, return_inverse=True)
    doubled = len(faces) - len(np.unique(pair * n + high))
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    keys, edge, counts = np.unique(edges.min(1) * n + edges.max(1), return_inverse=True, return_counts=True)
    # How many triangles run through an edge from its lower to its higher vertex: of two, one should.
    ahead = np.bincount(edge[edges[:, 0] < edges[:, 1]], minlength=len(keys))
    return Flaws(
        degenerate=degenerate,
        doubled=doubled,
        open=int((counts == 1).sum()),
        shared=int((counts > 2).sum()),
        turned=int(((counts == 2) & (ahead != 1)).sum()),
        layers=is_closed(faces) and signed_volume(vertices, faces) > 0,  # what else keeps it from being solid
    )


def _is_closed(faces: NDArray[np.int32]) -> bool:
    """Whether every directed edge of a surface (m, 3) occurs once and its reverse once."""
    start, end = faces.ravel().astype(np.int64), np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    there, back = (np.sort(a * (faces.max() + 1) + b) for a, b in ((start, end), (end, start)))
    return bool(np.array_equal(there, back) and (np.diff(there) > 0).all())


def _turned_alike(faces: NDArray[np.int32], neighbors: NDArray[np.int32], first: int) -> NDArray[np.int32]:
    """Triangles (m, 3) with the winding of the ``first`` one, propagated from neighbour to neighbour."""
    faces, waiting, seen = faces.copy(), [first], {first}
    while waiting:
        f = waiting.pop()
        edges = set(zip(faces[f].tolist(), np.roll(faces[f], -1).tolist(), strict=True))
        for g in set(neighbors[f].tolist()) - seen:
            if edges.intersection(zip(faces[g].tolist(), np.roll(faces[g], -1).tolist(), strict=True)):
                faces[g] = faces[g][::-1]
            seen.add(g)
            waiting.append(g)
    return faces


def signed_volume(vertices: Array, faces: NDArray[np.int32]) -> float:
    """Volume of a closed outward surface (divergence theorem): the sum of det(a, b, c) / 6 over triangles."""
    # About the mean: far from the origin the tetrahedra would be huge and cancel.
    v = vertices - vertices.mean(0)
    a, b, c = (v[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, cross(b, c)) / 6)


def has_layers(vertices: Array, faces: NDArray[np.int32]) -> bool:
    """Whether outward shells of a closed surface overlap by more than .001 of their volume: their sum counts twice.

    ``vertices`` (n, 3), welded ``faces`` (m, 3)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n = len(vertices)
    links = coo_matrix((np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())), (n, n))
    count, shell_of_vertex = connected_components(links, directed=False)
    if count == 1:
        return False
    shell = shell_of_vertex[faces[:, 0]]
    a, b, c = ((vertices - vertices.mean(0))[faces[:, k]] for k in range(3))
    volumes = np.bincount(shell, np.einsum("ij,ij->i", a, cross(b, c)) / 6, count)
    outward = np.flatnonzero(volumes > 0)
    shells = [_submesh(vertices, faces[shell == k]) for k in outward]
    return len(shells) > 1 and _united_volume(shells) < 0.999 * volumes[outward].sum()


def _submesh(vertices: Array, faces: NDArray[np.int32]) -> tuple[Array, NDArray[np.int32]]:
    used = np.unique(faces)
    return vertices[used], np.searchsorted(used, faces).astype(np.int32)


def _united_volume(solids: Sequence[tuple[Array, NDArray[np.int32]]]) -> float:
    """Volume of the union of closed surfaces."""
    vertices, faces = _united(solids)
    return signed_volume(vertices, faces)


def mass_properties(vertices: Array, faces: NDArray[np.int32]) -> MassProperties:
    """Exact polyhedral volume, centre and inertia of a closed outward surface (Eberly 2002, "Polyhedral Mass
    Properties")."""
    origin = vertices.mean(0)
    v = vertices - origin
    a, b, c = (v[faces[:, k]] for k in range(3))
    det = np.einsum("ij,ij->i", a, cross(b, c))
    volume = det.sum() / 6
    s = a + b + c
    center = (det[:, None] * s).sum(0) / 24 / volume
    second = sum(np.einsum("i,ij,ik->jk", det, p, p) for p in (a, b, c, s)) / 120
    covariance = second - volume * np.outer(center, center)
    inertia = np.trace(covariance) * np.eye(3) - covariance
    return MassProperties(volume=float(volume), center=center + origin, inertia=(inertia + inertia.T) / 2)


def solid_properties(mesh: Mesh, parts: Sequence[ConvexPart]) -> tuple[MassProperties, bool]:
    """Mass properties of the mesh if it is solid, otherwise of the union of its convex parts.

    Returns the properties at density 1 in the mesh's frame, and whether the mesh itself was used.
    """
    if mesh.is_solid:
        return mass_properties(*mesh.welded), True
    return mass_properties(*union(parts)), False


def union(parts: Sequence[ConvexPart]) -> tuple[Array, NDArray[np.int32]]:
    """Vertices and faces of the boolean union of convex parts (manifold3d)."""
    return _united([(p.vertices, p.faces) for p in parts])


def _united(solids: Sequence[tuple[Array, NDArray[np.int32]]]) -> tuple[Array, NDArray[np.int32]]:
    import manifold3d as mf

    # Manifold works in single precision for input meshes: centre and scale to keep its full resolution.
    everything = np.concatenate([v for v, _ in solids])
    center, size = everything.mean(0), float(np.ptp(everything, axis=0).max())
    manifolds = [mf.Manifold(mf.Mesh(((v - center) / size).astype(np.float32), f.astype(np.uint32))) for v, f in solids]
    merged = mf.Manifold.batch_boolean(manifolds, mf.OpType.Add).to_mesh()
    vertices = np.asarray(merged.vert_properties[:, :3], float) * size + center
    return vertices, np.asarray(merged.tri_verts, np.int32)
