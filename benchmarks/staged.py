"""The report's own search for objects' poses, kept as a peer: Adam on translation, then yaw, then scale."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.levenberg_marquardt import Local, Minimum
from f3sr.core.transforms import Array
from f3sr.report import Decision, keep_better
from f3sr.scene import Scene, SceneObject
from f3sr.stages import align as stage
from f3sr.stages.align import AlignConfig
from f3sr.vision.decimated import outlined
from f3sr.vision.motion_params import ObjectFreedom
from f3sr.vision.silhouette import LossWeights
from f3sr.vision.silhouette_fit import ObjectFit, object_fit

SHIFT, YAW, SCALE = 0.35, math.radians(35), 0.25
"""Bounds of equation 8: shift over the object's size, yaw [rad], change of scale."""
WEIGHTS = LossWeights(distance=0.25, centroid=0.15, area=0.05)
"""Of equation 9."""
PRIOR = np.array([0.005, 0.005, 0.002, 0, 0, 0.002]) * np.array([SHIFT, SHIFT, YAW, 0, 0, SCALE]) ** 2
"""The report's priors on shift, yaw and scale, here on shares of the bounds."""
PHASE_TOLERANCE = 0.01
"""IoU that a phase may lose."""
MOMENTS = (0.9, 0.999)
"""Adam's decays of the first and second moment."""
EPSILON = 1e-8


@dataclass(frozen=True, kw_only=True)
class Phase:
    """Some freedoms searched while the others rest: the best of a grid of seeds, then Adam."""

    name: str
    freedoms: tuple[int, ...]
    """Which of ``ObjectFreedom``'s parameters."""
    seeds: int
    """Along each freedom, over its whole range."""
    steps: int
    rate: float
    """Adam's, as a share of the bound."""


PHASES = (
    Phase(name="translation", freedoms=(0, 1), seeds=3, steps=120, rate=0.01 / SHIFT),
    Phase(name="yaw", freedoms=(2,), seeds=5, steps=80, rate=0.015 / YAW),
    Phase(name="scale", freedoms=(5,), seeds=5, steps=60, rate=0.01 / SCALE),
)
"""The report's; it gives rates for its camera only (.015 for turns, .01 else), which are taken here."""


def align(scene: Scene, config: AlignConfig | None = None) -> tuple[Scene, stage.Aligned]:
    """Stands in for the stage of this name: its camera, then every object by the report's recipe."""
    config = config or AlignConfig()
    scene, outcome = stage.align(scene, replace(config, objects=False))
    if not config.objects:
        return scene, outcome
    found = [
        align_object(outlined(o, config.search.max_faces), scene.camera, resolution=config.resolution) for o in scene
    ]
    decisions = (*outcome.decisions, *(d for _, of_one in found for d in of_one))
    scene = scene.with_objects(*(replace(o, mesh=scene[o.id].mesh) for o, _ in found))
    return scene, stage.Aligned(decisions=decisions)


def align_object(o: SceneObject, camera: Camera, *, resolution: int) -> tuple[SceneObject, list[Decision]]:
    """The object where the report's recipe puts it: four bounded freedoms, its whole mask, nothing of who hides whom.

    Every phase is undone where it loses more than ``PHASE_TOLERANCE``; all are where the end is worse than the start.
    """
    fit = staged_fit(o, camera, resolution=resolution)
    u, decisions = staged(fit, about=o.id)
    u, decision = keep_better(np.zeros(6), u, score=fit.iou, step="object", measure="mask IoU", about=o.id)
    decisions.append(decision)
    if not u.any():
        return o, decisions
    T, s = fit.freedom.similarity(u)
    return o.moved(T, scale=s, stage="align", reason=decision.reason), decisions


def staged_fit(o: SceneObject, camera: Camera, *, resolution: int) -> ObjectFit:
    """Equation 9 with the report's weights, bounds and priors."""
    freedom = ObjectFreedom(
        anchor=o.middle,
        basis=camera.T_world_camera[:3, :2],
        reach=np.array([SHIFT * o.size, SHIFT * o.size, YAW, 0, 0, SCALE]),
    )
    everywhere = np.ones_like(o.mask)
    return object_fit(o, everywhere, camera, freedom, resolution=resolution, weights=WEIGHTS, prior=PRIOR.tolist())


def staged(
    fit: ObjectFit, *, phases: Sequence[Phase] = PHASES, about: int | None = None
) -> tuple[Array, list[Decision]]:
    """Where one phase after the other leads, and which of them were kept."""
    u, decisions = np.zeros(6), list[Decision]()
    for phase in phases:
        found = _phase(fit, u, phase)
        u, decision = keep_better(
            u, found, score=fit.iou, step=phase.name, measure="mask IoU", tolerance=PHASE_TOLERANCE, about=about
        )
        decisions.append(decision)
    return u, decisions


def _phase(fit: ObjectFit, u: Array, phase: Phase) -> Array:
    places = product(np.linspace(-1, 1, phase.seeds), repeat=len(phase.freedoms))
    starts = [_with(u, phase.freedoms, place) for place in places]
    values = [fit.objective(start).value for start in starts]
    rate = _with(np.zeros(6), phase.freedoms, [phase.rate] * len(phase.freedoms))
    start, bounds = starts[int(np.argmin(values))], (-np.ones(6), np.ones(6))
    return adam(fit.objective, start, bounds=bounds, rate=rate, steps=phase.steps).x


def adam(
    objective: Callable[[Array], Local], start: Array, *, bounds: tuple[Array, Array], rate: Array, steps: int
) -> Minimum:
    """The least value met on Adam's way from ``start`` (p,) inside ``bounds`` (Kingma and Ba 2015, algorithm 1)."""
    x, best = start, Minimum(x=start, value=math.inf)
    m, v = np.zeros_like(x), np.zeros_like(x)
    for k in range(1, steps + 1):
        here = objective(x)
        if here.value < best.value:
            best = Minimum(x=x, value=here.value)
        m = MOMENTS[0] * m + (1 - MOMENTS[0]) * here.gradient
        v = MOMENTS[1] * v + (1 - MOMENTS[1]) * here.gradient**2
        step = rate * (m / (1 - MOMENTS[0] ** k)) / (np.sqrt(v / (1 - MOMENTS[1] ** k)) + EPSILON)
        x = np.clip(x - step, *bounds)
    return best


def _with(u: Array, freedoms: Sequence[int], values: Sequence[float]) -> Array:
    changed = u.copy()
    changed[list(freedoms)] = values
    return changed
