"""The two problems of alignment: where in its freedom an object, or a camera, fits the masks best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.levenberg_marquardt import Local, Minimum, minimise
from f3sr.core.transforms import Array
from f3sr.scene import SceneObject
from f3sr.vision.crop import sampled, window_around
from f3sr.vision.motion_params import CameraFreedom, ObjectFreedom
from f3sr.vision.silhouette import LossWeights, Mask, Surface, Target, iou, loss, loss_value
from f3sr.vision.silhouette_integrals import MOMENT_X, MOMENT_Y, VALID, Integrals

EQUATION_8 = np.array([1, 1, 1, 0, 0, 1.0])
"""(6,) 1 where a parameter of ``ObjectFreedom`` is free; the report's freedom: two shifts, yaw and scale."""
EVERYTHING = np.ones(6)
"""(6,) the two tilts as well."""
SMALLEST_AREA = 16
"""Pixels of a silhouette below which its centre and area say nothing."""
SEED_STEPS = 2
"""Corrections of a seed: the second finds what perspective made of the first."""
OUTSIDE = 1.0
"""What a pixel of a silhouette beyond the window costs: there is no mask."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectFit:
    """One object against its mask: equation 9 over the parameters u (6,) in [-1, 1] of its ``freedom``.

    ``camera`` sees a window around the object; ``prior`` (6,) weighs the squares of u.
    """

    surface: Surface
    camera: Camera
    target: Target
    freedom: ObjectFreedom
    prior: Array

    def shown(self, u: Array) -> Surface:
        """The surface at parameters u (6,), in the world."""
        T, s = self.freedom.similarity(u)
        return self.surface.moved(T, s)

    def silhouette(self, u: Array) -> Mask:
        """(h, w) of the window at parameters u (6,)."""
        return self.shown(u).silhouette(self.camera)

    def iou(self, u: Array) -> float:
        """With the mask, where that can be seen."""
        return iou(self.silhouette(u), self.target.mask, self.target.valid)

    def integrals(self, u: Array) -> Integrals:
        """Over the silhouette, with their derivatives by u."""
        return self.shown(u).integrals(self.camera, self.target.fields, self.freedom.velocities(u, self.camera))

    def objective(self, u: Array) -> Local:
        """Equation 9 at parameters u (6,), with derivatives by u: the prior is the sum of ``prior`` u^2."""
        return loss(self.integrals(u), self.target).plus_squares(self.prior, u)

    def value(self, u: Array) -> float:
        """Equation 9 at parameters u (6,) to whole pixels, in a third of the time of ``objective``."""
        return loss_value(self._sums(u), self.target) + float(self.prior @ u**2)

    def _sums(self, u: Array) -> Array:
        """(5,) over the pixels of the silhouette."""
        return self.shown(u).sums(self.camera, self.target.fields)

    def best(self, starts: Sequence[Array], *, kept: int, iterations: int) -> Minimum:
        """The best of some starts (6,), of which the first ``kept`` are refined."""
        values = [self.value(u) for u in starts]
        ranked = [starts[k] for k in np.argsort(values, kind="stable")]
        refined = [self.refined(u, iterations=iterations // 2) for u in ranked[:kept]]
        return self.refined(min(refined, key=lambda m: m.value).x, iterations=iterations)

    def seed(self, yaw: float) -> Array:
        """A start (6,) with a yaw [rad], in closed form: the centroid gives the shift, the square root of the ratio of
        areas the scale."""
        reach = self.freedom.reach
        u = np.array([0.0, 0, yaw / reach[2], 0, 0, 0])
        pixels_per_shift = self._pixels_per_shift()
        for _ in range(SEED_STEPS):
            found = self._sums(u)
            area = found[VALID]
            if area < SMALLEST_AREA:
                break
            offset = self.target.centroid - found[[MOMENT_X, MOMENT_Y]] / area
            u = u.copy()
            u[:2] += np.linalg.lstsq(pixels_per_shift, offset)[0] / reach[:2]
            # u[5] is (s - 1) / reach: the scale so far times the root of the ratio of areas.
            u[5] = ((1 + u[5] * reach[5]) * np.sqrt(self.target.area / area) - 1) / reach[5]
            u = np.clip(u, -1, 1)
        return u

    def seeds_by_overlap(self, yaws: Sequence[float], scales: Sequence[float]) -> list[Array]:
        """Starts (6,), one for each yaw [rad] and scale, at the shift within bounds where the silhouette costs least.

        All shifts are compared at once: what a silhouette costs is its correlation with what each pixel costs. Of an
        object that others hide in part, centroid and area tell little: what is hidden changes with the shift."""
        import scipy.fft

        fft: Any = scipy.fft  # its annotations know no arrays
        reach = self.freedom.reach
        h, w = self.target.mask.shape
        padded = (fft.next_fast_len(2 * h, real=True), fft.next_fast_len(2 * w, real=True))
        cost, shown = np.full(padded, OUTSIDE, np.float32), np.zeros(padded, np.float32)
        cost[:h, :w] = self.target.fields.mismatch
        costs_of = fft.rfft2(cost)
        y, x = np.ix_(*(fft.fftfreq(n, 1 / n) for n in padded))
        to_u = np.linalg.inv(self._pixels_per_shift()) / reach[:2, None]
        shifts = [of_x * x + of_y * y for of_x, of_y in to_u]
        is_far = (np.abs(y) >= h) | (np.abs(x) >= w)

        def shifted(u: Array) -> Array:
            shown[:h, :w] = self.silhouette(u)
            costs = fft.irfft2(costs_of * fft.rfft2(shown).conj(), s=padded)
            ends = [at + shift for at, shift in zip(u[:2], shifts, strict=True)]
            costs[is_far | (np.abs(ends[0]) > 1) | (np.abs(ends[1]) > 1)] = np.inf
            least = costs.argmin()
            return np.array([*(end.flat[least] for end in ends), *u[2:]])

        starts = ([0.0, 0, yaw / reach[2], 0, 0, (scale - 1) / reach[5]] for yaw in yaws for scale in scales)
        seeds = [np.clip(start, -1, 1) for start in starts]
        for _ in range(SEED_STEPS):
            seeds = list(map(shifted, seeds))
        return seeds

    def _pixels_per_shift(self) -> Array:
        """(2, 2), how far a point at the anchor's depth moves in the picture per metre along ``basis``: weak
        perspective."""
        depth = self.camera.to_camera(self.freedom.anchor[None])[0, 2]
        return self.camera.K[:2, :2] @ (self.camera.T_camera_world[:3, :3] @ self.freedom.basis)[:2] / depth

    def refined(
        self, u: Array, *, iterations: int, free: Array = EQUATION_8, also: Callable[[Array], Local] | None = None
    ) -> Minimum:
        """The best near a start (6,) that keeps what is not ``free`` (6,); ``also`` adds to the objective."""
        reach = free * (self.freedom.reach > 0)
        # Equal bounds fix a parameter at its start.
        bounds = np.where(reach, -1.0, u), np.where(reach, 1.0, u)

        def objective(u: Array) -> Local:
            return self.objective(u) + also(u) if also else self.objective(u)

        return minimise(objective, u, bounds=bounds, iterations=iterations)


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraFit:
    """All objects against all masks, as one: equation 7 over the parameters u (p,) in [-1, 1] of its ``freedom``.

    ``prior`` weighs the sum of the squares of u."""

    surface: Surface
    target: Target
    freedom: CameraFreedom
    prior: float

    def objective(self, u: Array) -> Local:
        """Equation 7 at parameters u (p,), with derivatives by u; ``prior`` weighs every u^2 alike."""
        integrals = self.surface.integrals(self.freedom.at(u), self.target.fields, self.freedom.velocities(u))
        return loss(integrals, self.target).plus_squares(np.full(len(u), self.prior), u)

    def best(self, *, iterations: int) -> Camera:
        """The camera at the minimum near u = 0, after at most ``iterations`` steps."""
        ones = np.ones_like(self.freedom.reach)
        return self.freedom.at(minimise(self.objective, 0 * ones, bounds=(-ones, ones), iterations=iterations).x)


def object_fit(
    o: SceneObject,
    valid: Mask,
    camera: Camera,
    freedom: ObjectFreedom,
    *,
    resolution: int,
    weights: LossWeights,
    prior: Sequence[float],
) -> ObjectFit:
    """The fit of one object in a window around its mask and render, at most ``resolution`` pixels per side.

    ``valid`` (H, W) is where the object can be compared; beyond the photo nothing is: it was not seen there.
    """
    window = window_around(o, camera, resolution)
    mask, region = (sampled(m, camera, window, fill=False) for m in (o.mask, valid))
    return ObjectFit(
        surface=Surface.of([(o.vertices_world, o.mesh.faces)]),
        camera=window,
        target=Target.of(mask, region, weights),
        freedom=freedom,
        prior=np.asarray(prior),
    )
