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
SAMPLES = 3000
"""Most colours that a mixture is fitted to."""
ROUNDS = 2
"""Times that colours choose their Gaussian again."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ColourMixture:
    """``forms`` (10, k): twice the -log density of each Gaussian with its share, as a quadratic in a colour."""

    forms: Array

    def cost(self, colours: Array) -> Array:
        """-log density (...) of colours (..., 3)."""
        each = np.exp(-0.5 * (_monomials(colours.reshape(-1, 3)) @ self.forms))
        return -np.log(each.sum(1) + STRANGE).reshape(colours.shape[:-1])


def colour_mixture(colours: Array, components: int = COMPONENTS) -> ColourMixture:
    """The mixture of some colours (n, 3), n > 0; the same for the same colours."""
    colours = colours[:: max(1, len(colours) // SAMPLES)]
    monomials, of = _monomials(colours), _split(colours, components)
    forms = _forms(monomials, of)
    for _ in range(ROUNDS):
        of = np.argmin(monomials @ forms, axis=1)
        forms = _forms(monomials, of)
    return ColourMixture(forms=forms)


def _monomials(colours: Array) -> Array:
    """(n, 10) of colours (n, 3): squares, products, the colours and 1."""
    x, y, z = colours.T
    return np.stack([x * x, y * y, z * z, x * y, x * z, y * z, x, y, z, np.ones(len(colours))], 1)


def _forms(monomials: Array, of: NDArray[np.int64]) -> Array:
    """(10, k) of the Gaussians of groups of colours, from the sums of their monomials."""
    member = of == np.arange(of.max() + 1)[:, None]
    sums = member.astype(float) @ monomials
    sums = sums[sums[:, 9] > 0]
    shares = sums[:, 9] / len(of)
    moments = sums / sums[:, 9:]
    mean, square = moments[:, 6:9], moments[:, [[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
    a = np.linalg.inv(square - mean[:, :, None] * mean[:, None] + NOISE**2 * np.eye(3))
    b = np.einsum("kij,kj->ki", a, mean)
    rest = np.einsum("ki,ki->k", mean, b) - np.log(np.linalg.det(a)) + 3 * np.log(2 * np.pi) - 2 * np.log(shares)
    squares, products = a[:, [0, 1, 2], [0, 1, 2]], 2 * a[:, [0, 0, 1], [1, 2, 2]]
    return np.concatenate([squares, products, -2 * b, rest[:, None]], 1).T


def _split(colours: Array, parts: int) -> NDArray[np.int64]:
    """A first group (n,) of each colour: the widest group is split along its longest axis (Orchard and Bouman 1991)."""
    of = np.zeros(len(colours), np.int64)
    axes = [_longest(colours)]
    for new in range(1, min(parts, len(colours))):
        widest = int(np.argmax([spread for spread, _ in axes]))
        members = np.flatnonzero(of == widest)
        along = colours[members] @ axes[widest][1]
        beyond = along > along.sum() / len(along)
        if not beyond.any() or beyond.all():
            break
        of[members[beyond]] = new
        axes[widest] = _longest(colours[members[~beyond]])
        axes.append(_longest(colours[members[beyond]]))
    return of


def _longest(colours: Array) -> tuple[float, Array]:
    """The summed square of deviations along the axis where it is largest, and that axis (3,)."""
    apart = colours - colours.sum(0) / len(colours)
    values, vectors = np.linalg.eigh(apart.T @ apart)
    return float(values[-1]), vectors[:, -1]


def lab(rgb: NDArray[np.uint8]) -> Array:
    """CIE Lab (..., 3) of sRGB (..., 3), of daylight D65."""
    value = rgb / 255.0
    linear = np.where(value > 0.04045, ((value + 0.055) / 1.055) ** 2.4, value / 12.92)
    xyz = linear @ TO_XYZ.T
    root = np.where(xyz > 216 / 24389, np.cbrt(xyz), xyz * 841 / 108 + 4 / 29)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -1)


_PRIMARIES = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
TO_XYZ = _PRIMARIES / _PRIMARIES.sum(1, keepdims=True)
"""Linear sRGB to XYZ of which white is (1, 1, 1)."""
