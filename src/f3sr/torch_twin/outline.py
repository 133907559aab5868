"""The outline: where the edges of each item cross the lines through pixel centres, and what every crossing adds."""

from __future__ import annotations

from dataclasses import dataclass

import torch  # pyright: ignore[reportMissingImports]

from f3sr.raster import NEAR
from f3sr.torch_twin.batch import WEIGHTS, Batch, Tensor, pixels_at, spread, unravelled
from f3sr.torch_twin.mask import Points


@dataclass(frozen=True, eq=False, kw_only=True)
class Outline:
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


def outline_of(points: Points, mask: Tensor, batch: Batch, *, upright: bool) -> Outline:
    """Where the outline of ``mask`` (b, *canvas) crosses the rows, or, ``upright``, the columns."""
    item, edges = batch.stock.edges.taken(batch.which)
    edges = edges + points.starts[item][:, None]
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
    of, row, column = unravelled(cells, batch.canvas)
    return Outline(
        item=of, row=row, column=column, direction=direction, edge=edges[chosen], place=direction * farthest,
        upright=upright,
    )  # fmt: skip


def _crossings(points: Points, edges: Tensor, size: Tensor, *, upright: bool) -> tuple[Tensor, Tensor, Tensor]:
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
    edge, line = spread(torch.where(in_front, last - first + 1, 0).clamp(min=0).long())
    line = line + first[edge].long()
    a, b = a[edge], b[edge]
    t = (line + 0.5 - start[edge]) / (end[edge] - start[edge])
    place = pixel[a, along] + t * (pixel[b, along] - pixel[a, along])
    between = (place >= 0.5) & (place < size[edge, along] - 0.5)
    return edge[between], line[between], place[between]


@dataclass(frozen=True, eq=False, kw_only=True)
class Terms:
    """What each crossing adds, before the parameters: values (c, 5), ds w_k (c, 5), G (c, 12), ds stiffness (c, 1)."""

    item: Tensor
    value: Tensor
    w: Tensor
    G: Tensor
    h: Tensor


def terms_of(outline: Outline, points: Points, batch: Batch) -> Terms:
    upright, item, place = outline.upright, outline.item, outline.place
    nx, ny, ds = _normal(outline, points)
    beyond = place - 1 - (outline.row if upright else outline.column)
    over = (beyond >= 0).long()
    row, column = (outline.row + over, outline.column) if upright else (outline.row, outline.column + over)
    x, y = (outline.column + 0.5, place) if upright else (place, outline.row + 0.5)
    valid, mismatch, stiffness = pixels_at(batch, item, row, column)[:, WEIGHTS].unbind(1)
    w = torch.stack([torch.ones_like(valid), valid, valid * x, valid * y, mismatch], 1)
    return Terms(
        item=item,
        value=(ds * ds * outline.direction * beyond)[:, None] * w,
        w=ds[:, None] * w,
        G=_sweep(nx, ny, x, y, _depth(outline, points), batch.K[item]),
        h=(ds * stiffness)[:, None],
    )


def _normal(outline: Outline, points: Points) -> tuple[Tensor, Tensor, Tensor]:
    """The outward unit normal's x and y, and ds, its size along the line; no edge that crosses a line is a
    point."""
    dx, dy = (points.pixel[outline.edge[:, 1]] - points.pixel[outline.edge[:, 0]]).unbind(1)
    length = torch.sqrt(dx * dx + dy * dy)
    nx, ny = dy / length, -dx / length
    along = ny if outline.upright else nx
    outward = torch.where(along * outline.direction < 0, -1.0, 1.0)
    return outward * nx, outward * ny, along.abs()


def _depth(outline: Outline, points: Points) -> Tensor:
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
