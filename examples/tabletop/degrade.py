"""Honest damage: what depth networks and image-to-3D models make of a true scene.

The geometry is off in unit, focal length and detail. The assets are off in place, turn and size, bumpy, and
wrong on the sides that the photo does not show.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from io import BytesIO
from typing import Any

import manifold3d as mf
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, quaternion_from_rotation, rotation_between, rotation_from_vector, transform
from tabletop import looks
from tabletop.atlas import bake, unwrap
from tabletop.render import tone
from tabletop.things import Thing

F = np.diag([-1.0, -1.0, 1.0])
"""PyTorch3D camera axes (left, up, forward) from OpenCV's (right, down, forward)."""

Warp = Callable[[Array], Array]
"""Points (n, 3) to points or colours (n, 3)."""
EXPOSURE = 0.9
"""Mean light on the things: textures are unlit but about as bright as the photo."""


@dataclass(frozen=True, kw_only=True)
class Damage:
    """How wrong the inputs are; standard deviations unless said otherwise."""

    unit: float = 1.17
    """Geometry units per metre: monocular geometry has no true scale."""
    focal: float = 1.007
    """Estimated over true focal length; the estimate also centres the principal point."""
    depth_noise: float = 0.006
    """Relative, smooth over a tenth of the picture; a third of it at finer grain."""
    depth: float = 0.075
    """Shift along the viewing ray, as a share of the object's size."""
    sideways: float = 0.030
    """Shift across it."""
    turn: float = np.radians(5.0)
    scale: float = 0.055
    bump: float = 0.005
    """Smooth waves on the surface, as a share of the object's size."""
    squash: float = 0.16
    """Share of the depth that the far half of an object loses."""


NONE = Damage(unit=1.0, focal=1.0, depth_noise=0, depth=0, sideways=0, turn=0, scale=0, bump=0, squash=0)
"""No damage: the check that conventions hold."""


def estimated(camera: Camera, damage: Damage) -> Camera:
    """The camera as a network would guess it."""
    if damage == NONE:
        return camera
    f = camera.K[0, 0] * damage.focal
    K = np.array([[f, 0, camera.width / 2], [0, f, camera.height / 2], [0, 0, 1]])
    return Camera(width=camera.width, height=camera.height, K=K, T_world_camera=camera.T_world_camera)


def seen_as(points: Array, camera: Camera, guess: Camera, unit: float) -> Array:
    """Where camera-frame points (..., 3) lie in the estimated geometry: same pixel and depth, new unit."""
    return unit * points @ (np.linalg.inv(guess.K) @ camera.K).T


def geometry(
    points: Array, normals: Array, camera: Camera, damage: Damage, rng: np.random.Generator
) -> dict[str, NDArray[Any]]:
    """MoGe's layout from true camera-frame points and normals (h, w, 3) at any resolution."""
    depth = points[..., 2]
    if damage != NONE:
        depth = 1 / gaussian_filter(1 / depth, 0.9)
        for share, grain in ((1.0, 0.1), (0.33, 0.02), (0.1, 0.004)):
            wave = field(depth.shape, grain * depth.shape[1], rng)
            depth = depth * (1 + damage.depth_noise * share * wave)
        smooth = [gaussian_filter(normals[..., k], 1.0) + 0.04 * field(depth.shape, 4, rng) for k in range(3)]
        normals = np.stack(smooth, -1) / np.linalg.norm(smooth, axis=0)[..., None]
    guess = estimated(camera, damage)
    K = guess.K / np.array([[camera.width], [camera.height], [1.0]])
    rays = seen_as(points / points[..., 2:], camera, guess, damage.unit)
    return {
        "points": (rays * depth[..., None]).astype(np.float16),
        "normal": (np.round(normals * 128) / 128).astype(np.float16),
        "mask": np.ones(depth.shape, bool),
        "intrinsics": K,
    }


def field(shape: tuple[int, ...], grain: float, rng: np.random.Generator) -> Array:
    """Smooth noise of unit deviation."""
    values = gaussian_filter(rng.normal(size=shape), grain)
    return values / values.std()


@dataclass(frozen=True, eq=False, kw_only=True)
class Asset:
    """A generated object: a GLB in its normalised frame and its entry in poses.json."""

    glb: bytes
    rotation: list[float]
    translation: list[float]
    scale: list[float]


def generate(
    thing: Thing,
    T_camera_object: Array,
    camera: Camera,
    damage: Damage,
    rng: np.random.Generator,
    *,
    faces: int,
    texture: int,
) -> Asset:
    """What an image-to-3D model might return for one mask."""
    surface = Surface.of(thing)
    bounds = np.array([surface.points.min(0), surface.points.max(0)])
    center, size = bounds.mean(0), float(np.linalg.norm(bounds[1] - bounds[0]))
    away = T_camera_object[:3, :3].T @ transform(T_camera_object, center)
    deform = partial(bend, center=center, size=size, away=away, waves=Waves.draw(rng), damage=damage)
    warped = thing.shape.solid.refine_to_length(size / 60).warp_batch(lambda p: deform(np.asarray(p)))

    cut = unwrap(simplified(warped, faces, size))
    paint = painter(thing, surface, deform, center, away)
    image = bake(cut, paint, size=texture)
    low, high = cut.vertices.min(0), cut.vertices.max(0)
    extent, middle = float((high - low).max()) / 0.98, (low + high) / 2
    local = (cut.vertices - middle) / extent
    pose = place(T_camera_object, middle, extent, size, camera, damage, rng)
    return Asset(glb=to_glb(local[:, [0, 2, 1]] * [1, 1, -1], cut.faces, cut.uv, image), **pose)


@dataclass(frozen=True, eq=False, kw_only=True)
class Surface:
    """Points (n, 3) on a true surface, about a millimetre apart, and their normals."""

    points: Array
    normals: Array

    @classmethod
    def of(cls, thing: Thing, *, count: int = 150_000) -> Surface:
        corners = thing.triangles[0].reshape(-1, 3)
        mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
        points, face = trimesh.sample.sample_surface(mesh, count, seed=0)
        return cls(points=np.asarray(points), normals=np.asarray(mesh.face_normals)[face])

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.points)

    def nearest(self, points: Array) -> Array:
        """The surface point near each point: its foot on the tangent plane of the closest sample."""
        _, k = self.tree.query(points)
        away = ((points - self.points[k]) * self.normals[k]).sum(-1, keepdims=True)
        return points - away * self.normals[k]


@dataclass(frozen=True, eq=False, kw_only=True)
class Waves:
    """A smooth random displacement field in units of the object's size."""

    k: Array
    phase: Array
    amplitude: Array

    @classmethod
    def draw(cls, rng: np.random.Generator, *, count: int = 8) -> Waves:
        return cls(
            k=rng.normal(size=(count, 3)) * 9.0,
            phase=rng.uniform(0, 2 * np.pi, count),
            amplitude=rng.normal(size=(count, 3)) * np.sqrt(2 / (3 * count)),
        )

    def __call__(self, x: Array) -> Array:
        return np.sin(x @ self.k.T + self.phase) @ self.amplitude


def bend(points: Array, *, center: Array, size: float, away: Array, waves: Waves, damage: Damage) -> Array:
    """Bumps everywhere; what lies behind the middle, seen level from the camera, is pulled towards it."""
    x = (points - center) / size
    level = np.array([away[0], away[1], 0.0]) / np.linalg.norm(away[:2])
    behind = np.maximum(x @ level, 0)
    return points + size * (damage.bump * waves(x) - damage.squash * behind[:, None] * level)


def simplified(solid: mf.Manifold, faces: int, size: float) -> trimesh.Trimesh:
    """The manifold at the finest tolerance that stays under ``faces`` triangles."""
    tolerance = 1e-4 * size
    while (coarse := solid.simplify(tolerance)).num_tri() > faces:
        tolerance *= 1.15
    out = coarse.to_mesh()
    return trimesh.Trimesh(out.vert_properties[:, :3], out.tri_verts, process=True)


def painter(thing: Thing, surface: Surface, deform: Warp, center: Array, away: Array) -> Warp:
    """Unlit sRGB colours near the photo's brightness; unseen sides fade towards the mean colour."""
    mean = thing.look(surface.points[::50])[:, :3].mean(0)

    def paint(points: Array) -> Array:
        true = surface.nearest(2 * points - deform(points))
        depth = (true - center) @ away
        hidden = np.clip(2 * depth / np.abs(depth).max(), 0, 1)
        color = looks.mix(thing.look(true)[:, :3], mean, 0.5 * hidden)
        return looks.to_srgb(tone(EXPOSURE * color))

    return paint


def place(
    T: Array,
    middle: Array,
    extent: float,
    size: float,
    camera: Camera,
    damage: Damage,
    rng: np.random.Generator,
) -> dict[str, list[float]]:
    """A wrong pose as SAM 3D Objects states it: p_camera = (scale * p_local) @ R(q) + translation."""
    true = transform(T, middle)
    center = seen_as(true, camera, estimated(camera, damage), damage.unit)
    ray = center / np.linalg.norm(center)
    across = np.linalg.svd(ray[None])[2][1:]
    grow = float(np.exp(damage.scale * rng.normal()))
    shift = damage.depth * rng.normal() * ray + damage.sideways * rng.normal(size=2) @ across
    tilt = rotation_from_vector(damage.turn / np.sqrt(3) * rng.normal(size=3))
    R = tilt @ rotation_between(true, center) @ T[:3, :3]
    t = center + damage.unit * size * shift
    return {
        "rotation": quaternion_from_rotation((F @ R).T).tolist(),
        "translation": (F @ t).tolist(),
        "scale": [damage.unit * extent * grow] * 3,
    }


def to_glb(vertices: Array, faces: NDArray[np.int64], uv: Array, image: NDArray[np.uint8]) -> bytes:
    """A GLB with a JPEG base colour texture."""
    packed = BytesIO()
    Image.fromarray(image).save(packed, "JPEG", quality=85)
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.open(packed), metallicFactor=0.0, roughnessFactor=0.7
    )
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    mesh = trimesh.Trimesh(vertices, faces, visual=visual, process=False)
    return bytes(mesh.export(file_type="glb", include_normals=False))
