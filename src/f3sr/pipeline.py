"""The order of the stages: from inputs to a settled scene with its reports and measures."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated

import numpy as np
from annotated_types import Interval
from pydantic import JsonValue

from f3sr import devices
from f3sr.cache import Store, digest
from f3sr.frames import rotation_angle
from f3sr.inputs import Inputs
from f3sr.measures import visible_iou, visible_ious
from f3sr.progress import Progress, silent
from f3sr.proxies import ProxyConfig
from f3sr.report import Decision, Measure, Report, keep_better
from f3sr.runner import Runner
from f3sr.scene import Scene, SceneObject
from f3sr.settings import changed, settings
from f3sr.stages.align import AlignConfig, align
from f3sr.stages.align.config import DepthConfig, FacetConfig, TiltConfig
from f3sr.stages.assemble import AssembleConfig, as_given, assemble
from f3sr.stages.decompose import decompose
from f3sr.stages.evaluate import EvaluateConfig, Evaluation, direct_composition, evaluate
from f3sr.stages.level import LevelConfig, level
from f3sr.stages.relate import RelateConfig, relate
from f3sr.stages.separate import SeparateConfig, separate
from f3sr.stages.settle import SettleStageConfig, settle

SKIPPABLE = (
    *("level", "align", "align-camera", "align-objects", "relate", "decompose", "separate", "settle"),
    *("refine", "evaluate"),
)
REPEATED_BY_REFINE = {"align", "align-objects", "separate", "settle"}
"""Stages that ``refine`` does again: without one of them there is no refining either."""


@settings
class RefineConfig:
    """What is tried again once everything rests, and kept where the picture gains.

    Objects that toppled are stood on their nearest stable facet before physics. Then all are re-aligned under contact:
    they turn about the vertical, shift horizontally and scale about their base, and are separated and settled again.
    """

    topple: Annotated[float, Interval(gt=0, le=np.pi)] = math.radians(20)
    """A turn while settling from which on an object has toppled [rad]; the report's instability."""
    upright: Annotated[float, Interval(gt=0, le=np.pi / 2)] = math.radians(25)
    """It is stood on a stable facet within this turn [rad]."""
    rounds: Annotated[int, Interval(ge=0, le=10)] = 2
    """Most rounds; a round that does not improve the picture is undone and ends it."""
    align: AlignConfig = field(
        default_factory=lambda: AlignConfig(
            camera=False,
            freedom="support",
            max_shift=0.2,
            max_yaw=0.35,
            max_scale=0.15,
            yaw_seeds=(0.0,),
            tilt=TiltConfig(enabled=False),
            facets=FacetConfig(enabled=False),
            depth=DepthConfig(enabled=False),
        )
    )


@settings
class Config:
    """Every stage's settings."""

    assemble: AssembleConfig = field(default_factory=AssembleConfig)
    level: LevelConfig = field(default_factory=LevelConfig)
    align: AlignConfig = field(default_factory=AlignConfig)
    relate: RelateConfig = field(default_factory=RelateConfig)
    decompose: ProxyConfig = field(default_factory=ProxyConfig)
    separate: SeparateConfig = field(default_factory=SeparateConfig)
    settle: SettleStageConfig = field(default_factory=SettleStageConfig)
    refine: RefineConfig = field(default_factory=lambda: RefineConfig())
    evaluate: EvaluateConfig = field(default_factory=EvaluateConfig)


@dataclass(frozen=True, eq=False, kw_only=True)
class Reconstruction:
    """The settled scene, the levelled input it came from, and what every stage says of its work."""

    scene: Scene
    direct: Scene
    scenes: Mapping[str, Scene]
    """The scene after every stage that was not skipped, in order; they share photo, masks and meshes."""
    reports: tuple[Report, ...]
    seconds: dict[str, float]
    """Wall time [s] of every stage that was run."""
    resumed: tuple[str, ...]
    """Stages whose results came from the store."""
    config: Config
    provenance: Mapping[str, JsonValue]
    """What the result was made from: digests of inputs and settings, settings that are not defaults, skipped stages."""
    evaluation: Evaluation | None = None


def reconstruct(
    inputs: Inputs,
    config: Config | None = None,
    *,
    skip: Collection[str] = (),
    store: Store | None = None,
    progress: Progress = silent,
) -> Reconstruction:
    """Run every stage that is not skipped. Any stage but ``assemble`` may be skipped: a valid scene remains.
    ``refine`` repeats alignment, separation and settling, so it goes with any of them.

    Stages whose results are in ``store`` are not done again. ``progress`` is told of every stage.
    """
    config = config or Config()
    if REPEATED_BY_REFINE & set(skip):
        skip = {*skip, "refine"}
    devices.require(config.align.device, "align.device")
    devices.require(config.refine.align.device, "refine.align.device")
    run = Runner(inputs.key, skip=skip, skippable=SKIPPABLE, store=store, progress=progress)

    scene = run.stage("assemble", _assembled, as_given(inputs), config.assemble, inputs=inputs)
    scene = direct = run.stage("level", level, scene, config.level)
    scene = run.stage("align", align, scene, _without(config.align, skip))
    scene = run.stage("relate", relate, scene, config.relate)
    scene = run.stage("decompose", decompose, scene, config.decompose)
    scene = parted = run.stage("separate", separate, scene, config.separate)
    scene = run.stage("settle", settle, scene, config.settle)
    scene = run.stage("refine", refine, scene, config, parted=parted, rests=_rests(run.reports))
    aligned = _without(config.align, skip).camera and "align" not in skip
    evaluation = run.value(
        "evaluate",
        lambda: evaluate(scene, direct, config.evaluate, foreign=not aligned),
        Evaluation.restored,
        Evaluation.stored,
        config.evaluate,
    )

    return Reconstruction(
        scene=scene,
        direct=direct,
        scenes=run.scenes,
        reports=tuple(run.reports),
        seconds=run.seconds,
        resumed=tuple(run.resumed),
        config=config,
        provenance={
            "inputs": dict[str, JsonValue](inputs.digests),
            "config": digest(asdict(config)),
            "settings": changed(config, Config()),
            "skipped": list[JsonValue](sorted(skip)),
            "camera_aligned": aligned,
        },
        evaluation=evaluation,
    )


def composed_directly(
    inputs: Inputs, config: Config | None = None, *, store: Store | None = None, progress: Progress = silent
) -> Scene:
    """Direct composition of some inputs, with proxies: they are only assembled and levelled."""
    needless = [stage for stage in SKIPPABLE if stage not in ("level", "decompose")]
    result = reconstruct(inputs, config, skip=needless, store=store, progress=progress)
    return direct_composition(result.direct, result.scene)


def _assembled(_: Scene, config: AssembleConfig, *, inputs: Inputs) -> tuple[Scene, Report]:
    return assemble(inputs, config)


def _rests(reports: Sequence[Report]) -> bool:
    """Whether the last settling ended at rest."""
    settled = [report for report in reports if report.stage == "settle"]
    return bool(settled) and bool(settled[-1].value("at rest"))


@dataclass(frozen=True, eq=False)
class _Settled:
    """A scene after settling, and whether it came to rest."""

    scene: Scene
    rests: bool
    drifts: Mapping[int | None, float] = field(default_factory=dict[int | None, float])
    """Travel of each object in the undamped check [mm]."""


def refine(scene: Scene, config: Config, *, parted: Scene, rests: bool) -> tuple[Scene, Report]:
    """Stand up what toppled since ``parted``, then align again what rests, each kept where the picture gains and, once
    the scene rests (``rests``: from the start), still rests."""
    before = visible_iou(scene)
    state, decisions = _stand_up(_Settled(scene, rests), parted, config)
    for _ in range(config.refine.rounds):
        kept, decision, gained = _aligned_again(state, [o.id for o in scene], config)
        decisions.append(decision)
        if kept is state and gained:
            kept, decision, _ = _aligned_again(state, gained, config)
            decisions.append(decision)
        if kept is state:
            break
        state = kept
    measures = (Measure(name="mIoU_visible", before=before, after=visible_iou(state.scene)),)
    return state.scene, Report(stage="refine", measures=measures, decisions=tuple(decisions))


def _stand_up(state: _Settled, parted: Scene, config: Config) -> tuple[_Settled, list[Decision]]:
    """Put what toppled on its nearest stable facet, whatever that costs its own silhouette, and settle anew."""
    toppled = [o.id for o in state.scene if _turn(parted[o.id], o) > config.refine.topple]
    if not toppled:
        return state, []
    on_a_facet = FacetConfig(most=config.refine.upright, loss=1.0)
    upright, _ = align(parted, replace(config.align, camera=False, facets=on_a_facet), only=toppled)
    step = f"standing up what toppled: object {', '.join(map(str, toppled))}"
    kept, decision = _better(state, _settled_again(upright, config), step)
    return kept, [decision]


def _aligned_again(state: _Settled, among: Sequence[int], config: Config) -> tuple[_Settled, Decision, list[int]]:
    """Some objects re-aligned, all settled, where the picture gains; and which of them would gain on their own: those
    that show more of their masks, without what will not rest and all that carries it or is carried by it."""
    scene = state.scene
    moved, _ = align(scene, config.refine.align, only=among)
    tried = _settled_again(moved, config)
    step = "re-alignment under contact"
    if len(among) < len(scene.objects):
        step += f" of {', '.join(map(str, among))} alone"
    kept, decision = _better(state, tried, step)
    limit = 1000 * config.settle.settling.drift_limit
    restless = [o.id for o in scene if tried.drifts[o.id] > limit]
    bound = {k for id in restless for k in (*tried.scene.ancestors(id), *tried.scene.subtree(id), *scene.ancestors(id))}
    was, now = visible_ious(scene), visible_ious(tried.scene)
    return kept, decision, [id for id in among if now[id] > was[id] and id not in bound]


def _settled_again(moved: Scene, config: Config) -> _Settled:
    """A changed scene, separated and settled."""
    moved, _ = separate(moved, config.separate)
    moved, report = settle(moved, config.settle)
    drifts = {m.about: m.after for m in report.measures if m.name == "undamped drift"}
    return _Settled(moved, bool(report.value("at rest")), drifts)


def _better(state: _Settled, tried: _Settled, step: str) -> tuple[_Settled, Decision]:
    """``tried`` where it shows more of the photo, and rests unless ``state`` does not either, else ``state``."""
    was, now = visible_iou(state.scene), visible_iou(tried.scene)
    if state.rests and not tried.rests:
        reason = f"mIoU_visible {was:.4f} -> {now:.4f}, but it does not come to rest"
        return state, Decision(choice=f"{step}: rolled back", reason=reason)
    (kept, _), decision = keep_better((state, was), (tried, now), score=_second, step=step, measure="mIoU_visible")
    return kept, decision


def _turn(a: SceneObject, b: SceneObject) -> float:
    return rotation_angle(b.T_world_object[:3, :3] @ a.T_world_object[:3, :3].T)


def _without(config: AlignConfig, skip: Collection[str]) -> AlignConfig:
    return replace(
        config,
        camera=config.camera and "align-camera" not in skip,
        objects=config.objects and "align-objects" not in skip,
    )


def _second(pair: tuple[_Settled, float]) -> float:
    return pair[1]
