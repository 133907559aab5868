"""What colours a region has: a mixture of Gaussians in CIE Lab, and what a colour costs in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array

COMPONENTS = 5
"""Gaussians of a mixture, as in Rother 2004: print, shade and highlight of one thing."""
NOISE = 2.0
"""Least standard deviation of a Gaussian [Lab]: a difference that is just seen."""
STRANGE = 1e-6
"""Density [1/Lab^3] of colours that no Gaussian explains, about one in all that sRGB shows: no pixel is certain."""
SAMPLES = 4000
"""Most colours that a mixture is fitted to."""
ROUNDS = 4
"""Times that colours choose their Gaussian again."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ColourMixture:
    """Gaussians with ``shares`` (k,), ``means`` (k, 3) and ``inverses`` (k, 3, 3) of their covariances."""

    shares: Array
    means: Array
    inverses: Array

    def cost(self, colours: Array) -> Array:
        """-log density (...) of colours (..., 3)."""
        flat = colours.reshape(-1, 3)
        density = np.full(len(flat), STRANGE)
        for share, mean, inverse in zip(self.shares, self.means, self.inverses, strict=True):
            whitened = (flat - mean) @ np.linalg.cholesky(inverse)
            peak = share * np.sqrt(np.linalg.det(inverse) / (2 * np.pi) ** 3)
            density += peak * np.exp(-0.5 * np.einsum("ij,ij->i", whitened, whitened))
        return -np.log(density).reshape(colours.shape[:-1])


def colour_mixture(colours: Array, components: int = COMPONENTS) -> ColourMixture:
    """The mixture of some colours (n, 3), n > 0; the same for the same colours."""
    colours = colours[:: max(1, len(colours) // SAMPLES)]
    of = _split(colours, components)
    for _ in range(ROUNDS):
        groups = [colours[of == k] for k in range(of.max() + 1)]
        mixture = _fitted([g for g in groups if len(g)], len(colours))
        of = _nearest(mixture, colours)
    return mixture


def _fitted(groups: list[Array], count: int) -> ColourMixture:
    means = np.array([g.mean(0) for g in groups])
    spread = [(g - m).T @ (g - m) / len(g) + NOISE**2 * np.eye(3) for g, m in zip(groups, means, strict=True)]
    shares = np.array([len(g) for g in groups]) / count
    return ColourMixture(shares=shares, means=means, inverses=np.linalg.inv(np.array(spread)))


def _nearest(mixture: ColourMixture, colours: Array) -> NDArray[np.int64]:
    """The Gaussian (n,) that explains each colour best."""
    costs = list[Array]()
    for share, mean, inverse in zip(mixture.shares, mixture.means, mixture.inverses, strict=True):
        whitened = (colours - mean) @ np.linalg.cholesky(inverse)
        costs.append(np.einsum("ij,ij->i", whitened, whitened) - np.log(np.linalg.det(inverse)) - 2 * np.log(share))
    return np.argmin(costs, axis=0)


def _split(colours: Array, parts: int) -> NDArray[np.int64]:
    """A first group (n,) of each colour: the widest group is split along its longest axis (Orchard and Bouman 1991)."""
    of = np.zeros(len(colours), np.int64)
    for new in range(1, parts):
        spread = [np.linalg.eigh(_scatter(colours[of == k])) for k in range(new)]
        widest = int(np.argmax([values[-1] for values, _ in spread]))
        members = of == widest
        along = colours @ spread[widest][1][:, -1]
        of[members & (along > along[members].mean())] = new
    return of


def _scatter(colours: Array) -> Array:
    apart = colours - colours.mean(0)
    return apart.T @ apart


def lab(rgb: NDArray[np.uint8]) -> Array:
    """CIE Lab (..., 3) of sRGB (..., 3), of daylight D65."""
    value = rgb / 255.0
    linear = np.where(value > 0.04045, ((value + 0.055) / 1.055) ** 2.4, value / 12.92)
    xyz = linear @ TO_XYZ.T
    root = np.where(xyz > 216 / 24389, np.cbrt(xyz), xyz * 841 / 108 + 4 / 29)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -1)


TO_XYZ = np.array([[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]])
TO_XYZ = TO_XYZ / TO_XYZ.sum(1, keepdims=True)
"""Linear sRGB to XYZ of which white is (1, 1, 1)."""
