"""Relative inverse depth made absolute: the scale and shift that lay the ground's pixels onto a known ground plane.

A network of relative depth gives ``d = (1/z - shift) / scale`` with both unknown (Ranftl et al. 2020). Where the plane
of the ground is known, 1/z is known at its pixels, and a line through (d, 1/z) tells both. Pixels that are not of the
ground are outliers: the line has the least median of squared residuals, then least squares over its inliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.errors import InputError

PAIRS = 300
"""Lines through two pixels that are tried: with 60 % of them on the ground, all miss it with p < 1e-58."""
ROUNDS = 3
"""Rounds of least squares over inliers."""
TRIMMED = 3.0
"""Residual, in robust standard deviations, from which on a pixel is an outlier."""
SIGMA_OF_MEDIAN = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
LEAST_PIXELS = 64
"""Least number of ground pixels."""
MOST_LEFT = 0.5
"""Most that a line may leave of the median deviation of the ground's inverse depths: values that have nothing to do
with them leave more."""
LEAST_SPREAD = 0.03
"""Least range of the ground's inverse depths, as a share of their median, that tells a scale from a shift."""
EXACT = 1e-9
"""Residual, as a share of the median inverse depth, below which a pixel is never an outlier: rounding."""


@dataclass(frozen=True, eq=False, kw_only=True)
class AffineDepth:
    """``1/z = scale d + shift`` [1/m]."""

    scale: float
    shift: float
    pixels: int
    """On the line."""
    inliers: float
    """Their share of the ground's pixels."""
    residual: float
    """Root mean square of what they are off, as a share of their median inverse depth."""
    others: Array
    """(n, 2) scale and shift without each of n groups of pixels in turn."""

    def inverse(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """1/z [1/m] of the network's values, of any shape."""
        return self.scale * values + self.shift

    def error(self, value: float) -> float:
        """One jackknife error of the distance at a value of the network, as a share: infinite where it is not in
        front of the camera."""
        whole = float(self.scale * value + self.shift)
        if whole <= 0:
            return float("inf")
        off = (self.others @ [value, 1.0]) / whole - 1
        n = len(off)
        return float(np.sqrt((n - 1) / n * ((off - off.mean()) ** 2).sum())) if n > 1 else float("inf")


def fit_affine_depth(
    values: NDArray[np.floating], inverse: NDArray[np.floating], groups: NDArray[np.integer], where: str
) -> AffineDepth:
    """The line through n pixels of the ground: the network's ``values`` (n,), 1/z of the plane (n,) [1/m], and the
    number of the region of the photo that each lies in (n,), for the jackknife.

    Raises InputError, which names ``where`` the values come from. Reasons are too few pixels, too small a range of
    depths, values that have nothing to do with them, and a line on which larger values are farther."""
    finite = np.isfinite(values) & np.isfinite(inverse)
    d, q, groups = values[finite].astype(float), inverse[finite].astype(float), groups[finite]
    if len(d) < LEAST_PIXELS:
        raise _unfit(where, f"{len(d)} pixels of the ground", f"at least {LEAST_PIXELS}")
    middle = float(np.median(q))
    spread = float(np.ptp(np.percentile(q, [5, 95]))) / middle
    if spread < LEAST_SPREAD:
        found = f"a ground whose inverse depths differ by {100 * spread:.1f} %"
        raise _unfit(where, found, f"at least {100 * LEAST_SPREAD:.0f} %")
    if np.ptp(np.percentile(d, [5, 95])) <= 1e-12 * np.abs(d).max():
        raise _unfit(where, "one value for all of the ground", "values that follow its depth")
    kept, line = _inliers(d, q, EXACT * middle)
    share = float(kept.mean())
    left = float(np.median(np.abs(line[0] * d + line[1] - q)) / np.median(np.abs(q - middle)))
    if left > MOST_LEFT:
        found = f"values that leave {100 * left:.0f} % of the deviations of the ground's inverse depths"
        raise _unfit(where, found, f"at most {100 * MOST_LEFT:.0f} %")
    if line[0] <= 0:
        raise _unfit(where, "values that grow with the ground's distance", "inverse depths, larger where nearer")
    off = line[0] * d[kept] + line[1] - q[kept]
    others = [_line(d[k], q[k]) for g in np.unique(groups) if _tells(d, k := kept & (groups != g))]
    return AffineDepth(
        scale=float(line[0]),
        shift=float(line[1]),
        pixels=int(kept.sum()),
        inliers=share,
        residual=float(np.sqrt((off**2).mean())) / middle,
        others=np.array(others).reshape(-1, 2),
    )


def _inliers(d: Array, q: Array, exact: float) -> tuple[NDArray[np.bool_], Array]:
    """Which pixels are on the line (n,), and its scale and shift (2,)."""
    rng = np.random.default_rng(0)
    first, second = rng.integers(len(d), size=(2, PAIRS))
    apart = d[first] != d[second]
    first, second = first[apart], second[apart]
    scales = (q[first] - q[second]) / (d[first] - d[second])
    shifts = q[first] - scales * d[first]
    medians = np.array([np.median(np.abs(s * d + t - q)) for s, t in zip(scales, shifts, strict=True)])
    best = int(np.argmin(medians))
    line = np.array([scales[best], shifts[best]])
    kept = np.ones(len(d), np.bool_)
    for _ in range(ROUNDS):
        off = np.abs(line[0] * d + line[1] - q)
        kept = off <= max(TRIMMED * SIGMA_OF_MEDIAN * float(np.median(off)), exact)
        if not _tells(d, kept):
            break
        line = _line(d[kept], q[kept])
    return kept, line


def _tells(d: Array, kept: NDArray[np.bool_]) -> bool:
    return int(kept.sum()) > 2 and float(np.ptp(d[kept])) > 0


def _line(d: Array, q: Array) -> Array:
    """Scale and shift (2,) of least squares."""
    centred = d - d.mean()
    scale = float((centred * (q - q.mean())).sum() / (centred**2).sum())
    return np.array([scale, q.mean() - scale * d.mean()])


def _unfit(where: str, found: str, accepted: str) -> InputError:
    return InputError(where, found=found, accepted=f"{accepted}, to give relative depths a scale and a shift")
