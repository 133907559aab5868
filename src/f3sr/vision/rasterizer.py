"""The one z-buffer of the product: silhouettes, depth, ids and colours of triangle meshes for an exact K.

Rasterisation is two-dimensional and homogeneous (Olano and Greer, "Triangle Scan Conversion using 2D
Homogeneous Coordinates", 1997). Corners a, b, c of a triangle are p = K v, not divided by z. The
edge functions at the pixel centre q = (x, y, 1) are

    e_a = (b x c) . q,   e_b = (c x a) . q,   e_c = (a x b) . q.

They are multiplied by the sign of det(a, b, c). Then all are >= 0 where the ray through q meets the triangle in
front of the camera. There e / sum(e) are perspective-correct barycentrics. Nothing is divided by z and no triangle
is cut: the near plane is a fourth edge function, (z_a - near) e_a + (z_b - near) e_b + (z_c - near) e_c >= 0.

Shared edges and corners do not crack: each edge function is raised by a bound of its rounding error, about a
billionth of a pixel. Along a row it is monotone in floating point too. So tests at both ends of a span decide its
inside. Threads own bands of rows: no byte of a result depends on their number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from f3sr.core.camera import Camera
from f3sr.core.mesh import Material, Mesh
from f3sr.core.transforms import Array, pose
from f3sr.runtime.kernels import inline_kernel, kernel
from f3sr.scene import SceneObject
from f3sr.vision.scan_conversion import (
    SHORT,
    bounds,
    centres,
    corner,
    determinant,
    edge_functions,
    inside,
    project,
    row_of,
    span,
)

EMPTY = -2
"""The id of a pixel that shows no object; -1 is the ground's."""

NEAR = 1e-3
"""Distance [m] of the near plane."""

MANY_FACES = 250_000
MANY_PIXELS = 500_000
"""Triangles and pixels; work below both is done in the calling thread, where it ends before a pool would begin."""

THREADS = min(os.cpu_count() or 1, 8)
"""How many share larger work."""

STRIP = 500_000
"""Pixels that ``strips`` draws at a time: 14 MB of buffers, and few enough strips that looking at every triangle once
per strip costs little (115,000 triangles, 1024 by 768 pixels: 43 ms in two strips, 35 in one)."""

WHITE = np.full((1, 1, 3), 255, np.uint8)
"""The texture of a material that has none: one white texel."""

Filter = Literal["bilinear", "nearest"]
Task = TypeVar("Task")


@dataclass(frozen=True, eq=False, kw_only=True)
class Fragments:
    """The nearest surface behind every pixel centre; the arrays are read-only."""

    face: NDArray[np.int32]
    """(H, W) index into the concatenated faces, -1 where empty."""
    depth: Array
    """(H, W) camera z [m], inf where empty."""
    bary: NDArray[np.float32]
    """(H, W, 3) perspective-correct barycentrics in the triangle, 0 where empty."""
    ids: NDArray[np.int32]
    """(H, W) object id, EMPTY where empty."""


def render(objects: Iterable[SceneObject], camera: Camera, *, near: float = NEAR) -> Fragments:
    """The scene as ``camera`` sees it; faces are concatenated in the order given, ids are object ids.

    ``near`` > 0 is the distance of the near plane [m]."""
    vertices, faces, ids = _joined(objects, camera)
    return rasterize(vertices, faces, ids, camera.K, camera.width, camera.height, near=near)


def strips(
    objects: Iterable[SceneObject], camera: Camera, *, near: float = NEAR, pixels: int = STRIP
) -> Iterator[tuple[slice, Fragments]]:
    """``render`` in strips of rows, from the top, of about ``pixels`` each: what a large picture needs at a time.

    Yields which rows a strip holds, and their fragments, equal to those of the whole picture.
    """
    vertices, faces, ids = _joined(objects, camera)
    points, drawn = _projected(vertices, camera.K, camera.height, near)
    step = max(1, pixels // camera.width)
    for top in range(0, camera.height, step):
        stop = min(top + step, camera.height)
        yield slice(top, stop), _drawn(points, faces, ids, (camera.width, camera.height), near, (top, stop), drawn)


def visible_ids(objects: Iterable[SceneObject], camera: Camera) -> NDArray[np.int32]:
    """The ids (H, W) of ``render``, without the memory for everything else."""
    ids = np.empty((camera.height, camera.width), np.int32)
    for rows, fragments in strips(objects, camera):
        ids[rows] = fragments.ids
    return ids


def rasterize(
    vertices_camera: ArrayLike,
    faces: ArrayLike,
    face_ids: ArrayLike,
    K: ArrayLike,
    width: int,
    height: int,
    *,
    near: float = NEAR,
    threads: int | None = None,
) -> Fragments:
    """The nearest of some two-sided triangles at every pixel centre; of equally near ones the first.

    ``vertices_camera`` (n, 3) [m]; ``faces`` (m, 3) of valid indices; ``face_ids`` (m,); ``K`` (3, 3) in
    pixels, last row (0, 0, 1); ``near`` > 0 [m]. Triangles without area are skipped. ``threads`` is chosen by
    the amount of work where it is None.
    """
    points, drawn = _projected(vertices_camera, K, height, near)
    return _drawn(points, faces, face_ids, (width, height), near, (0, height), drawn, threads)


def _drawn(
    points: Array,
    faces: ArrayLike,
    face_ids: ArrayLike,
    size: tuple[int, int],
    near: float,
    rows: tuple[int, int],
    touched: tuple[int, int],
    threads: int | None = None,
) -> Fragments:
    """Fragments of the ``rows`` [start, stop) of a picture of ``size`` (width, height), drawn where ``touched``."""
    faces, face_ids = fixed(faces, np.int32), fixed(face_ids, np.int32)
    width, (start, stop) = size[0], rows
    face = np.full((stop - start, width), -1, np.int32)
    depth = np.full((stop - start, width), np.inf)
    bary = np.zeros((stop - start, width, 3), np.float32)
    ids = np.full((stop - start, width), EMPTY, np.int32)

    def draw(band: tuple[int, int]) -> None:
        _nearest(points, faces, face_ids, float(near), *band, start, float(max(size)), face, depth, bary, ids)

    first, last = np.clip(touched, start, stop).tolist()
    in_bands(draw, (first, last), threads or _threads_for(len(faces), (stop - start) * width))
    for array in (face, depth, bary, ids):
        array.setflags(write=False)
    return Fragments(face=face, depth=depth, bary=bary, ids=ids)


def silhouette(
    vertices_camera: ArrayLike,
    faces: ArrayLike,
    K: ArrayLike,
    width: int,
    height: int,
    *,
    near: float = NEAR,
    threads: int | None = None,
) -> NDArray[np.bool_]:
    """(height, width) True where ``rasterize`` would find any surface; for inner loops."""
    faces = fixed(faces, np.int32)
    points, rows = _projected(vertices_camera, K, height, near)
    mask = np.zeros((height, width), np.bool_)

    def draw(band: tuple[int, int]) -> None:
        _cover(points, faces, float(near), *band, mask)

    in_bands(draw, rows, threads or _threads_for(len(faces), 0))
    return mask


def shade(fragments: Fragments, objects: Iterable[SceneObject], *, filter: Filter = "bilinear") -> Array:
    """Unlit colours (H, W, 3), sRGB values in [0, 1]: base colour * texture * vertex colour; empty is black.

    ``objects`` are those of ``render``, in its order. Textures repeat; a mesh without uv shows none.
    """
    shown = list(objects)
    face = fixed(fragments.face.reshape(-1), np.int32)
    bary = fixed(fragments.bary.reshape(-1, 3), np.float32)
    image = np.zeros((*fragments.face.shape, 3))
    colors = image.reshape(-1, 3)
    starts = _offsets([len(o.mesh.faces) for o in shown])
    for pixels, k, material in _pixels_by_material(face, shown):
        surface = _surface(shown[k].mesh, shown[k].mesh.materials[material])
        _paint(fixed(pixels, np.int64), face, bary, int(starts[k]), surface, filter == "nearest", colors)
    return image


def warm_up() -> None:
    """Call every kernel once, with the types that the product uses, so that all are compiled and cached."""
    triangle = Mesh(
        vertices=np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]),
        faces=np.array([[0, 1, 2]], np.int32),
        uv=np.zeros((3, 2)),
        vertex_colors=np.zeros((3, 3), np.uint8),
        materials=(Material(texture=WHITE),),
    )
    shown = SceneObject(
        id=0, label="", mask_name="", mask=np.zeros((2, 2), np.bool_), mesh=triangle, T_world_object=pose()
    )
    camera = Camera(width=2, height=2, K=np.eye(3), T_world_camera=pose())
    silhouette(triangle.vertices, triangle.faces, camera.K, 2, 2)
    shade(render([shown], camera), [shown])


def _joined(objects: Iterable[SceneObject], camera: Camera) -> tuple[Array, NDArray[np.int32], NDArray[np.int32]]:
    """Camera-frame vertices, faces and ids of faces of some objects, one after the other."""
    shown = list(objects)
    vertices = [camera.to_camera(o.vertices_world) for o in shown]
    starts = _offsets([len(v) for v in vertices])
    faces = [o.mesh.faces + np.int32(start) for o, start in zip(shown, starts, strict=False)]
    return (
        np.concatenate([np.empty((0, 3)), *vertices]),
        np.concatenate([np.empty((0, 3), np.int32), *faces]),
        np.repeat(np.array([o.id for o in shown], np.int32), [len(o.mesh.faces) for o in shown]),
    )


# The Python border: one dtype and layout per argument, so that each kernel is compiled once


def fixed(values: ArrayLike, dtype: Any) -> NDArray[Any]:
    """A contiguous, aligned, read-only view of one type, whatever was handed in; a copy only where needed."""
    # numba compiles once per type, layout and writability: all calls must agree in the three.
    array = np.require(values, dtype, ("C", "A")).view()
    array.setflags(write=False)
    return array


def _projected(vertices_camera: ArrayLike, K: ArrayLike, height: int, near: float) -> tuple[Array, tuple[int, int]]:
    """``points`` of ``project`` and the range of image rows that they may touch."""
    vertices = fixed(vertices_camera, np.float64)
    points = np.empty((len(vertices), 5))
    low, high = project(vertices, fixed(K, np.float64), float(near), points)
    # A row more on each side for rounding; infinite bounds clip to the whole picture.
    first, last = np.clip([np.floor(low - 1), np.ceil(high + 1)], 0, height)
    return fixed(points, np.float64), (int(first), int(last))


def _offsets(counts: Sequence[int]) -> NDArray[np.int64]:
    """Where each of some concatenated lists starts, and where the last ends: (len(counts) + 1,)."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])


def _pixels_by_material(
    face: NDArray[Any], objects: Sequence[SceneObject]
) -> Iterator[tuple[NDArray[np.int64], int, int]]:
    """For every visible material: its pixels (flat), the index of its object, and its own index there."""
    slots = [(k, m) for k, o in enumerate(objects) for m in range(len(o.mesh.materials))]
    first_slot = _offsets([len(o.mesh.materials) for o in objects])
    # A slot is a material of an object; numbered over all objects, it sorts pixels by what paints them.
    slot_of_face = np.concatenate(
        [np.empty(0, np.int64), *(first_slot[k] + _face_material(o.mesh) for k, o in enumerate(objects))]
    )
    pixels = np.flatnonzero(face >= 0)
    slot_of_pixel = slot_of_face[face[pixels]]
    # Stable: within a slot pixels stay in the order of the picture, which the cache likes.
    pixels = pixels[np.argsort(slot_of_pixel, kind="stable")]
    starts = _offsets(np.bincount(slot_of_pixel, minlength=len(slots)).tolist())
    for (k, material), start, end in zip(slots, starts[:-1], starts[1:], strict=True):
        if start < end:
            yield pixels[start:end], k, material


def _face_material(mesh: Mesh) -> NDArray[np.int32]:
    assert mesh.face_material is not None
    return mesh.face_material


Surface = tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]
"""Faces (m, 3), uv (n, 2), vertex colours (n, 3), base colour (3,), texture (h, w, 3).

No texture or no colours: no rows of uv or of colours."""


def _surface(mesh: Mesh, material: Material) -> Surface:
    uv, texture = mesh.uv, material.texture
    if uv is None or texture is None:
        uv, texture = np.empty((0, 2)), WHITE
    colors = np.empty((0, 3)) if mesh.vertex_colors is None else mesh.vertex_colors
    return (
        fixed(mesh.faces, np.int32),
        fixed(uv, np.float64),
        fixed(colors, np.uint8),
        fixed(material.base_color, np.float64),
        fixed(texture, np.uint8),
    )


# Threads


def _threads_for(faces: int, pixels: int) -> int:
    few = faces < MANY_FACES and pixels < MANY_PIXELS
    return 1 if few else THREADS


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """The pool of one process: threads do not survive a fork. Its tasks never wait for other tasks."""
    return ThreadPoolExecutor(THREADS, thread_name_prefix=f"raster-{process}")


def share(work: Callable[[Task], None], tasks: Sequence[Task]) -> None:
    """Call ``work`` with every task, in threads; returns when all are done and raises what the first failure raised."""
    if len(tasks) == 1:
        work(tasks[0])
    else:
        list(_pool(os.getpid()).map(work, tasks))


def in_bands(draw: Callable[[tuple[int, int]], None], rows: tuple[int, int], threads: int) -> None:
    """Draw the rows [first, stop), a band of them in each thread."""
    first, stop = rows
    count = max(1, min(threads, stop - first))
    edges = np.linspace(first, stop, count + 1).astype(int).tolist()
    share(draw, list(pairwise(edges)))


# Kernels: drawing


@kernel
def _cover(points: NDArray[Any], faces: NDArray[Any], near: float, start: int, stop: int, mask: NDArray[Any]) -> None:
    """Set ``mask`` (H, W) where a triangle covers the pixel centre, in the rows [start, stop)."""
    width, size = mask.shape[1], float(max(mask.shape))
    for f in range(len(faces)):
        a, b, c = corner(points, faces[f, 0]), corner(points, faces[f, 1]), corner(points, faces[f, 2])
        u0, u1, v0, v1 = bounds(a, b, c, near)
        top, bottom = centres(v0, v1, start, stop)
        left, right = centres(u0, u1, 0, width)
        if top > bottom or left > right:
            continue
        det = determinant(a, b, c)
        if not 0 < abs(det) < np.inf:
            continue
        edges = edge_functions(a, b, c, np.sign(det), size, near)
        for y in range(top, bottom + 1):
            row = row_of(edges, y + 0.5)
            # A short row has no branch to mispredict: ``|=`` writes every pixel of the box.
            if right - left > SHORT:
                first, last = span(edges, row, left, right)
                for x in range(first, last + 1):
                    mask[y, x] = True
            else:
                for x in range(left, right + 1):
                    mask[y, x] |= inside(x + 0.5, edges, row)


@kernel
def _nearest(
    points: NDArray[Any],
    faces: NDArray[Any],
    face_ids: NDArray[Any],
    near: float,
    start: int,
    stop: int,
    top: int,
    size: float,
    face: NDArray[Any],
    depth: NDArray[Any],
    bary: NDArray[Any],
    ids: NDArray[Any],
) -> None:
    """Fill the buffers of ``Fragments`` in the rows [start, stop) of a picture with longer side ``size`` [px].

    The buffers begin at its row ``top``."""
    width = face.shape[1]
    for f in range(len(faces)):
        a, b, c = corner(points, faces[f, 0]), corner(points, faces[f, 1]), corner(points, faces[f, 2])
        u0, u1, v0, v1 = bounds(a, b, c, near)
        low, high = centres(v0, v1, start, stop)
        left, right = centres(u0, u1, 0, width)
        if low > high or left > right:
            continue
        det = determinant(a, b, c)
        if not 0 < abs(det) < np.inf:  # no area, or seen exactly from its edge
            continue
        edges = edge_functions(a, b, c, np.sign(det), size, near)
        (ea, eb, ec, _), za, zb, zc = edges, a[2], b[2], c[2]
        for line in range(low, high + 1):
            row, y = row_of(edges, line + 0.5), line - top
            first, last = span(edges, row, left, right)
            for x in range(first, last + 1):
                # e_k / sum(e) are perspective-correct barycentrics; depth and any attribute are their weighted sums.
                wa = ea[0] * (x + 0.5) + row[0]
                wb = eb[0] * (x + 0.5) + row[1]
                wc = ec[0] * (x + 0.5) + row[2]
                total = wa + wb + wc
                z = (wa * za + wb * zb + wc * zc) / total
                if z < depth[y, x]:  # strictly less: of equally near faces the first stays
                    depth[y, x] = z
                    face[y, x] = f
                    ids[y, x] = face_ids[f]
                    bary[y, x, 0], bary[y, x, 1], bary[y, x, 2] = wa / total, wb / total, wc / total


# Kernels: colour


@kernel
def _paint(
    pixels: NDArray[Any],
    face: NDArray[Any],
    bary: NDArray[Any],
    first_face: int,
    surface: Surface,
    nearest: bool,
    image: NDArray[Any],
) -> None:
    """Colour some flat ``pixels`` (n,) of ``image`` (H W, 3), which show one material of one mesh.

    ``face`` (H W,) and ``bary`` (H W, 3) are those of ``Fragments``, ``first_face`` is where the mesh's faces begin."""
    faces, uv, colors, base_color, texture = surface
    for i in range(len(pixels)):
        pixel = pixels[i]
        f = face[pixel] - first_face
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        wa, wb, wc = float(bary[pixel, 0]), float(bary[pixel, 1]), float(bary[pixel, 2])
        for k in range(3):
            image[pixel, k] = base_color[k]
        if len(colors):
            for k in range(3):
                image[pixel, k] *= (wa * colors[a, k] + wb * colors[b, k] + wc * colors[c, k]) / 255
        if len(uv):
            u = float(wa * uv[a, 0] + wb * uv[b, 0] + wc * uv[c, 0])
            v = float(wa * uv[a, 1] + wb * uv[b, 1] + wc * uv[c, 1])
            x0, x1, fx = _texels(u % 1, texture.shape[1], nearest)
            y0, y1, fy = _texels(1 - v % 1, texture.shape[0], nearest)  # the one flip of v: row 0 is the top
            for k in range(3):
                top = (1 - fx) * texture[y0, x0, k] + fx * texture[y0, x1, k]
                bottom = (1 - fx) * texture[y1, x0, k] + fx * texture[y1, x1, k]
                image[pixel, k] *= ((1 - fy) * top + fy * bottom) / 255


@inline_kernel
def _texels(t: float, size: int, nearest: bool) -> tuple[int, int, float]:
    """The two texels around ``t`` in [0, 1] along a side of a repeating texture, and the second's weight."""
    if nearest:
        i = min(max(int(t * size), 0), size - 1)
        return i, i, 0.0
    # Texel i has its centre at (i + 0.5) / size. Both % wrap: i is -1 left of the first centre.
    s = t * size - 0.5
    i = int(np.floor(s))
    return i % size, (i + 1) % size, s - i
