"""The colour correction matrix from the textures' camera to the photo's camera: one for all objects, where it helps.

Cameras differ in their sensor filters and processing. To first order the colours of one are a 3x3 matrix times those
of another, as in every raw converter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.rendering.evidence import Evidence
from f3sr.rendering.light_fit import exposures_of_sums, sums_of

ROUNDS = 8
"""Rounds in which the matrix and the exposures are fitted in turns."""
HOLD = 0.02
"""Weight of the prior, a matrix that mixes nothing, as a share of the weight of the samples."""
FEWEST = 5
"""Least samples of a patch: fewer have no mean colour to speak of."""
PATCHES = 40
"""Patches below which no matrix is looked for: nine numbers and an exposure for every object."""
LEAST_GAIN = 0.1
"""By which share the matrix must lower the error on patches that it was not fitted to."""


@dataclass(frozen=True, eq=False)
class _Patches:
    """Mean colours (p, 3) of samples that lie together on an object: their details may lie some pixels apart."""

    group: NDArray[np.int64]
    lit: Array
    photo: Array
    count: Array
    """(p,) samples."""
    weight: Array
    """(p, 3) these times the slope of sRGB over linear light, squared."""

    def part(self, chosen: NDArray[np.bool_]) -> _Patches:
        return _Patches(
            self.group[chosen], self.lit[chosen], self.photo[chosen], self.count[chosen], self.weight[chosen]
        )


def colour_mix(evidence: Evidence, lit: Array, *, objects: int, side: float) -> tuple[Array, float] | None:
    """The matrix (3, 3), with rows of sum 1, from the ``lit`` colours (n, 3) of samples to those of the photo.

    ``lit`` are linear colours of the ``evidence``, before exposure. Each of the ``objects`` also has an exposure. The
    second value is the share by which the matrix lowers the error on held-out patches of ``side`` [m]. The error is the
    root mean square. None where the share is below ``LEAST_GAIN``, or with fewer patches than ``PATCHES``."""
    patches = _patches(evidence, lit, objects, side)
    if len(patches.group) < PATCHES:
        return None
    # Two-fold cross-validation. Patches are sorted by object and place, so every other one spreads both halves evenly.
    half = np.arange(len(patches.group)) % 2 == 0
    errors = np.zeros(2)
    for fitted, left in ((half, ~half), (~half, half)):
        train, test = patches.part(fitted), patches.part(left)
        # Both matrices get their exposures from the same half: errors[0] without mixing, errors[1] with it.
        errors += [_error(train, test, M, objects) for M in (np.eye(3), _matrix(train, objects))]
    gain = 1 - float(np.sqrt(errors[1] / max(errors[0], 1e-12)))
    if gain < LEAST_GAIN:
        return None
    M = _matrix(patches, objects)
    # Grey stays grey: rows of sum 1 leave brightness and tint to the exposures.
    return M / M.sum(1, keepdims=True), gain


def _patches(evidence: Evidence, lit: Array, objects: int, side: float) -> _Patches:
    own = evidence.group < objects
    # A patch is a cube of ``side`` in the world, on one object: (group, i, j, k) is its key.
    places = np.column_stack([evidence.group, np.floor(evidence.points / side).astype(np.int64)])[own]
    cells, cell = np.unique(places, axis=0, return_inverse=True)
    cell, photo = cell.reshape(-1), evidence.photo[own]
    count = np.bincount(cell).astype(float)

    def means(values: Array) -> Array:
        return sums_of(values, cell, len(cells)) / count[:, None]

    weight = count[:, None] * means(evidence.slope[own]) ** 2
    kept = count >= FEWEST
    return _Patches(cells[:, 0], means(lit[own]), means(photo), count, weight).part(kept)


def _plain(p: _Patches) -> Array:
    """(3, 3) an exposure of each channel alone."""
    return np.diag(p.photo.sum(0) / np.maximum(p.lit.sum(0), 1e-9))


def _brightness(p: _Patches, M: Array, objects: int) -> Array:
    """(objects,) by which mixed colours are the photo's; 1 for what has no patch."""
    mixed = p.lit @ M.T
    # Least squares in one number g: sum w (photo - g mixed)^2 is least at (w mixed . photo) / (w mixed . mixed).
    above = np.bincount(p.group, (p.weight * mixed * p.photo).sum(1), objects)
    below = np.bincount(p.group, (p.weight * mixed * mixed).sum(1), objects)
    return np.where(below > 0, above / np.maximum(below, 1e-12), 1.0)


def _matrix(p: _Patches, objects: int) -> Array:
    """Weighted least squares in turns with the exposures, drawn towards a matrix that mixes nothing."""
    M = _plain(p)
    for _ in range(ROUNDS):
        X = p.lit * _brightness(p, M, objects)[p.group][:, None]
        for c in range(3):
            W = p.weight[:, c]
            # Ridge regression of row c around ``alone`` e_c, the slope of the channel fitted alone. The prior's weight
            # HOLD is measured in the channel's own information ``own``, so that it has no unit.
            own = float((W * X[:, c] * X[:, c]).sum())
            alone = float((W * X[:, c] * p.photo[:, c]).sum()) / max(own, 1e-12)
            target = X.T @ (W * p.photo[:, c]) + HOLD * own * alone * np.eye(3)[c]
            M[c] = np.linalg.solve(X.T @ (W[:, None] * X) + (HOLD * own + 1e-12) * np.eye(3), target)
    return M


def _error(train: _Patches, test: _Patches, M: Array, objects: int) -> float:
    """Of some patches mixed and exposed, each channel of an object as others tell, as a film shows them."""
    # Exposures as a film would have them: from the other half, by the ratio of sums. The last group is the ground's,
    # empty.
    count = train.count[:, None]
    above = sums_of(count * train.photo, train.group, objects + 1)
    below = sums_of(count * np.maximum(train.lit @ M.T, 0), train.group, objects + 1)
    gains = exposures_of_sums(above, below, np.bincount(train.group, train.count, objects + 1).astype(float))
    shown = gains[test.group] * np.maximum(test.lit @ M.T, 0)
    return float((test.weight * (test.photo - shown) ** 2).sum())
