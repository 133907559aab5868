"""Mean and spread of a posterior of few unknowns by weighted samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.core.transforms import Array

SEED = 0
"""Of the samples."""
SAMPLES = 256
"""Samples of a round: their mean is good to a fifteenth of the spread."""
FREEDOM = 5.0
"""Degrees of freedom of the Student distribution of the samples: heavy tails miss no second place."""
SHIFTS = 20
"""Steps of the mean shift."""
LEAST_EFFECTIVE = 4.0
"""Least effective number of samples that narrows the next ones."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PosteriorSample:
    """Places (n, d) with their weights (n,), which sum to 1."""

    places: Array
    weights: Array

    @property
    def mean(self) -> Array:
        """(d,)"""
        return self.weights @ self.places

    def centre(self, window: Array) -> Array:
        """The mean (d,) of the heaviest cluster, of one ``window`` (d,) across: between two clusters nothing is likely.

        Mean shift from the sample about which most lies (Comaniciu and Meer 2002)."""
        scaled = self.places / window
        near = np.exp(-0.5 * ((scaled[:, None] - scaled) ** 2).sum(2))
        at = scaled[np.argmax(near @ self.weights)]
        for _ in range(SHIFTS):
            shares = self.weights * np.exp(-0.5 * ((scaled - at) ** 2).sum(1))
            at = shares @ scaled / shares.sum()
        return at * window

    def covariance(self, about: Array) -> Array:
        """Second moments (d, d) about a place (d,), all clusters included."""
        off = self.places - about
        return off.T @ (self.weights[:, None] * off)

    @property
    def effective(self) -> float:
        """The number of even samples that are worth as much (Kish 1965)."""
        return float(1 / (self.weights**2).sum())


def weighted(places: Array, logs: Array) -> PosteriorSample:
    """Places (n, d) whose weights have logarithms (n,) up to a constant."""
    weights = np.exp(logs - logs.max())
    return PosteriorSample(places=places, weights=weights / weights.sum())


def sampled(
    start: PosteriorSample, rounds: Sequence[Callable[[Array], Array]], *, spacing: Array, least: Array
) -> PosteriorSample:
    """Population Monte Carlo (Cappe and others 2004): each round draws about the last one's samples.

    A round is a log density, from (n, d) to (n,); the last is the posterior. ``spacing`` (d,) is the spread of the
    first draws about ``start``, ``least`` (d,) the smallest of any."""
    rng = np.random.default_rng(SEED)
    sample, kernel = start, np.diag(spacing**2)
    for log_density in rounds:
        places, logs = _drawn(sample, kernel, rng)
        sample = weighted(places, log_density(places) - logs)
        effective, d = max(sample.effective, LEAST_EFFECTIVE), len(spacing)
        width = (4 / ((d + 2) * effective)) ** (1 / (d + 4))  # Silverman's
        kernel = width**2 * sample.covariance(sample.mean) + np.diag(least**2)
    return sample


def _drawn(sample: PosteriorSample, kernel: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draws (n, d) about samples, and the logarithms (n,) of their density."""
    d = kernel.shape[0]
    chosen = np.searchsorted(np.cumsum(sample.weights), (np.arange(SAMPLES) + rng.random()) / SAMPLES)
    centres = sample.places[np.minimum(chosen, len(sample.weights) - 1)]
    normal = rng.standard_normal((SAMPLES, d)) / np.sqrt(rng.chisquare(FREEDOM, SAMPLES) / FREEDOM)[:, None]
    root = np.linalg.cholesky(kernel)
    places = centres + normal @ root.T
    heavy = sample.weights > 1e-6
    off = np.linalg.solve(root, (places[:, None] - sample.places[heavy]).reshape(-1, d).T)
    far = (off**2).sum(0).reshape(SAMPLES, -1)
    density = (1 + far / FREEDOM) ** (-(FREEDOM + d) / 2) @ sample.weights[heavy]
    return places, np.log(density + 1e-300)
