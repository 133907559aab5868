"""The light of the photo: a direct and an even part, and an exposure per object, fitted to what the photo shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from f3sr.core.srgb import srgb
from f3sr.core.transforms import Array, rotation_about
from f3sr.rendering.config import LightConfig
from f3sr.rendering.evidence import FEW, Evidence
from f3sr.rendering.fit_kernels import add_equations, sum_lit, sum_misfits
from f3sr.rendering.light import DIRECT, Light, disc, even_sky
from f3sr.rendering.shadow_maps import Caster, Maps
from f3sr.vision import rasterizer

CANDIDATES = 120
"""Directions of the upper half of the sphere that are tried first: 13 degrees apart."""
THIN = 4
"""Every how many of the samples these are tried on."""
SPREAD = np.radians(12.0)
"""Width of the light around each of them [rad]."""
ANGLES = tuple(np.radians([2.0, 5.0, 10.0, 18.0, 30.0]))
"""Radii of the disc that are tried [rad]: the sun through haze, lamps, a window."""
STEPS = tuple(np.radians([8.0, 4.0, 2.0]))
"""Turns of the direction in its refinement [rad], coarse to fine."""
ROUNDS = 4
"""Rounds of weights, strengths and exposures."""
LEAST_HEIGHT = np.sin(np.radians(15.0))
"""Least z of the unit vector to a direct light that is believed: below, shadows have no end in the picture."""
PRIOR = 40.0
"""Samples that the exposure of all objects together weighs in that of one."""
MOST_TINT = 1.6
"""Factor by which an object's exposure in one channel may differ from that of all objects, after its own brightness: in
a channel in which a texture is black, a reflection would count as any exposure."""
FINEST = 1 / 255
"""Least mean misfit of a group [sRGB]: below a level of eight bits it would measure rounding."""
LOOSE = 1.5
"""Mean misfits beyond which a sample counts less and less."""
DARKEST = 0.9
"""Most of the ground's light that shadows may take: the photo's darkest contact shadows are not black."""
SHADOW_RANGE = (0.0, 1.6)
"""What shadows on the ground may be multiplied by: more, and something else is dark there."""
EVIDENT = 0.05
"""Spread of what is hidden from ground samples above which their shadows are measured."""

TYPICAL = np.array([0.0, 0.5, 0.35, 0.15])
"""Strengths of light in rooms: half from one side, the rest from above all around and from the table."""

DEFAULT = Light(
    direction=np.array([-0.28, 0.24, 0.93]) / np.linalg.norm([-0.28, 0.24, 0.93]),
    angle=float(np.radians(15.0)),
    even=np.zeros(3),
    direct=np.full(3, 0.5),
    sky=np.full(3, 0.55),
)
"""From above and a little aside, soft: for shadows where the photo tells nothing."""


@dataclass(frozen=True, eq=False)
class Fit:
    """``strength`` (4,) in ``bases`` (n, 4): even, direct, sky, below; ``gains`` (groups, 3); ``misfit``: sum over
    samples of the logarithm of their group's mean misfit."""

    strength: Array
    gains: Array
    misfit: float
    bases: Array

    def lit(self, evidence: Evidence) -> Array:
        """(n, 3) the samples' colours before exposure."""
        return evidence.albedo * (self.bases @ self.strength)[:, None]


@dataclass(frozen=True, eq=False)
class FittedLight:
    """A light, whether it has a direction, and the misfits per sample of the best fits with and without one.

    A misfit is the mean logarithm of a group's mean difference in sRGB values; their difference is a log ratio."""

    light: Light
    directed: bool
    misfit: float
    undirected: float
    lit: Array
    """(n, 3) the samples' colours under it, before exposure."""


def find_light(
    evidence: Evidence,
    casters: Sequence[Caster],
    *,
    ball: tuple[Array, float],
    objects: int,
    side: int,
    config: LightConfig,
) -> FittedLight:
    """The light that explains the evidence best.

    ``casters`` are the ``objects`` in the world, whose maps of ``side`` texels cover the ``ball`` (middle (3,), radius
    [m]). A direction is believed where it lowers the misfit per sample by ``config.least_gain``."""
    # The candidates' maps serve twice: each as a direct light, all together as the sky.
    wide = Maps.empty(even_sky(CANDIDATES), *ball, side)
    wide.cast(casters)
    arriving = wide.arriving(evidence.points, evidence.normals)
    # Twice the mean cosine: 1 on open level ground, as in ``light_at``.
    sky = 2 * arriving.mean(1)
    groups = objects + 1
    undirected = _fit(evidence, _bases(evidence, np.zeros(len(sky)), sky), groups)
    first, thin, thin_sky = evidence.thinned(THIN), arriving[::THIN].copy(), sky[::THIN]
    misfits: list[float] = []
    for d in wide.directions:
        # cos a - 1 is about -a^2 / 2: a Gaussian lobe of standard deviation SPREAD, mixed from the candidates' maps.
        share = np.exp((wide.directions @ d - 1) / SPREAD**2)
        misfits.append(
            _fit(first, _bases(first, thin @ (share / share.sum()), thin_sky), groups).misfit
            + config.overhead * (1 - d[2]) * len(first.group)
            if d[2] >= LEAST_HEIGHT
            else np.inf
        )
    start = wide.directions[int(np.argmin(misfits))]

    known = dict[tuple[bytes, float], Fit]()

    def fitted(direction: Array, angle: float) -> Fit:
        if (fit := known.get((direction.tobytes(), angle))) is None:
            fit = known[direction.tobytes(), angle] = fitted_anew(direction, angle)
        return fit

    def fitted_anew(direction: Array, angle: float) -> Fit:
        maps = Maps.empty(disc(direction, angle, DIRECT), *ball, side)
        maps.cast(casters)
        direct = maps.arriving(evidence.points, evidence.normals).sum(1) / DIRECT
        fit = _fit(evidence, _bases(evidence, direct, sky), groups)
        return replace(fit, misfit=fit.misfit + config.overhead * (1 - direction[2]) * len(evidence.group))

    direction, angle, best = _refined(start, fitted)
    n = max(len(evidence.group), 1)
    # Fits are sums over n samples.
    directed = undirected.misfit - best.misfit >= config.least_gain * n and best.strength[1] > 0
    chosen = best if directed else undirected
    if config.typical:
        chosen = _fit(evidence, chosen.bases, groups, typical=config.typical, rounds=3 * ROUNDS)
    light = _light(chosen.strength, direction if directed else DEFAULT.direction, angle if directed else DEFAULT.angle)
    lit = chosen.lit(evidence) / _on_open_ground(chosen.strength, light.direction)
    return FittedLight(light, directed, best.misfit / n, undirected.misfit / n, lit)


def _on_open_ground(strength: Array, direction: Array) -> float:
    return max(float(strength @ [1, direction[2], 1, 0]), 1e-9)


def _light(strength: Array, direction: Array, angle: float) -> Light:
    """Scaled so that open ground gets 1."""
    even, direct, sky, below = strength / _on_open_ground(strength, direction)
    return Light(
        direction=direction,
        angle=angle,
        even=np.full(3, even),
        direct=np.full(3, direct),
        sky=np.full(3, sky),
        below=np.full(3, below),
    )


def _refined(start: Array, fitted: Callable[[Array, float], Fit]) -> tuple[Array, float, Fit]:
    """The best disc around ``start``: its radius, then its direction in smaller and smaller turns, then its radius."""
    direction, angle, best = start, ANGLES[2], fitted(start, ANGLES[2])

    def tried(d: Array, a: float) -> None:
        nonlocal direction, angle, best
        if d[2] >= LEAST_HEIGHT and (fit := fitted(d, a)).misfit < best.misfit:
            direction, angle, best = d, a, fit

    for step in STEPS:
        # Six neighbours on a cone of half angle ``step`` around where the round began; the best so far is kept.
        tried_from = direction
        side = np.cross(direction, [0.0, 0, 1] if direction[2] < 0.9 else [1.0, 0, 0])
        for k in range(6):
            axis = rotation_about(tried_from, k * np.pi / 3) @ side
            tried(rotation_about(axis, step) @ tried_from, angle)
        for a in ANGLES:
            if a != angle:
                tried(direction, a)
    return direction, angle, best


def _bases(evidence: Evidence, direct: Array, sky: Array) -> Array:
    """(n, 4): even, direct, sky, below."""
    return np.column_stack([np.ones(len(sky)), direct, sky, 0.5 - 0.5 * evidence.normals[:, 2]])


def _fit(evidence: Evidence, bases: Array, groups: int, *, typical: float = 0.0, rounds: int = ROUNDS) -> Fit:
    """Strengths >= 0 for all samples and exposures per group, by alternating weighted least squares.

    Residuals are weighted as sRGB shows them, and by their group's spread; iterations give outliers less weight.
    ``typical``: weight of ``TYPICAL`` strengths, per sample, in squares of mean misfits."""
    from scipy.optimize import nnls

    e, bases = evidence, rasterizer.fixed(bases, np.float64)
    # A start with all parts; without direct light its column is 0 and so is its strength.
    strength = used = np.array([0.5, 0.3 * bool(bases[:, 1].any()), 0.2, 0.0])
    gains = np.ones((groups, 3))
    count = np.bincount(e.group, minlength=groups)
    above = sums_of(e.photo, e.group, groups)
    misfit = np.inf
    for _ in range(rounds):
        below, misfits = np.zeros((groups, 3)), np.zeros(groups)
        sum_lit(e.group, e.albedo, bases, strength, below)
        # Exposures first, for the strengths of the last round; then new strengths under these exposures.
        gains = exposures_of_sums(above, below, count)
        used = strength
        sum_misfits(e.group, e.albedo, e.photo, e.slope, bases, used, gains, misfits)
        spread = np.maximum(misfits / np.maximum(count, 1), FINEST)
        # Minus the log likelihood of Laplace errors with each group's own scale, up to a constant.
        misfit = float((count * np.log(spread)).sum())
        gram, target = np.zeros((4, 4)), np.zeros(4)
        add_equations(e.group, e.albedo, e.photo, e.slope, bases, used, gains, spread, LOOSE, gram, target)
        # min s'Gs - 2 t's over s >= 0 as least squares for nnls: with G = R'R it is |R s - R'^-1 t|^2. The ridge keeps
        # G positive definite where a column is 0.
        gram += np.tril(gram, -1).T
        prior = typical * len(e.group) * bases.any(0)
        gram += np.diag(prior)
        target += prior * TYPICAL
        root = np.linalg.cholesky(gram + 1e-9 * np.trace(gram) * np.eye(4)).T
        strength = nnls(root, np.linalg.solve(root.T, target))[0]
        # Exposures hold the scale: light times 2 and exposure times 1/2 are the same picture.
        strength /= max(float(strength.sum()), 1e-9)
    return Fit(used, gains, misfit, bases)


def exposures(evidence: Evidence, lit: Array, groups: int) -> Array:
    """Exposures (groups, 3) that make ``lit`` linear colours (n, 3) of samples the photo's, group by group."""
    above, below = (sums_of(values, evidence.group, groups) for values in (evidence.photo, lit))
    return exposures_of_sums(above, below, np.bincount(evidence.group, minlength=groups))


def sums_of(values: Array, group: NDArray[np.int64], groups: int) -> Array:
    """(groups, 3) of the values (n, 3) in each group."""
    return np.array([np.bincount(group, values[:, c], groups) for c in range(3)], np.float64).T


def exposures_of_sums(above: Array, below: Array, count: NDArray[np.int64] | Array) -> Array:
    """Exposures (groups, 3): sums of the photo's colours, ``above``, over sums of lit ones, ``below`` (groups, 3).

    Where there are few samples they are drawn towards the exposure of all objects together. They are ratios, not slopes
    of a regression. If texture and photo are shifted by some pixels, a slope is too small. It is smallest in the
    channel with most contrast, which would tint the object.
    """
    # The last group is the ground: its exposure is no object's.
    whole = above[:-1].sum(0) / np.maximum(below[:-1].sum(0), 1e-12)
    prior = PRIOR * (below.mean(1) / np.maximum(count, 1))[:, None]  # of all channels: a dark one tells little
    gains = (above + prior * whole) / np.maximum(below + prior, 1e-12)
    # The exposure with the object's own brightness and the tint of all objects: clipping keeps others near it.
    grey = ((above + prior * whole).sum(1) / np.maximum((below + prior) @ whole, 1e-12))[:, None] * whole
    # Of what the photo does not show there are no sums: it has the exposure of all objects.
    return np.where(below.any(1, keepdims=True), np.clip(gains, grey / MOST_TINT, grey * MOST_TINT), whole)


def with_shadows_of(evidence: Evidence, light: Light, maps: tuple[Maps, Maps], ground: int) -> tuple[Light, bool]:
    """The light with its shadows on the ground as dark and tinted as the photo's, and whether the photo determines it.

    ``maps``: of the disc and of the sky. What is hidden takes ``shadow`` times its share of the light.
    """
    here = evidence.group == ground
    points, normals = evidence.points[here], evidence.normals[here]
    direct, sky = (m.arriving(points, normals) for m in maps)
    open_direct, open_sky = maps[0].directions[:, 2].sum(), maps[1].directions[:, 2].sum()
    # Share of the open ground's light that is hidden: visible cosines over those of open ground, for disc and sky.
    hidden = light.direct[0] * light.direction[2] * (1 - direct.sum(1) / open_direct)
    hidden = hidden + light.sky[0] * (1 - sky.sum(1) / open_sky)
    most = float(hidden.max(initial=0.0))
    if np.count_nonzero(here) < FEW or hidden.std() < EVIDENT:
        return replace(light, shadow=np.full(3, min(1.0, DARKEST / max(most, 1e-9)))), False
    ratio = evidence.photo[here] / np.maximum(evidence.albedo[here], 1e-3)
    factor = np.array([_robust_slope(hidden, ratio[:, c]) for c in range(3)])
    top = min(SHADOW_RANGE[1], DARKEST / max(float((light.direct * light.direction[2] + light.sky)[0]), 1e-9))
    return replace(light, shadow=np.clip(factor, SHADOW_RANGE[0], max(top, 0.0))), True


def _robust_slope(hidden: Array, ratio: Array) -> float:
    """k of ratio = g (1 - k hidden) over samples (n,), by least squares with Cauchy weights."""
    weight = np.ones(len(hidden))
    a = b = 0.0
    for _ in range(2 * ROUNDS):
        # ratio = a - b hidden, so that g = a and k = b / a.
        design = np.column_stack([np.ones(len(hidden)), -hidden])
        scaled = design * weight[:, None]
        a, b = np.linalg.lstsq(scaled, ratio * weight, rcond=None)[0]
        off = np.abs(ratio - design @ [a, b])
        # The root: rows are scaled, so that squares get the Cauchy weight 1 / (1 + r^2).
        weight = 1 / np.sqrt(1 + (off / max(LOOSE * float(off.mean()), 1e-6)) ** 2)
    return float(b / max(a, 1e-6))


def common_exposure(evidence: Evidence, ground: int) -> Array:
    """(3,) by which textures without light, all alike, have the photo's mean colour on objects."""
    own = evidence.group < ground
    return evidence.photo[own].sum(0) / np.maximum(evidence.albedo[own].sum(0), 1e-12)


def picture_error(evidence: Evidence, shown: Array, ground: int) -> float:
    """Root mean square difference of sRGB values in [0, 1] on objects, of ``shown`` linear colours (n, 3) to the
    photo."""
    own = evidence.group < ground
    return float(np.sqrt(np.mean((srgb(np.clip(shown[own], 0, 1)) - srgb(evidence.photo[own])) ** 2)))
