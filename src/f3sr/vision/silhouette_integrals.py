"""Integrals over a silhouette, with their exact derivatives, from where its outline crosses the pixel grid.

Every term of the losses (equations 7 and 9) is a function of five integrals over the silhouette S,

    F_k = integral over S of w_k(x),   w = (1, valid, valid x, valid y, valid (1 - 2 mask + lambda D)).

When the points of the surface move, an integral changes by what its outline sweeps (Reynolds' transport theorem):

    dF_k/dtheta = integral over the outline of w_k (v . n) ds,

n the outward normal in the image, v = d(image point)/d(theta). The outline is sampled where it crosses the lines
through the pixel centres. Note that |n_x| ds = dy and |n_y| ds = dx. So crossings with rows, weighted by |n_x|, and
with columns, weighted by |n_y|, together measure ds = (n_x^2 + n_y^2) ds. Neither alone sees all directions.

A crossing lies between two neighbouring pixel centres, one inside the hard mask and one outside. It is the outermost
crossing of a projected edge with the line between the two. Adjacency, orientation and depth of the triangles are not
needed. So triangle soups, open shells and unions of objects work too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.runtime.kernels import inline_kernel, kernel

AREA, VALID, MOMENT_X, MOMENT_Y, MISMATCH = range(5)
"""Rows of ``Integrals.value`` and ``Integrals.gradient``."""
TILE = 8
"""Pixels along a side of the tiles that edges are sorted out by: fine meshes have edges about so long."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Fields:
    """What is integrated, by pixel (h, w) float32: ``valid``, ``mismatch`` and ``stiffness``, the weight of the
    curvature."""

    valid: NDArray[np.float32]
    mismatch: NDArray[np.float32]
    stiffness: NDArray[np.float32]


@dataclass(frozen=True, eq=False, kw_only=True)
class Integrals:
    """``value`` (5,), ``gradient`` (5, p) and ``curvature`` (p, p), over p parameters.

    Rows are AREA to MISMATCH, in pixels, pixels times pixels for the moments. The curvature is the integral over the
    outline of stiffness * J J^T with J = v . n."""

    value: Array
    gradient: Array
    curvature: Array


def unique_edges(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Every edge (e, 2) of some triangles (m, 3) once, the lower vertex first, sorted."""
    # One number per pair, low * base + high: ``unique`` of numbers is much faster than of rows. int64, as it can exceed
    # 2^31.
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.int64)
    base = pairs[:, 1].max(initial=0) + 1
    return np.column_stack(np.divmod(np.unique(pairs[:, 0] * base + pairs[:, 1]), base)).astype(np.int32)


def of_pixels(mask: NDArray[np.bool_], fields: Fields) -> Array:
    """The integrals (5,) over the pixels of a mask (h, w), without what its outline covers of other pixels."""
    value = np.zeros(5)
    valid, mismatch = map(np.ascontiguousarray, (fields.valid, fields.mismatch))
    _sum_inside(np.ascontiguousarray(mask), valid, mismatch, value)
    return value


def integrate(
    points_camera: Array,
    edges: NDArray[np.int32],
    mask: NDArray[np.bool_],
    K: Array,
    fields: Fields,
    velocities: Array,
    *,
    near: float,
) -> Integrals:
    """The integrals over a silhouette and their derivatives.

    ``points_camera`` (n, 3) [m] with ``edges`` (e, 2), drawn as ``mask`` (h, w) by the camera of ``K`` [px].
    ``velocities`` (p, 3, 4) [m per unit of each parameter] are affine fields in camera axes: a point X moves by
    ``velocity @ (X, 1)``. Edges that reach behind ``near`` are left out, and, rightly, what the image's border cuts.
    """
    # Kernels are compiled once per layout: one layout for all callers, and a matrix that is not read-only.
    matrix, mask = np.array(K), np.ascontiguousarray(mask)
    points_camera, velocities = map(np.ascontiguousarray, (points_camera, velocities))
    valid, mismatch, stiffness = map(np.ascontiguousarray, (fields.valid, fields.mismatch, fields.stiffness))
    pixels, inverse_depth = np.empty((len(points_camera), 2)), np.empty(len(points_camera))
    _project(points_camera, matrix, near, pixels, inverse_depth)
    edges = _at_outline(pixels, inverse_depth, edges, mask)
    value, gradient, curvature = (
        of_pixels(mask, fields),
        np.zeros((5, len(velocities))),
        np.zeros((len(velocities),) * 2),
    )
    # Rows of pixel centres see the part |n_x| ds of the outline, columns the part |n_y| ds.
    for upright in (False, True):
        outline = _outline(pixels, inverse_depth, edges, mask, upright=upright)
        _sum_outline(
            *outline, pixels, inverse_depth, edges, matrix, velocities, upright,
            valid, mismatch, stiffness, value, gradient, curvature,
        )  # fmt: skip
    return Integrals(value=value, gradient=gradient, curvature=curvature)


def _at_outline(
    pixels: Array, inverse_depth: Array, edges: NDArray[np.int32], mask: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """The edges (k, 2) that may cross the outline, in their order: most lie inside the silhouette."""
    # Tile i, j holds the places between the pixel centres from (i, j) * TILE to one tile farther, these included.
    rows, columns = (max(1, -(-(n - 1) // TILE)) for n in mask.shape)
    inside = np.zeros((rows, columns), np.int32)
    _count_in_tiles(mask, inside)
    # Pixel centres per tile: TILE + 1, as borders are shared, and fewer at the picture's end.
    heights, widths = (
        np.minimum(np.arange(k) * TILE + TILE + 1, n) - np.arange(k) * TILE
        for k, n in zip((rows, columns), mask.shape, strict=True)
    )
    # Only where some centres are inside and some outside can the outline pass between two of them.
    mixed = (inside > 0) & (inside < np.outer(heights, widths))
    chosen = np.empty((len(edges), 2), np.int32)
    return chosen[: _choose(pixels, inverse_depth, edges, mixed, chosen)]


def _outline(
    pixels: Array, inverse_depth: Array, edges: NDArray[np.int32], mask: NDArray[np.bool_], *, upright: bool
) -> tuple[NDArray[np.int32], NDArray[np.int32], Array]:
    """Where the outline crosses the rows of pixel centres, or, ``upright``, the columns.

    For every boundary between neighbouring pixels that some edge crosses: (c, 3) row, column and direction (1 where the
    inside comes first) of the boundary, (c,) the edge, and (c,) the place of the crossing along the line [px].
    """
    cells = np.empty((_count_boundaries(mask, upright), 3), np.int32)
    crossed, place = np.empty(len(cells), np.int32), np.empty(len(cells))
    owner = np.full(mask.shape, -1, np.int32)
    found = _cross(pixels, inverse_depth, edges, mask, upright, owner, cells, crossed, place)
    return cells[:found], crossed[:found], place[:found]


def warm_up() -> None:
    """Call every kernel once, with the types that the product uses."""
    points = np.array([[0.0, 0, 1], [3, 0, 1], [0, 3, 1]])
    edges = unique_edges(np.array([[0, 1, 2]], np.int32))
    ones = np.ones((4, 4), np.float32)
    mask = np.tri(4, 4, -1, bool)[::-1]
    fields = Fields(valid=ones, mismatch=ones, stiffness=ones)
    integrate(points, edges, mask, np.eye(3), fields, np.zeros((1, 3, 4)), near=0.1)


@kernel
def _sum_inside(
    mask: NDArray[np.bool_], valid: NDArray[np.float32], mismatch: NDArray[np.float32], value: Array
) -> None:
    """Add the sums over the pixels of the hard mask."""
    for r in range(mask.shape[0]):
        for c in range(mask.shape[1]):
            if mask[r, c]:
                v = float(valid[r, c])
                value[AREA] += 1
                value[VALID] += v
                value[MOMENT_X] += v * (c + 0.5)
                value[MOMENT_Y] += v * (r + 0.5)
                value[MISMATCH] += mismatch[r, c]


@kernel
def _project(points_camera: Array, K: Array, near: float, pixels: Array, inverse_depth: Array) -> None:
    """Fill pixels (n, 2) and inverse depths (n,) [1/m], the latter 0 for what is not in front of ``near``."""
    for i in range(len(points_camera)):
        z = points_camera[i, 2]
        # 0 marks a vertex that has no pixel; edges with one are skipped everywhere below.
        w = 1 / z if z > near else 0.0
        x, y = points_camera[i, 0] * w, points_camera[i, 1] * w
        inverse_depth[i] = w
        pixels[i, 0] = K[0, 0] * x + K[0, 1] * y + K[0, 2]
        pixels[i, 1] = K[1, 0] * x + K[1, 1] * y + K[1, 2]


@kernel
def _count_in_tiles(mask: NDArray[np.bool_], inside: NDArray[np.int32]) -> None:
    """Add to ``inside`` (rows, columns) the pixels of the mask in every tile; its last row and column are shared."""
    rows, columns = inside.shape
    for r in range(mask.shape[0]):
        # The first row of a tile is also the last of the one above; the picture's last row has no tile of its own.
        i = min(r // TILE, rows - 1)
        above = r % TILE == 0 and 0 < r <= i * TILE
        for j in range(columns):
            count = 0
            for c in range(j * TILE, min(j * TILE + TILE + 1, mask.shape[1])):
                count += mask[r, c]
            inside[i, j] += count
            if above:
                inside[i - 1, j] += count


@kernel
def _choose(
    pixels: Array,
    inverse_depth: Array,
    edges: NDArray[np.int32],
    mixed: NDArray[np.bool_],
    chosen: NDArray[np.int32],
) -> int:
    """Fill ``chosen`` with the edges whose bounding box touches a mixed tile; returns how many.

    It writes every edge and advances only past chosen ones: a branch here would be mispredicted."""
    tiles = np.empty((len(pixels), 2), np.int32)
    for n in range(len(pixels)):
        tiles[n, 0] = _tile(pixels[n, 1], mixed.shape[0])
        tiles[n, 1] = _tile(pixels[n, 0], mixed.shape[1])
    found = 0
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        if inverse_depth[a] == 0 or inverse_depth[b] == 0:
            continue
        top, left, bottom, right = tiles[a, 0], tiles[a, 1], tiles[b, 0], tiles[b, 1]
        # An edge within two by two tiles, nearly all of them: its corners are all tiles of its box. Longer ones walk
        # the box.
        near = mixed[top, left] | mixed[top, right] | mixed[bottom, left] | mixed[bottom, right]
        if abs(top - bottom) > 1 or abs(left - right) > 1:
            for i in range(min(top, bottom), max(top, bottom) + 1):
                for j in range(min(left, right), max(left, right) + 1):
                    near |= mixed[i, j]
        chosen[found, 0], chosen[found, 1] = a, b
        found += int(near)
    return found


@inline_kernel
def _tile(place: float, count: int) -> int:
    """Which of ``count`` tiles along a side holds a place [px], the nearest for one beyond them."""
    # Minus 0.5: tiles hold places between pixel centres.
    return int(min(max((place - 0.5) / TILE, 0.0), count - 1.0))


@kernel
def _count_boundaries(mask: NDArray[np.bool_], upright: bool) -> int:
    """Neighbours along rows, or, ``upright``, along columns, of which one is inside."""
    down, right = int(upright), int(not upright)
    count = 0
    for r in range(mask.shape[0] - down):
        for c in range(mask.shape[1] - right):
            count += mask[r, c] != mask[r + down, c + right]
    return count


@kernel
def _cross(
    pixels: Array,
    inverse_depth: Array,
    edges: NDArray[np.int32],
    mask: NDArray[np.bool_],
    upright: bool,
    owner: NDArray[np.int32],
    cells: NDArray[np.int32],
    crossed: NDArray[np.int32],
    place: Array,
) -> int:
    """Fill ``cells``, ``crossed`` and ``place`` of ``_outline``; returns how many. ``owner`` is -1 everywhere."""
    along, over = int(upright), int(not upright)
    # ``along`` is the coordinate that runs along a line of pixel centres, ``over`` the one that counts the lines.
    down, right = int(upright), int(not upright)
    lines, steps = mask.shape[1 - over], mask.shape[1 - along] - 1
    found = 0
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        if inverse_depth[a] == 0 or inverse_depth[b] == 0:
            continue
        if pixels[a, over] > pixels[b, over]:
            a, b = b, a
        start, end = pixels[a, over], pixels[b, over]
        if end < 0.5 or start > lines:
            continue
        # Lines with start <= line + 0.5 < end. The range is half open: a vertex on a line belongs to one of its two
        # edges.
        first = max(0, int(np.ceil(start - 0.5)))
        last = min(lines - 1, int(np.ceil(end - 0.5)) - 1)
        for line in range(first, last + 1):
            t = (line + 0.5 - start) / (end - start)
            u = pixels[a, along] + t * (pixels[b, along] - pixels[a, along])
            # Between the first and the last pixel centre of the line: beyond them lies the image's border, not an
            # outline.
            if not 0.5 <= u < steps + 0.5:
                continue
            # The crossing lies between the centres of pixels ``step`` and ``step + 1`` of the line.
            step = int(u - 0.5)
            r, c = (step, line) if upright else (line, step)
            # Both inside or both outside: this edge is hidden, or too thin for the grid. Then the outline is not here.
            if mask[r, c] == mask[r + down, c + right]:
                continue
            # Of all edges that cross this boundary the outermost is the outline.
            direction = 1 if mask[r, c] else -1
            # ``owner`` maps a boundary to its row in the results; (r, c) is the pixel before the boundary.
            k = owner[r, c]
            if k < 0:
                k = owner[r, c] = found
                cells[k, 0], cells[k, 1], cells[k, 2] = r, c, direction
                found += 1
            elif direction * u <= direction * place[k]:
                continue
            crossed[k], place[k] = e, u
    return found


@kernel
def _sum_outline(
    cells: NDArray[np.int32],
    crossed: NDArray[np.int32],
    place: Array,
    pixels: Array,
    inverse_depth: Array,
    edges: NDArray[np.int32],
    K: Array,
    velocities: Array,
    upright: bool,
    valid: NDArray[np.float32],
    mismatch: NDArray[np.float32],
    stiffness: NDArray[np.float32],
    value: Array,
    gradient: Array,
    curvature: Array,
) -> None:
    """Add what the outline contributes: sub-pixel parts of the values, the boundary integrals, the curvature."""
    over = int(not upright)
    parameters = len(velocities)
    J = np.empty(parameters)
    w = np.empty(5)
    for k in range(len(cells)):
        a, b = edges[crossed[k], 0], edges[crossed[k], 1]
        r, c, direction = cells[k, 0], cells[k, 1], cells[k, 2]
        nx, ny = _normal(pixels[b, 0] - pixels[a, 0], pixels[b, 1] - pixels[a, 1])
        n_along = ny if upright else nx
        # n points out of the silhouette: along the line it has the sign of ``direction``, which leads from inside to
        # outside.
        if n_along * direction < 0:
            nx, ny, n_along = -nx, -ny, -n_along
        ds = abs(n_along)  # length of outline that this crossing stands for: |n_x| per row, |n_y| per column [px]

        # The hard mask counts whole pixels: the value changes by how far the crossing is beyond the border of the
        # pixel. Weights are those of the pixel that holds the crossing.
        beyond = place[k] - ((r if upright else c) + 1)
        pr, pc = (r + int(beyond >= 0), c) if upright else (r, c + int(beyond >= 0))
        x, y = (c + 0.5, place[k]) if upright else (place[k], r + 0.5)
        v = float(valid[pr, pc])
        w[AREA], w[VALID], w[MOMENT_X], w[MOMENT_Y], w[MISMATCH] = 1.0, v, v * x, v * y, mismatch[pr, pc]
        for f in range(5):
            # ds^2: rows give n_x^2 of a strip's area and columns n_y^2; the two add up to 1.
            value[f] += ds * ds * direction * beyond * w[f]

        line = (c if upright else r) + 0.5
        t = (line - pixels[a, over]) / (pixels[b, over] - pixels[a, over])
        z = 1 / (inverse_depth[a] + t * (inverse_depth[b] - inverse_depth[a]))  # 1 / z is linear along a projected edge
        # The surface point behind the crossing, in camera axes: K^-1 (x, y, 1) z for an upper triangular K.
        Y = (y - K[1, 2]) * z / K[1, 1]
        X = ((x - K[0, 2]) * z - K[0, 1] * Y) / K[0, 0]
        for p in range(parameters):
            dX = velocities[p, 0, 0] * X + velocities[p, 0, 1] * Y + velocities[p, 0, 2] * z + velocities[p, 0, 3]
            dY = velocities[p, 1, 0] * X + velocities[p, 1, 1] * Y + velocities[p, 1, 2] * z + velocities[p, 1, 3]
            dz = velocities[p, 2, 0] * X + velocities[p, 2, 1] * Y + velocities[p, 2, 2] * z + velocities[p, 2, 3]
            qx, qy = (dX - X * dz / z) / z, (dY - Y * dz / z) / z
            J[p] = nx * (K[0, 0] * qx + K[0, 1] * qy) + ny * K[1, 1] * qy  # v . n, by the quotient rule of X / z, Y / z
            for f in range(5):
                gradient[f, p] += ds * J[p] * w[f]
        h = ds * stiffness[pr, pc]
        for p in range(parameters):
            for q in range(parameters):
                curvature[p, q] += h * J[p] * J[q]


@inline_kernel
def _normal(dx: float, dy: float) -> tuple[float, float]:
    """A unit normal of a line along (dx, dy); zeros if that is no direction."""
    length = np.sqrt(dx * dx + dy * dy)
    if length == 0:
        return 0.0, 0.0
    return dy / length, -dx / length
