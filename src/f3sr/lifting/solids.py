"""The families of shapes: closed triangle meshes over z = 0, posed upright in the world."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array
from f3sr.vision import rasterizer

if TYPE_CHECKING:
    from manifold3d import Manifold

Symmetry = Literal["", "box", "round"]
SECTORS = 40
"""Sides of a solid of revolution."""
CELLS = 8
"""Cells along each edge of a box's faces: textures are projected at their corners."""
FLAT = 0.3
"""Least width of an underside with an edge, over the whole solid's."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Solid:
    """A closed surface in the world: ``vertices`` (n, 3) [m], outward ``faces`` (m, 3)."""

    vertices: Array
    faces: NDArray[np.int32]
    pieces: tuple[Array, ...] = ()
    """Corners (n, 3) of convex pieces that hold it, where they are known."""
    rim: Array | None = None
    """Corners (n, 3) of the opening of what is hollow."""
    symmetry: Symmetry = ""
    """That of a box about its middle, or of a solid of revolution: the back looks as the front."""
    form: Array | None = None
    """Its vertices (n, 3) where it has that symmetry; None where ``vertices`` have it."""

    @property
    def symmetric(self) -> Array:
        """Its vertices (n, 3) where it has its symmetry."""
        return self.vertices if self.form is None else self.form

    def drawn(self, camera: Camera) -> rasterizer.Fragments:
        """What a camera sees of it alone."""
        ids = np.zeros(len(self.faces), np.int32)
        return rasterizer.rasterize(
            camera.to_camera(self.vertices), self.faces, ids, camera.K, camera.width, camera.height
        )

    @property
    def stands_flat(self) -> bool:
        """Whether its underside has an edge."""
        low = self.symmetric[:, 2] < self.symmetric[:, 2].min() + 1e-3 * np.ptp(self.symmetric[:, 2])
        whole = np.ptp(self.symmetric[:, :2], axis=0)
        return bool((np.ptp(self.symmetric[low, :2], axis=0) > FLAT * whole).all())


TIPS = 0.2
"""Least distance of the centre of mass from the base's border, over its height: less tips at a tilt of 11 degrees."""
CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
BOX_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6],
     [1, 3, 5], [3, 7, 5]], np.int32
)  # fmt: skip


def subdivided(solid: Solid, cells: int = CELLS) -> Solid:
    """Every triangle, and those of its form, in ``cells`` squared ones; flat as before."""
    barycentric = np.array([(i, j) for i in range(cells + 1) for j in range(cells + 1 - i)], float) / cells
    index = {(i, j): k for k, (i, j) in enumerate((i, j) for i in range(cells + 1) for j in range(cells + 1 - i))}
    small = [(index[i, j], index[i + 1, j], index[i, j + 1]) for i in range(cells) for j in range(cells - i)]
    small += [
        (index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]) for i in range(cells) for j in range(cells - 1 - i)
    ]

    def divided(vertices: Array) -> Array:
        a, b, c = (vertices[solid.faces[:, k]][:, None] for k in range(3))
        u, v = barycentric[:, 0, None], barycentric[:, 1, None]
        return (a + u * (b - a) + v * (c - a)).reshape(-1, 3)

    points = divided(solid.vertices)
    faces = (np.array(small) + len(barycentric) * np.arange(len(solid.faces))[:, None, None]).reshape(-1, 3)
    _, first, inverse = np.unique(np.round(points, 9), axis=0, return_index=True, return_inverse=True)
    return replace(
        solid,
        vertices=points[first],
        faces=inverse.reshape(-1)[faces].astype(np.int32),
        form=None if solid.form is None else divided(solid.form)[first],
    )


def revolved(centre: Array, profile: Array, sectors: int = SECTORS) -> Solid:
    """The closed surface of a profile (n, 2), radius and height, turned about the vertical through ``centre`` (3,).

    The profile runs from the axis below to the axis above, on the right of its way; its ends have radius 0."""
    angles = 2 * np.pi * np.arange(sectors) / sectors
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    inner = profile[1:-1]
    rings = np.concatenate(
        [inner[:, None, :1] * ring, np.broadcast_to(inner[:, None, 1:], (len(inner), sectors, 1))], axis=2
    ).reshape(-1, 3)
    ends = np.array([[0, 0, profile[0, 1]], [0, 0, profile[-1, 1]]])
    k, nxt = np.arange(sectors), (np.arange(sectors) + 1) % sectors
    faces = [np.column_stack([np.full(sectors, len(rings)), nxt, k])]
    for row in range(len(inner) - 1):
        low, high = row * sectors, (row + 1) * sectors
        faces += [np.column_stack([low + k, low + nxt, high + k]), np.column_stack([low + nxt, high + nxt, high + k])]
    last = (len(inner) - 1) * sectors
    faces.append(np.column_stack([last + k, last + nxt, np.full(sectors, len(rings) + 1)]))
    return Solid(vertices=np.concatenate([rings, ends]) + centre, faces=np.concatenate(faces).astype(np.int32))


def inflated(front: Array, back: Array, inside: NDArray[np.bool_]) -> Solid:
    """Two sheets over a grid, ``front`` and ``back`` (h, w, 3), with a wall along the border of ``inside`` (h, w).

    Cells all of whose corners are inside become surface, and half cells between two of them: without, borders would be
    stairs. Rows go down and columns to the right as the front is seen."""
    cells = _without_pinches(inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:])
    padded = np.pad(cells, 1)
    used = padded[:-1, :-1] | padded[:-1, 1:] | padded[1:, :-1] | padded[1:, 1:]
    n = int(used.sum())
    index = np.cumsum(used.ravel()).reshape(used.shape) - 1
    r, c = np.nonzero(cells)
    a, b, d, e = index[r, c], index[r, c + 1], index[r + 1, c], index[r + 1, c + 1]
    sheet = np.concatenate([np.column_stack([a, d, b]), np.column_stack([b, d, e]), *_half_cells(inside, cells, index)])
    # The border's edges, with the surface on their left: no triangle has them the other way.
    edges = np.concatenate([sheet[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    forward, reverse = edges @ [n, 1], edges @ [1, n]
    start, end = edges[~np.isin(forward, reverse)].T
    walls = [np.column_stack([start, start + n, end]), np.column_stack([end, start + n, end + n])]
    faces = np.concatenate([sheet, sheet[:, ::-1] + n, *walls])
    return Solid(vertices=np.concatenate([front[used], back[used]]), faces=faces.astype(np.int32))


def _half_cells(
    inside: NDArray[np.bool_], cells: NDArray[np.bool_], index: NDArray[np.int64]
) -> list[NDArray[np.int64]]:
    """Triangles (n, 3) of cells with one corner outside, for each of the four, both of whose legs are sides of whole
    cells."""
    whole = np.pad(cells, 1)
    corners = {(0, 0): inside[:-1, :-1], (1, 0): inside[1:, :-1], (1, 1): inside[1:, 1:], (0, 1): inside[:-1, 1:]}
    found = list[NDArray[np.int64]]()
    for down, right in corners:  # the one outside; legs meet in the opposite one
        three = np.all([there for at, there in corners.items() if at != (down, right)], axis=0)
        beside = whole[2:, 1:-1] if down == 0 else whole[:-2, 1:-1]
        across = whole[1:-1, 2:] if right == 0 else whole[1:-1, :-2]
        r, c = np.nonzero(three & ~cells & beside & across)
        found.append(np.column_stack([index[r + i, c + j] for i, j in corners if (i, j) != (down, right)]))
    return found


def _without_pinches(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells (h, w) where no two touch at a corner only: surfaces through such a point are not manifold."""
    while True:
        a, b, c, d = cells[:-1, :-1], cells[:-1, 1:], cells[1:, :-1], cells[1:, 1:]
        falling, rising = a & d & ~b & ~c, b & c & ~a & ~d
        if not (falling.any() or rising.any()):
            return cells
        cells = cells.copy()
        cells[1:, 1:] &= ~falling
        cells[1:, :-1] &= ~rising


def is_stable(solid: Solid) -> bool:
    """Whether it rests on its lowest points: its centre of mass is well above the middle of their hull."""
    from scipy.spatial import ConvexHull

    corners = solid.vertices[solid.faces]
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    centre = (volumes[:, None] * corners.sum(1)).sum(0) / (4 * volumes.sum())
    low, size = float(solid.vertices[:, 2].min()), float(np.ptp(solid.vertices, axis=0).max())
    base = solid.vertices[solid.vertices[:, 2] < low + 1e-3 * size, :2]
    if len(base) < 3 or np.linalg.matrix_rank(base - base[0], tol=1e-4 * size) < 2:
        return False
    hull = ConvexHull(base)
    inside = -(hull.equations[:, :2] @ centre[:2] + hull.equations[:, 2])
    return bool(inside.min() > TIPS * (centre[2] - low))


def clipped(solid: Solid, height: float) -> Solid | None:
    """The part above ``height`` [m]; None where that is nothing."""
    return _solid(_manifold(solid).trim_by_plane((0.0, 0.0, 1.0), height))


def joined(a: Solid, b: Solid) -> Solid | None:
    """The union of two solids."""
    return _solid(_manifold(a) + _manifold(b))


def common(a: Solid, b: Solid) -> Solid | None:
    """What is in both of two solids; None where that is nothing."""
    return _solid(_manifold(a) ^ _manifold(b))


def mirrored(solid: Solid, normal: Array, offset: float) -> Solid:
    """Its mirror image in the plane ``normal . x = offset``, ``normal`` (3,) of length 1."""
    beyond = solid.vertices @ normal - offset
    return replace(solid, vertices=solid.vertices - 2 * beyond[:, None] * normal, faces=solid.faces[:, ::-1])


def finer(solid: Solid, cell: float) -> Solid:
    """With edges of at most ``cell`` [m]; flat as before. It is not empty."""
    made = _solid(_manifold(solid).refine_to_length(cell))
    assert made is not None
    return made


def carved(solid: Solid, mask: NDArray[np.bool_], camera: Camera) -> Solid | None:
    """The part of a solid that ``camera`` sees inside a mask (h, w) of its picture, whatever is behind: a solid cut by
    the cone of the mask. None where nothing is left."""
    import manifold3d as mf

    depth = camera.to_camera(solid.vertices)[:, 2]
    near, far = 0.9 * float(depth.min()), 1.1 * float(depth.max())
    if near <= 0:
        return None
    runs = [run for row in range(len(mask)) for run in _runs(mask[row], row)]
    outline = mf.CrossSection(runs, mf.FillRule.NonZero).offset(0.01, mf.JoinType.Miter).simplify(SMOOTH)
    (fx, _, cx), (_, fy, cy), _ = camera.K
    rays = outline.translate((-cx, -cy)).scale((near / fx, near / fy))
    cone = mf.Manifold.extrude(rays, far - near, scale_top=(far / near, far / near)).translate((0, 0, near))
    cone = cone.transform(camera.T_world_camera[:3])
    return _solid(_manifold(solid) ^ cone)


SMOOTH = 0.6
"""Largest distance of a cone's outline from the mask's [px]: it rounds the steps of pixels."""


def _runs(row: NDArray[np.bool_], y: int) -> list[Array]:
    """Rectangles (4, 2) of the pixels of one row of a mask."""
    ends = np.flatnonzero(np.diff(np.pad(row, 1).astype(np.int8)))
    return [
        np.array([[a, y], [b, y], [b, y + 1], [a, y + 1]], float) for a, b in zip(ends[::2], ends[1::2], strict=True)
    ]


def _manifold(solid: Solid) -> Manifold:
    import manifold3d as mf

    return mf.Manifold(mf.Mesh(solid.vertices.astype(np.float32), solid.faces.astype(np.uint32)))


def _solid(made: Manifold) -> Solid | None:
    if made.is_empty():
        return None
    mesh = made.to_mesh()
    faces = np.asarray(mesh.tri_verts, np.int32)
    return Solid(vertices=np.asarray(mesh.vert_properties[:, :3], float), faces=faces)
