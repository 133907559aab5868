"""Other scenes that the same photo may show: poses drawn from their posterior, and brought to rest.

An object's pose is drawn from its conditional Gaussian, cut off where the object would show less of its mask.
Elliptical slice sampling (Murray, Adams and MacKay 2010) draws from exactly that, one object after another (Gibbs).
What rests on an object goes up and down with it. Physics then ends every overlap and gap. A scene that moves, crosses
or misses the masks is drawn again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.pose_uncertainty import SCALE, SHIFT, TURN, similarity
from f3sr.core.transforms import UP, Array, pose, transform
from f3sr.metrics.contact_groups import SettledScene, groups_of
from f3sr.metrics.measures import Measures, measure
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.scene import GROUND, Scene, SceneObject, names_of
from f3sr.settings import constants
from f3sr.vision.crop import sampled, window_around
from f3sr.vision.decimated import outlined
from f3sr.vision.occlusion import nearer_objects, visible_region
from f3sr.vision.silhouette import Mask, Surface, iou

SMALLEST_ANGLE = 1e-3
"""Step on an ellipse [rad] below which a chain stays where it is."""


class Settle(Protocol):
    """Parts what overlaps of some objects, ``moving``, brings them to rest from where they are in ``start`` and closes
    the gaps. The others stay as they rest in ``before``."""

    def __call__(self, before: Scene, /, *, start: Scene, moving: frozenset[int]) -> SettledScene: ...


@constants
class SamplingConfig:
    """How scenes are drawn, and what they must meet."""

    loss: float = 0.01
    """Most mIoU_visible that a sample may lose."""
    share: float = 0.8
    """Share of ``loss`` that the poses of one object may take; the rest is left to physics."""
    travel: float = 0.1
    """Most travel of a centre of mass in the 5 s after release [cm]."""
    energy: float = 1e-3
    """Most kinetic energy in the first second after release [J]."""
    sweeps: int = 48
    """Times that every object is drawn again from one scene to the next."""
    attempts: int = 3
    """Scenes that are tried for each that is wanted, before fewer are delivered."""
    halvings: int = 3
    """Times that a group which physics moves off its masks goes halfway back to the poses that it had last."""
    resolution: int = 192
    """Longer side [px] of the windows in which silhouettes are compared."""
    max_faces: int = 2000
    """Most faces of the meshes that silhouettes are drawn from."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Sample:
    """A scene at rest that the photo may show as well, with its measures.

    ``as_one``: ids of groups that moved as one body, with one turn and one scale: with poses of their own they fell, or
    left their masks."""

    scene: Scene
    measures: Measures
    as_one: frozenset[int]


@dataclass(frozen=True, kw_only=True)
class Rejected:
    """A scene that was drawn and not kept, and why."""

    reason: str


def draw(
    scene: Scene, covariances: Mapping[int, Array], settle: Settle, config: SamplingConfig, *, seed: int = 0
) -> Iterator[Sample | Rejected]:
    """Scenes without end that the photo of ``scene``, which is at rest, may show as well; the same for equal arguments.

    ``covariances``: (7, 7) conditional ones by id; objects without one stay. Every sample meets the masks within
    ``config.loss`` of mIoU_visible, crosses nowhere and rests."""
    best = SettledScene(scene=scene, restless=frozenset())
    poses = _Poses(scene, covariances, config)
    rng = np.random.default_rng(seed)
    last, known = best, dict(poses.x)
    while True:
        poses.sweep(rng)
        rested, as_one = _at_rest(best, last, known, poses, settle, rng, config)
        judged = _judged(rested, best.seen, as_one, config)
        if isinstance(judged, Sample):
            last, known = rested, dict(poses.x)
        else:
            poses.x = dict(known)
        yield judged


def _at_rest(
    best: SettledScene,
    last: SettledScene,
    known: Mapping[int, Array],
    poses: _Poses,
    settle: Settle,
    rng: np.random.Generator,
    config: SamplingConfig,
) -> tuple[SettledScene, frozenset[int]]:
    """The drawn poses at rest, and ids of what moved as one.

    A group that physics moves off its masks, or that does not rest, goes halfway back to the poses of the ``last``
    sample, which were ``known``. In the end it moves as one body from where it is in the ``best`` scene."""
    moving = frozenset(poses.x)
    state, failed = last, list[list[int]]()
    for k in range(config.halvings + 1):
        drawn = poses.scene()
        start = state.scene.with_objects(*(drawn[id] for id in sorted(moving)))
        state = settle(state.scene, start=start, moving=moving)
        failed = _failed(best, state, config)
        moving = frozenset(id for g in failed for id in g)
        if not moving:
            return state, frozenset()
        if k < config.halvings:
            poses.x |= {id: (known[id] + poses.x[id]) / 2 for id in moving}
    poses.x |= {id: np.zeros(7) for id in moving}
    moved = (o for g in failed for o in poses.as_one(g, rng))
    return SettledScene(scene=state.scene.with_objects(*moved), restless=state.restless - moving), moving


def _failed(best: SettledScene, state: SettledScene, config: SamplingConfig) -> list[list[int]]:
    """Ids of what moves in groups that do not rest, or show less of their masks than they may."""
    return [
        sorted(id for id in g if state.scene[id].mobility == "dynamic")
        for g in groups_of(best.scene, state.scene, DEFAULT_MARGIN.apart)
        if g & state.restless or np.mean([state.ious[k] - best.ious[k] for k in g]) < -config.loss
    ]


def _judged(rested: SettledScene, best: float, as_one: frozenset[int], config: SamplingConfig) -> Sample | Rejected:
    if rested.restless:
        return Rejected(reason=f"not at rest: {names_of(rested.restless)}")
    if rested.seen < best - config.loss:
        return Rejected(reason=f"mIoU_visible {rested.seen:.4f} instead of {best:.4f}")
    found = measure(rested.scene)
    if found.N_cross:
        return Rejected(reason=f"{found.N_cross} crossings of surfaces")
    if found.D_max_cm > config.travel or found.K_max_J > config.energy:
        return Rejected(reason=f"an object moves {found.D_max_cm:.2f} cm, with {found.K_max_J:.1e} J")
    return Sample(scene=rested.scene, measures=found, as_one=as_one)


@dataclass(frozen=True, eq=False, kw_only=True)
class _View:
    """An object against its mask in a window, where it can be compared; ``least`` is the IoU it must have."""

    surface: Surface
    camera: Camera
    mask: Mask
    valid: Mask
    least: float

    def is_met(self, T: Array, scale: float) -> bool:
        return self.iou(T, scale) >= self.least

    def iou(self, T: Array, scale: float) -> float:
        return iou(self.surface.moved(T, scale).silhouette(self.camera), self.mask, self.valid)


class _Poses:
    """The state of the chain: standard normal variables (7,) per object, by id, all 0 at the scene itself."""

    def __init__(self, scene: Scene, covariances: Mapping[int, Array], config: SamplingConfig) -> None:
        self.base, self.config = scene, config
        self.roots = {id: _root(c) for id, c in covariances.items() if scene[id].mobility == "dynamic"}
        self.x = {id: np.zeros(7) for id in self.roots}
        nearer = nearer_objects(scene)
        self.views = {o.id: _view(o, visible_region(o, nearer[o.id]), scene.camera, config) for o in scene}
        self.corners = {o.id: transform(o.T_world_asset, o.mesh.hull.vertices) for o in scene}

    def sweep(self, rng: np.random.Generator) -> None:
        """Every object drawn again, some times."""
        for _ in range(self.config.sweeps):
            for id in self.x:
                self._redraw(id, rng)

    def scene(self) -> Scene:
        """The scene with the drawn poses."""
        moves = self._moves(self.x)
        reason = "drawn from the posterior of its pose"
        return self.base.with_objects(
            *(self.base[id].moved(T, scale=s, stage="sample", reason=reason) for id, (T, s) in moves.items())
        )

    def as_one(self, ids: Sequence[int], rng: np.random.Generator) -> list[SceneObject]:
        """Objects of the scene, moved by one similarity that keeps the ground: contacts, and so rest, stay as they are.

        Its four parameters, a horizontal shift, a turn about the vertical and the logarithm of the scale, are known by
        what is known of all these objects together."""
        objects = [self.base[id] for id in ids]
        pivot = np.mean([o.middle for o in objects], axis=0) * [1, 1, 0]
        known = np.zeros((4, 4))
        for o in objects:
            if o.id in self.roots:
                A = _as_pose(o.middle - pivot)
                known += A.T @ np.linalg.pinv(self.roots[o.id] @ self.roots[o.id].T) @ A
        root = _root(np.asarray(np.linalg.pinv(known), float))

        def motion(x: Array) -> tuple[Array, float]:
            east, north, yaw, growth = root @ x
            return similarity(np.array([east, north, 0, 0, 0, yaw, growth]), pivot)

        x = np.zeros(4)
        for _ in range(self.config.sweeps):
            x = _slice(x, lambda x: all(self.views[id].is_met(*motion(x)) for id in ids), rng)
        T, scale = motion(x)
        return [
            o.moved(T, scale=scale, stage="sample", reason="drawn from the posterior of its group") for o in objects
        ]

    def _redraw(self, id: int, rng: np.random.Generator) -> None:
        affected = [k for k in self.base.subtree(id) if self.base[k].mobility == "dynamic"]

        def is_met(x: Array) -> bool:
            moves = self._moves({**self.x, id: x})
            return all(self.views[k].is_met(*moves[k]) for k in affected)

        self.x[id] = _slice(self.x[id], is_met, rng)

    def _moves(self, x: Mapping[int, Array]) -> dict[int, tuple[Array, float]]:
        """x -> T (scale x) of every object, by id: its drawn pose, at the height at which it still touches what carries
        it."""
        moves: dict[int, tuple[Array, float]] = {}
        for id in self.base.supports_first:
            o = self.base[id]
            if o.mobility == "fixed":
                continue
            q = self.roots[id] @ x[id] if id in x else np.zeros(7)
            T, scale = similarity(q, o.middle)
            corners = self.corners[id]
            foot = corners[np.argmin(corners[:, 2])]
            rise = self._rise(o, foot, moves)
            if o.supported_by is not None:
                lowest = float(transform(T, scale * corners)[:, 2].min())
                moves[id] = pose(t=(foot[2] + rise - lowest) * UP) @ T, scale
            else:
                moves[id] = T, scale
        return moves

    def _rise(self, o: SceneObject, foot: Array, moves: Mapping[int, tuple[Array, float]]) -> float:
        """How far what carries an object rises under its foot (3,) [m]."""
        if o.supported_by in (None, GROUND) or o.supported_by not in moves:
            return 0.0
        T, scale = moves[o.supported_by]
        return float(transform(T, scale * foot)[2] - foot[2])


def _slice(x: Array, is_met: Callable[[Array], bool], rng: np.random.Generator) -> Array:
    """One step of elliptical slice sampling from ``x`` (p,), for a standard normal prior where ``is_met`` holds."""
    aside = rng.standard_normal(len(x))
    angle = rng.uniform(0, 2 * math.pi)
    low, high = angle - 2 * math.pi, angle
    while abs(angle) > SMALLEST_ANGLE:
        tried = x * math.cos(angle) + aside * math.sin(angle)
        if is_met(tried):
            return tried
        low, high = (angle, high) if angle < 0 else (low, angle)
        angle = rng.uniform(low, high)
    return x


def _as_pose(arm: Array) -> Array:
    """(7, 4): the parameters of an object's pose by those of a group, whose pivot its middle is ``arm`` (3,) from."""
    A = np.zeros((7, 4))
    A[[0, 1], [0, 1]] = 1
    A[SHIFT, 2], A[TURN.stop - 1, 2] = np.cross(UP, arm), 1
    A[SHIFT, 3], A[SCALE, 3] = arm, 1
    return A


def _root(covariance: Array) -> Array:
    """(7, 7) L with L L^T = covariance."""
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    return axes * np.sqrt(np.maximum(values, 0))


def _view(o: SceneObject, valid: Mask, camera: Camera, config: SamplingConfig) -> _View:
    window = window_around(o, camera, config.resolution)
    light = outlined(o, config.max_faces)
    mask, region = (sampled(m, camera, window, fill=False) for m in (o.mask, valid))
    view = _View(
        surface=Surface.of([(light.vertices_world, light.mesh.faces)]),
        camera=window,
        mask=mask,
        valid=region,
        least=0.0,
    )
    return replace(view, least=view.iou(np.eye(4), 1.0) - config.share * config.loss)
