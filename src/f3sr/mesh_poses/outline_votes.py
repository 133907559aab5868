"""Hundreds of readings against the masks: in closed form first, then by small silhouettes of light meshes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.mesh_poses.pose_by_mask import MaskedPhoto
from f3sr.settings import constants
from f3sr.vision import rasterizer
from f3sr.vision.crop import sampled
from f3sr.vision.decimated import outline_mesh
from f3sr.vision.silhouette import Mask, iou, union_of


@constants
class OutlineConfig:
    """The first sieve of readings."""

    units: tuple[float, ...] = (1.0, 0.01, 0.001, 100.0, 1000.0)
    """A file's unit over that of its place, the likeliest first: metres, centimetres, millimetres, either way."""
    away: float = 1.0
    """Largest median distance of a middle from its mask's [diagonals of the mask's box]. A pose is off by less."""
    larger: float = 3.0
    """Largest median ratio of an object's size in the picture to its mask's, either way: parts may be hidden."""
    voters: int = 6
    """Objects that vote in the sieve, those with the largest masks first."""
    max_faces: int = 600
    """Most faces of a mesh in it."""
    resolution: int = 64
    """Longer side [px] of an object's window."""
    margin: float = 0.5
    """Around the mask's box [its longer side]: room for silhouettes that miss it."""


DEFAULT_OUTLINES = OutlineConfig()


@dataclass(frozen=True, eq=False, kw_only=True)
class MaskOutline:
    """What one object's readings are compared with: its light mesh, and its mask in a window of the photo."""

    vertices: Array
    """(p, 3) of the light mesh, in the file's axes and unit."""
    faces: NDArray[np.int32]
    K: Array
    """(3, 3) of the window [px]."""
    mask: Mask
    """(h, w) of the window."""
    valid: Mask
    """(h, w): where the silhouette must agree with it; what other masks cover may hide the object."""
    middle: Array
    """(2,) of the mask's box [px of the photo]."""
    diagonal: float
    """Of that box [px of the photo]."""
    area: int
    """Of the mask [px of the photo]."""

    @classmethod
    def of(cls, masks: Mapping[int, Mask], camera: Camera, id: int, mesh: Mesh, config: OutlineConfig) -> MaskOutline:
        """Of one of the photo's ``masks`` (H, W), by id."""
        light, mask = outline_mesh(mesh, config.max_faces), masks[id]
        rows, columns = np.nonzero(mask)
        low = np.array([columns.min(), rows.min()], float)
        high = np.array([columns.max() + 1, rows.max() + 1], float)
        margin = config.margin * (high - low).max()
        x, y = np.floor(low - margin).astype(int)
        width, height = (np.ceil(high + margin) - (x, y)).astype(int)
        window = camera.cropped(int(x), int(y), int(width), int(height)).limited(config.resolution)
        others = union_of((m for other, m in masks.items() if other != id), mask.shape)
        return cls(
            vertices=light.vertices,
            faces=light.faces,
            K=window.K,
            mask=sampled(mask, camera, window, fill=False),
            valid=sampled(~others, camera, window, fill=False),
            middle=(low + high) / 2,
            diagonal=float(np.linalg.norm(high - low)),
            area=len(rows),
        )

    def missed(self, R: Array, t: Array, scale: float) -> float:
        """1 - IoU of the mesh at ``scale R v + t`` with its mask; 1 where a part is behind the camera."""
        placed = self.vertices @ (scale * R).T + t
        if placed[:, 2].min() <= rasterizer.NEAR:
            return 1.0
        h, w = self.mask.shape
        return 1 - iou(rasterizer.silhouette(placed, self.faces, self.K, w, h, threads=1), self.mask, self.valid)


def sieved(
    view: MaskedPhoto,
    meshes: Mapping[int, Mesh],
    places: CandidatePlaces,
    config: OutlineConfig = DEFAULT_OUTLINES,
    *,
    units: bool = True,
) -> tuple[CandidatePlaces, Array]:
    """The readings that show something near the masks, best first, and what each misses of them (k,), the mean of
    1 - IoU. Every reading has the unit of its files that fits the masks' sizes best, unless ``units`` are known."""
    masks = {id: i.mask for id, i in view.instances.items()}
    outlines = [MaskOutline.of(masks, view.camera, id, meshes[id], config) for id in places.ids]
    factors = np.array(config.units if units else config.units[:1])
    scale, off = _in_units(view.camera.K, outlines, places, factors, config)
    near = np.flatnonzero(off <= 1)
    if not len(near):
        return places.chosen([]), np.zeros(0)
    voters = np.argsort([-o.area for o in outlines], kind="stable")[: config.voters]
    kept = places.chosen(near.tolist(), scale=scale[near])
    missed = np.zeros(len(kept))
    for k in range(len(kept)):
        own = (outlines[v].missed(kept.R[k, v], kept.t[k, v], float(kept.scale[k, v])) for v in voters)
        missed[k] = fmean(own)
    order = np.argsort(missed, kind="stable")
    return kept.chosen(order.tolist()), missed[order]


def _in_units(
    K: Array, outlines: list[MaskOutline], places: CandidatePlaces, units: Array, config: OutlineConfig
) -> tuple[Array, Array]:
    """Scales (k, n) of all readings in their likeliest unit, and how far each is off (k,): 1 is the most allowed.

    In closed form: of a mesh its middle and diagonal alone are looked at."""
    low = np.stack([o.vertices.min(0) for o in outlines])
    high = np.stack([o.vertices.max(0) for o in outlines])
    middle = np.stack([o.middle for o in outlines])
    diagonal = np.array([o.diagonal for o in outlines])
    turned = np.einsum("knij,nj->kni", places.R, (low + high) / 2)
    tried = units[:, None, None] * places.scale  # (u, k, n)
    at = tried[..., None] * turned + places.t
    z = at[..., 2]
    seen = z > rasterizer.NEAR
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        pixel = (at @ K.T)[..., :2] / z[..., None]
        away = np.linalg.norm(pixel - middle, axis=-1) / diagonal / config.away
        size = K[0, 0] * tried * np.linalg.norm(high - low, axis=1) / z / diagonal
        wrong = np.abs(np.log(size)) / np.log(config.larger)
    # Medians: one object may be cut by the photo's border, or hidden.
    away, wrong = (np.median(np.where(seen, v, np.inf), axis=-1) for v in (away, wrong))
    off = np.maximum(away, wrong)  # (u, k)
    # The usual unit unless another is clearly nearer.
    best = np.argmin(wrong + np.where(np.arange(len(units)) > 0, 0.1, 0)[:, None], axis=0)
    k = np.arange(len(places))
    return tried[best, k], off[best, k]
