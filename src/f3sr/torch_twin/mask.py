"""The hard mask: which pixel centres the triangles of each item cover, by the edge functions of ``raster``."""

from __future__ import annotations

from dataclasses import dataclass

import torch  # pyright: ignore[reportMissingImports]

from f3sr.raster import NEAR
from f3sr.torch_twin.batch import SUMS, Batch, Tensor, pixels_at, spread, unravelled
from f3sr.triangles import PAD, ROUNDING

ENDS = 2
"""Pixels that the end of a span, solved for, may lie too far out."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Points:
    """Projected vertices of all items."""

    homogeneous: Tensor
    """(n, 3): K X, its last column the depth z [m]."""
    pixel: Tensor
    """(n, 2): x and y [px]; means nothing where z < NEAR."""
    starts: Tensor
    """(b,): where an item's vertices begin."""


def projected(batch: Batch) -> Points:
    item, world = batch.stock.vertices.taken(batch.which)
    counts = batch.stock.vertices.counts[batch.which]
    motion, K = batch.motion[item], batch.K[item]
    X = (motion[:, :, :3] * world[:, None]).sum(2) + motion[:, :, 3]
    homogeneous = (K * X[:, None]).sum(2)
    pixel = homogeneous[:, :2] / homogeneous[:, 2:].clamp(min=NEAR)
    return Points(homogeneous=homogeneous, pixel=pixel, starts=torch.cumsum(counts, 0) - counts)


def hard_mask(points: Points, batch: Batch) -> Tensor:
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


def _box(points: Points, faces: Tensor, size: Tensor) -> tuple[Tensor, Tensor]:
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
    triangle, row = spread((last - first)[:, 1].long() + 1)
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


def runs(mask: Tensor, batch: Batch) -> tuple[Tensor, Tensor]:
    """Items (n,) and what the ends of runs of the mask add to the values (n, 5)."""
    change = torch.diff(mask.flatten().to(torch.int8), prepend=torch.zeros(1, dtype=torch.int8, device=mask.device))
    place = torch.nonzero(change)[:, 0]
    item, row, column = unravelled(place, batch.canvas)
    valid, moment, mismatch = pixels_at(batch, item, row, column)[:, SUMS].unbind(1)
    sums = torch.stack([column.double(), valid, moment, valid * (row + 0.5), mismatch], 1)
    return item, -change[place].double()[:, None] * sums
