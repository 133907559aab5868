"""The silhouette integrals in torch, those of many objects at once: what a GPU computes, and the readable twin that
checks the compiled kernels of ``raster`` and ``contour``.

The mathematics is theirs. Pixels whose centres a triangle covers form the hard mask S. By rows, S is a set of runs, so
that the sum of a field w over it needs no pixel but those where runs end, with C(r, c) = sum of w(r, c') over c' < c:

    sum over S of w = sum over the ends of runs of C - sum over their starts of C.

The outline crosses the lines through pixel centres where projected edges do, the farthest out in every pair of
neighbours of which one is inside. With d = 1 where the inside comes first and -1 elsewhere, b the way from the border
of the two pixels to the crossing, n the outward normal and ds = |n_x| on rows, |n_y| on columns, the integrals are

    F_k = sum over S of w_k + sum over crossings of ds^2 d b w_k,
    dF_k/dtheta_p = sum over crossings of ds w_k J_p     (Reynolds' transport theorem),
    H_pq = sum over crossings of ds stiffness J_p J_q.

Parameters move points X in camera axes by M_p (X, 1), affine fields (3, 4). So J_p = n . dpi/dX . M_p (X, 1) is the
product M_p : G of two matrices, of which G = (n . dpi/dX) (X, 1)^T knows nothing of parameters: it is G that is summed.

Lists of objects of all sizes lie one after the other, ``item`` telling whose a row is. What threads add to in any order
are whole numbers and maxima; floating-point sums run over one object's rows in their order, so that a device gives the
same bytes again. Sums of an object alone and among others differ by rounding. All is float64: in float32 edges crack,
which moved a gradient by two percent on one real mesh of eight.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray

from f3sr.contour import Integrals
from f3sr.frames import Array
from f3sr.raster import NEAR, PAD, ROUNDING
from f3sr.silhouette_fit import ObjectFit

Tensor: TypeAlias = Any
"""A torch tensor: pyright sees torch only where it is installed."""

LARGEST_BATCH = 2_000_000
"""Triangles in one batch, with a sixteenth of its pixels: about 1 GB (450 bytes each, measured on a CPU)."""
ENDS = 2
"""Pixels that the end of a span, solved for, may lie too far out."""

WEIGHTS = slice(0, 3)
"""Columns of a pixel: valid, mismatch and stiffness,"""
SUMS = slice(3, 6)
"""and the sums over the pixels before it in its row of valid, valid x and mismatch."""

Question = tuple[ObjectFit, Array]


class TorchIntegrals:
    """Answers searches of objects' fits on one device, all their questions at once.

    Meshes and fields are sent to the device when first asked about and stay until this is dropped.
    """

    def __init__(self, device: str) -> None:
        self.device = device
        self._stock = _Stock.empty(device)

    def __call__(self, questions: Sequence[Question]) -> list[Integrals]:
        """As ``silhouette_fit.one_by_one``."""
        with torch.inference_mode():
            self._stock = self._stock.with_fits(fit for fit, _ in questions)
            return [found for group in _groups(questions) for found in _integrals(_Batch.of(self._stock, group))]


def name_of(device: str) -> str:
    """A device in words."""
    found = torch.cuda.get_device_name(device) if device == "cuda" else "the CPU"
    return f"{found} through torch {torch.__version__}"


def _groups(questions: Sequence[Question]) -> Iterator[list[Question]]:
    """The questions, as many at a time as a device may hold."""
    group, size = list[Question](), 0
    for question in questions:
        surface, camera = question[0].surface, question[0].camera
        cost = len(surface.faces) + camera.width * camera.height // 16
        if group and size + cost > LARGEST_BATCH:
            yield group
            group, size = [], 0
        group.append(question)
        size += cost
    if group:
        yield group


# --- what lies on the device --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class _Lists:
    """Lists of rows (n, k), one after the other: list i is ``rows[starts[i] : starts[i] + counts[i]]``."""

    rows: Tensor
    starts: Tensor
    counts: Tensor

    def plus(self, several: Sequence[NDArray[Any]]) -> _Lists:
        """These and some lists more."""
        sent = [torch.tensor(rows, dtype=self.rows.dtype, device=self.rows.device) for rows in several]
        counts = torch.tensor([len(rows) for rows in several], device=self.rows.device)
        return _Lists(
            rows=torch.cat([self.rows, *sent]),
            starts=torch.cat([self.starts, len(self.rows) + torch.cumsum(counts, 0) - counts]),
            counts=torch.cat([self.counts, counts]),
        )

    def taken(self, which: Tensor) -> tuple[Tensor, Tensor]:
        """The lists of these indices (b,), one after the other: whose (n,) in 0..b - 1 each row is, and the rows."""
        item, place = _spread(self.counts[which])
        return item, self.rows[self.starts[which][item] + place]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Stock:
    """Surfaces and fields of some fits: all that no parameter changes."""

    index: dict[ObjectFit, int]
    vertices: _Lists
    """(n, 3) in the world [m]."""
    faces: _Lists
    """(m, 3) into a surface's own vertices."""
    edges: _Lists
    """(e, 2) likewise."""
    pixels: _Lists
    """(h (w + 1), 6) by row and column: WEIGHTS and SUMS; the last of a row lies beyond the image."""

    @classmethod
    def empty(cls, device: str) -> _Stock:
        def none(columns: int, dtype: Any) -> _Lists:
            whole = torch.zeros(0, dtype=torch.int64, device=device)
            return _Lists(rows=torch.zeros((0, columns), dtype=dtype, device=device), starts=whole, counts=whole)

        return cls(
            index={},
            vertices=none(3, torch.float64),
            faces=none(3, torch.int64),
            edges=none(2, torch.int64),
            pixels=none(6, torch.float64),
        )

    def with_fits(self, fits: Iterable[ObjectFit]) -> _Stock:
        """This and what it does not hold yet."""
        new = [fit for fit in dict.fromkeys(fits) if fit not in self.index]
        if not new:
            return self
        return _Stock(
            index=self.index | {fit: len(self.index) + k for k, fit in enumerate(new)},
            vertices=self.vertices.plus([fit.surface.vertices for fit in new]),
            faces=self.faces.plus([fit.surface.faces for fit in new]),
            edges=self.edges.plus([fit.surface.edges for fit in new]),
            pixels=self.pixels.plus([_pixel_rows(fit) for fit in new]),
        )


def _pixel_rows(fit: ObjectFit) -> Array:
    """(h (w + 1), 6): the fields of a fit and their sums along rows."""
    fields, (h, w) = fit.target.fields, fit.target.mask.shape
    valid, mismatch = fields.valid.astype(float), fields.mismatch.astype(float)
    summed = np.stack([valid, valid * (np.arange(w) + 0.5), mismatch], axis=-1)
    rows = np.zeros((h, w + 1, 6))
    rows[:, :w, WEIGHTS] = np.stack([valid, mismatch, fields.stiffness], axis=-1)
    rows[:, 1:, SUMS] = np.cumsum(summed, axis=1)
    return rows.reshape(-1, 6)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Batch:
    """b questions: which fits of the stock, and where their parameters put them."""

    stock: _Stock
    which: Tensor
    """(b,) indices of fits."""
    motion: Tensor
    """(b, 3, 4): points of the world to camera axes, as the parameters move them."""
    velocities: Tensor
    """(b, p, 12): the fields M_p."""
    K: Tensor
    """(b, 3, 3) [px]."""
    size: Tensor
    """(b, 2): width and height [px]."""
    canvas: tuple[int, int]
    """Rows and columns that hold every image, with a column beyond."""

    @classmethod
    def of(cls, stock: _Stock, questions: Sequence[Question]) -> _Batch:
        cameras = [fit.camera for fit, _ in questions]

        def sent(values: Iterable[Any], dtype: Any) -> Tensor:
            return torch.tensor(np.array(list(values)), dtype=dtype, device=stock.vertices.rows.device)

        return cls(
            stock=stock,
            which=sent((stock.index[fit] for fit, _ in questions), torch.int64),
            motion=sent((_motion(fit, u) for fit, u in questions), torch.float64),
            velocities=sent((fit.freedom.velocities(u, fit.camera) for fit, u in questions), torch.float64).flatten(2),
            K=sent((c.K for c in cameras), torch.float64),
            size=sent(((c.width, c.height) for c in cameras), torch.int64),
            canvas=(max(c.height for c in cameras), max(c.width for c in cameras) + 1),
        )


def _motion(fit: ObjectFit, u: Array) -> Array:
    T, s = fit.freedom.similarity(u)
    motion = (fit.camera.T_camera_world @ T)[:3]
    return np.column_stack([s * motion[:, :3], motion[:, 3]])


def _spread(counts: Tensor) -> tuple[Tensor, Tensor]:
    """For lists of these lengths (b,), one after the other: whose each row is, and its place there."""
    item = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)
    return item, torch.arange(len(item), device=counts.device) - (torch.cumsum(counts, 0) - counts)[item]


# --- the integrals ------------------------------------------------------------------------------------------------


def _integrals(batch: _Batch) -> list[Integrals]:
    """One per question."""
    points = _projected(batch)
    mask = _mask(points, batch)
    value = _summed(*_runs(mask, batch), count=len(batch.which)).sum(1)
    moment, square = 0, 0
    edge_item, edges = batch.stock.edges.taken(batch.which)
    edges = edges + points.starts[edge_item][:, None]
    for upright in (False, True):
        terms = _terms(_outline(points, edge_item, edges, mask, batch, upright=upright), points, batch)
        w, G, h = (_summed(terms.item, rows, count=len(batch.which)) for rows in (terms.w, terms.G, terms.h))
        value = value + _summed(terms.item, terms.value, count=len(batch.which)).sum(1)
        moment = moment + w.mT @ G
        square = square + (h * G).mT @ G
    gradient = moment @ batch.velocities.mT
    curvature = batch.velocities @ square @ batch.velocities.mT
    found = (t.cpu().numpy() for t in (value, gradient, curvature))
    return [Integrals(value=F, gradient=dF, curvature=H) for F, dF, H in zip(*found, strict=True)]


def _summed(item: Tensor, rows: Tensor, *, count: int) -> Tensor:
    """Rows (n, k) of sorted items as (count, longest, k), filled up with zeros: ready to be summed over the middle."""
    counts = torch.bincount(item, minlength=count)
    place = torch.arange(len(item), device=item.device) - (torch.cumsum(counts, 0) - counts)[item]
    out = torch.zeros((count, int(counts.max()), rows.shape[1]), dtype=rows.dtype, device=rows.device)
    out[item, place] = rows
    return out


# --- the hard mask ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class _Points:
    """Projected vertices of all items."""

    homogeneous: Tensor
    """(n, 3): K X, its last column the depth z [m]."""
    pixel: Tensor
    """(n, 2): x and y [px]; means nothing where z < NEAR."""
    starts: Tensor
    """(b,): where an item's vertices begin."""


def _projected(batch: _Batch) -> _Points:
    item, world = batch.stock.vertices.taken(batch.which)
    counts = batch.stock.vertices.counts[batch.which]
    motion, K = batch.motion[item], batch.K[item]
    X = (motion[:, :, :3] * world[:, None]).sum(2) + motion[:, :, 3]
    homogeneous = (K * X[:, None]).sum(2)
    pixel = homogeneous[:, :2] / homogeneous[:, 2:].clamp(min=NEAR)
    return _Points(homogeneous=homogeneous, pixel=pixel, starts=torch.cumsum(counts, 0) - counts)


def _mask(points: _Points, batch: _Batch) -> Tensor:
    """(b, *canvas): whether a triangle covers a pixel's centre. Runs add 1 where they begin and take it where they end;
    what has been added up to a pixel is how often it is covered."""
    item, faces = batch.stock.faces.taken(batch.which)
    faces = faces + points.starts[item][:, None]
    first, last = _box(points, faces, batch.size[item])
    kept = torch.nonzero((first <= last).all(1))[:, 0]
    corners = points.homogeneous[faces[kept]]
    determinant = _determinant(corners).abs()
    real = (determinant > 0) & (determinant < torch.inf)
    kept, corners = kept[real], corners[real]
    row, run, left, right = _spans(corners, first[kept], last[kept], batch.size[item[kept]])

    height, width = batch.canvas
    line = (item[kept][row] * height + run) * width
    changes = torch.zeros(len(batch.which) * height * width, dtype=torch.int32, device=line.device)
    one = torch.ones_like(line, dtype=torch.int32)
    changes.index_add_(0, line + left, one).index_add_(0, line + right + 1, -one)
    return torch.cumsum(changes.view(-1, height, width), 2, dtype=torch.int32) > 0


def _box(points: _Points, faces: Tensor, size: Tensor) -> tuple[Tensor, Tensor]:
    """First and last column and row (m, 2) of the pixel centres around each triangle's part before the near plane,
    first > last where there are none."""
    inside = (points.homogeneous[:, 2] >= NEAR)[:, None]
    low = torch.where(inside, points.pixel, torch.inf)[faces].amin(1)
    high = torch.where(inside, points.pixel, -torch.inf)[faces].amax(1)
    depth = points.homogeneous[:, 2][faces]
    cut = torch.nonzero((depth.amin(1) < NEAR) & (depth.amax(1) >= NEAR))[:, 0]
    cuts = _near_cuts(points.homogeneous[faces[cut]])
    low[cut] = torch.minimum(low[cut], cuts.nan_to_num(torch.inf).amin(1)) - 1
    high[cut] = torch.maximum(high[cut], cuts.nan_to_num(-torch.inf).amax(1)) + 1
    first = torch.ceil(low - 0.5 - PAD).clamp(min=0)
    last = torch.minimum(torch.floor(high - 0.5 + PAD), size - 1.0)
    return first, last


def _near_cuts(corners: Tensor) -> Tensor:
    """The pixels (m, 3, 2) where the sides of triangles (m, 3, 3) pierce the near plane, nan where they do not."""
    p, q = corners, corners[:, [1, 2, 0]]
    t = (NEAR - p[..., 2:]) / (q[..., 2:] - p[..., 2:])
    pierced = (p[..., 2:] >= NEAR) != (q[..., 2:] >= NEAR)
    return torch.where(pierced, (p[..., :2] + t * (q[..., :2] - p[..., :2])) / NEAR, torch.nan)


def _determinant(corners: Tensor) -> Tensor:
    """a . ((b - a) x (c - a)) of triangles (m, 3, 3) in K X."""
    a = corners[:, 0]
    return _dot(a, _cross(corners[:, 1] - a, corners[:, 2] - a))


def _dot(p: Tensor, q: Tensor) -> Tensor:
    return p[..., 0] * q[..., 0] + p[..., 1] * q[..., 1] + p[..., 2] * q[..., 2]


def _cross(p: Tensor, q: Tensor) -> Tensor:
    (a, b, c), (x, y, z) = p.unbind(-1), q.unbind(-1)
    return torch.stack([b * z - c * y, c * x - a * z, a * y - b * x], -1)


def _edge_functions(corners: Tensor, longest: Tensor) -> Tensor:
    """(m, 4, 3): the functions of q = (x, y, 1) that are >= 0 in a triangle, those of its sides and of the near plane.

    Those of the sides are raised by what rounding can do to them at pixels up to ``longest`` (m,), so that sides and
    corners that triangles share do not crack.
    """
    p, q = corners[:, [1, 2, 0]], corners[:, [2, 0, 1]]
    absolute = torch.stack([  # sums of the two products of which the cross product has differences
        p[..., 1] * q[..., 2], p[..., 2] * q[..., 1], p[..., 2] * q[..., 0], p[..., 0] * q[..., 2],
    ]).abs().sum(0)  # fmt: skip
    constant = (p[..., 0] * q[..., 1]).abs() + (p[..., 1] * q[..., 0]).abs()
    sides = torch.sign(_determinant(corners))[:, None, None] * _cross(p, q)
    sides[..., 2] += ROUNDING * (absolute * longest[:, None] + constant)
    ahead = corners[..., 2:] - NEAR
    plane = (ahead * sides).sum(1, keepdim=True)
    return torch.cat([sides, torch.where(ahead.amin(1, keepdim=True) >= 0, 0.0, plane)], 1)


def _spans(corners: Tensor, first: Tensor, last: Tensor, size: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The rows of pixels in triangles: which triangle (n,), row, first and last column of each.

    Along a row an edge function is monotone: its zero is solved for, then both ends are tested exactly.
    """
    functions = _edge_functions(corners, size.amax(1).double())
    triangle, row = _spread((last - first)[:, 1].long() + 1)
    row = row + first[triangle, 1].long()
    slope = functions[triangle, :, 0]
    constant = functions[triangle, :, 1] * (row + 0.5)[:, None] + functions[triangle, :, 2]
    zero = -constant / slope - 0.5
    left = torch.where(slope > 0, torch.floor(zero), -torch.inf).amax(1).maximum(first[triangle, 0])
    right = torch.where(slope < 0, torch.ceil(zero), torch.inf).amin(1).minimum(last[triangle, 0])

    def inside(column: Tensor) -> Tensor:
        return (slope * (column + 0.5)[:, None] + constant >= 0).all(1)

    for _ in range(ENDS):
        left, right = left + ~inside(left), right - (~inside(right)).double()
    found = (left <= right) & inside(left) & inside(right)
    return triangle[found], row[found], left[found].long(), right[found].long()


def _runs(mask: Tensor, batch: _Batch) -> tuple[Tensor, Tensor]:
    """Items (n,) and what the ends of runs of the mask add to the values (n, 5)."""
    change = torch.diff(mask.flatten().to(torch.int8), prepend=torch.zeros(1, dtype=torch.int8, device=mask.device))
    place = torch.nonzero(change)[:, 0]
    item, row, column = _unravelled(place, batch.canvas)
    valid, moment, mismatch = _pixels(batch, item, row, column)[:, SUMS].unbind(1)
    sums = torch.stack([column.double(), valid, moment, valid * (row + 0.5), mismatch], 1)
    return item, -change[place].double()[:, None] * sums


def _unravelled(place: Tensor, canvas: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
    """Item, row and column of a place in the flat mask."""
    height, width = canvas
    return place // (height * width), place // width % height, place % width


def _pixels(batch: _Batch, item: Tensor, row: Tensor, column: Tensor) -> Tensor:
    """The fields (n, 6) at pixels."""
    start = batch.stock.pixels.starts[batch.which][item]
    return batch.stock.pixels.rows[start + row * (batch.size[item, 0] + 1) + column]


# --- the outline --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class _Outline:
    """Where outlines cross the rows of pixel centres, or, ``upright``, the columns; (c,) each, sorted by item."""

    item: Tensor
    row: Tensor
    column: Tensor
    """Of the first of the two pixels."""
    direction: Tensor
    """1 where it is the inside one, else -1."""
    edge: Tensor
    """(c, 2) vertices of the edge that crosses farthest out; of equal ones the first."""
    place: Tensor
    """Where it crosses along the line [px]."""
    upright: bool


def _outline(points: _Points, item: Tensor, edges: Tensor, mask: Tensor, batch: _Batch, *, upright: bool) -> _Outline:
    """``edges`` (e, 2) and whose (e,) they are."""
    edge, line, place = _crossings(points, edges, batch.size[item], upright=upright)
    step = (place - 0.5).long()
    row, column = (step, line) if upright else (line, step)
    height, width = batch.canvas
    cell = (item[edge] * height + row) * width + column
    flat = mask.flatten()
    border = flat[cell] != flat[cell + (width if upright else 1)]
    cell, edge, place = cell[border], edge[border], place[border]

    cells, owner = torch.unique(cell, return_inverse=True)
    direction = 2 * flat[cells].double() - 1
    outward = direction[owner] * place
    farthest = torch.full_like(direction, -torch.inf).scatter_reduce_(0, owner, outward, "amax")
    candidates = torch.where(outward == farthest[owner], edge, len(edges))
    chosen = torch.full_like(cells, len(edges)).scatter_reduce_(0, owner, candidates, "amin")
    of, row, column = _unravelled(cells, batch.canvas)
    return _Outline(
        item=of, row=row, column=column, direction=direction, edge=edges[chosen], place=direction * farthest,
        upright=upright,
    )  # fmt: skip


def _crossings(points: _Points, edges: Tensor, size: Tensor, *, upright: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Where edges in front of the near plane cross lines of pixel centres between two pixels of the image: the edge
    (n,), the row or, ``upright``, the column, and the place along it [px]."""
    along, over = int(upright), int(not upright)
    a, b = edges.unbind(1)
    pixel = points.pixel
    swapped = pixel[a, over] > pixel[b, over]
    a, b = torch.where(swapped, b, a), torch.where(swapped, a, b)
    start, end = pixel[a, over], pixel[b, over]
    first = torch.ceil(start - 0.5).clamp(min=0)
    last = torch.minimum(torch.ceil(end - 0.5), size[:, over]) - 1
    in_front = (points.homogeneous[:, 2] > NEAR)[edges].all(1)
    edge, line = _spread(torch.where(in_front, last - first + 1, 0).clamp(min=0).long())
    line = line + first[edge].long()
    a, b = a[edge], b[edge]
    t = (line + 0.5 - start[edge]) / (end[edge] - start[edge])
    place = pixel[a, along] + t * (pixel[b, along] - pixel[a, along])
    between = (place >= 0.5) & (place < size[edge, along] - 0.5)
    return edge[between], line[between], place[between]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Terms:
    """What each crossing adds, before the parameters: values (c, 5), ds w_k (c, 5), G (c, 12), ds stiffness (c, 1)."""

    item: Tensor
    value: Tensor
    w: Tensor
    G: Tensor
    h: Tensor


def _terms(outline: _Outline, points: _Points, batch: _Batch) -> _Terms:
    upright, item, place = outline.upright, outline.item, outline.place
    nx, ny, ds = _normal(outline, points)
    beyond = place - 1 - (outline.row if upright else outline.column)
    over = (beyond >= 0).long()
    row, column = (outline.row + over, outline.column) if upright else (outline.row, outline.column + over)
    x, y = (outline.column + 0.5, place) if upright else (place, outline.row + 0.5)
    valid, mismatch, stiffness = _pixels(batch, item, row, column)[:, WEIGHTS].unbind(1)
    w = torch.stack([torch.ones_like(valid), valid, valid * x, valid * y, mismatch], 1)
    return _Terms(
        item=item,
        value=(ds * ds * outline.direction * beyond)[:, None] * w,
        w=ds[:, None] * w,
        G=_sweep(nx, ny, x, y, _depth(outline, points), batch.K[item]),
        h=(ds * stiffness)[:, None],
    )


def _normal(outline: _Outline, points: _Points) -> tuple[Tensor, Tensor, Tensor]:
    """The outward unit normal's x and y, and ds, its size along the line; no edge that crosses a line is a
    point."""
    dx, dy = (points.pixel[outline.edge[:, 1]] - points.pixel[outline.edge[:, 0]]).unbind(1)
    length = torch.sqrt(dx * dx + dy * dy)
    nx, ny = dy / length, -dx / length
    along = ny if outline.upright else nx
    outward = torch.where(along * outline.direction < 0, -1.0, 1.0)
    return outward * nx, outward * ny, along.abs()


def _depth(outline: _Outline, points: _Points) -> Tensor:
    """Depth z [m] of the surface at the crossings: its inverse is linear along an edge's image."""
    over = int(not outline.upright)
    a, b = outline.edge.unbind(1)
    line = (outline.column if outline.upright else outline.row) + 0.5
    start, end = points.pixel[a, over], points.pixel[b, over]
    far, near = 1 / points.homogeneous[a, 2], 1 / points.homogeneous[b, 2]
    return 1 / (far + (line - start) / (end - start) * (near - far))


def _sweep(nx: Tensor, ny: Tensor, x: Tensor, y: Tensor, z: Tensor, K: Tensor) -> Tensor:
    """G (c, 12) = (n . dpi/dX) (X, 1)^T at pixels x, y of depth z."""
    Y = (y - K[:, 1, 2]) * z / K[:, 1, 1]
    X = ((x - K[:, 0, 2]) * z - K[:, 0, 1] * Y) / K[:, 0, 0]
    gx, gy = nx * K[:, 0, 0] / z, (nx * K[:, 0, 1] + ny * K[:, 1, 1]) / z
    g = torch.stack([gx, gy, -(gx * X + gy * Y) / z], 1)
    return (g[:, :, None] * torch.stack([X, Y, z, torch.ones_like(z)], 1)[:, None]).flatten(1)
