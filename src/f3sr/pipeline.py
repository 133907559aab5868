"""The order of the stages: from inputs to a settled scene with its reports and measures."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass, field, replace

from f3sr.cache import Store, digest
from f3sr.inputs import Inputs
from f3sr.measures import visible_iou
from f3sr.proxies import ProxyConfig
from f3sr.report import Decision, Measure, Report, keep_better
from f3sr.runner import Progress, Runner
from f3sr.scene import Scene
from f3sr.stages.align import AlignConfig, align
from f3sr.stages.assemble import AssembleConfig, assemble
from f3sr.stages.decompose import decompose
from f3sr.stages.evaluate import Evaluation, evaluate
from f3sr.stages.level import LevelConfig, level
from f3sr.stages.relate import RelateConfig, relate
from f3sr.stages.separate import SeparateConfig, separate
from f3sr.stages.settle import SettleStageConfig, settle

SKIPPABLE = (
    *("level", "align", "align-camera", "align-objects", "relate", "decompose", "separate", "settle"),
    *("refine", "evaluate"),
)


@dataclass(frozen=True, kw_only=True)
class RefineConfig:
    """Re-alignment of objects that already rest: they turn about the vertical, shift horizontally and scale about
    their base, then are separated and settled again."""

    rounds: int = 2
    """Most rounds, range [0, 10]; a round that does not improve the picture is undone and ends it."""
    align: AlignConfig = field(
        default_factory=lambda: AlignConfig(
            camera=False,
            freedom="support",
            max_tilt=0.0,
            max_shift=0.2,
            max_yaw=0.35,
            max_scale=0.15,
            yaw_seeds=(0.0,),
        )
    )


@dataclass(frozen=True, kw_only=True)
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Reconstruction:
    """The settled scene, the levelled input it came from, and what every stage says of its work."""

    scene: Scene
    direct: Scene
    reports: tuple[Report, ...]
    seconds: dict[str, float]
    """Wall time [s] of every stage that was run."""
    resumed: tuple[str, ...]
    """Stages whose results came from the store."""
    config_digest: str
    """sha256 of the configuration."""
    evaluation: Evaluation | None = None


def reconstruct(
    inputs: Inputs,
    config: Config | None = None,
    *,
    skip: Collection[str] = (),
    store: Store | None = None,
    progress: Progress = lambda _: None,
) -> Reconstruction:
    """Run every stage that is not skipped. Any stage but ``assemble`` may be skipped: a valid scene remains.

    Stages whose results are in ``store`` are not done again. ``progress`` is told of every stage.
    """
    config = config or Config()
    key = digest(inputs.key, asdict(config.assemble))
    run = Runner(key, skip=skip, skippable=SKIPPABLE, store=store, progress=progress)

    scene = run.start("assemble", lambda: assemble(inputs, config.assemble))
    scene = direct = run.stage("level", level, scene, config.level)
    scene = run.stage("align", align, scene, _without(config.align, skip))
    scene = run.stage("relate", relate, scene, config.relate)
    scene = run.stage("decompose", decompose, scene, config.decompose)
    scene = run.stage("separate", separate, scene, config.separate)
    scene = run.stage("settle", settle, scene, config.settle)
    scene = run.stage("refine", refine, scene, config)
    evaluation = run.value("evaluate", lambda: evaluate(scene, direct), Evaluation.restored, Evaluation.stored)

    return Reconstruction(
        scene=scene,
        direct=direct,
        reports=tuple(run.reports),
        seconds=run.seconds,
        resumed=tuple(run.resumed),
        config_digest=digest(asdict(config)),
        evaluation=evaluation,
    )


def refine(scene: Scene, config: Config) -> tuple[Scene, Report]:
    """Align again what rests, under contact, and keep it where the picture gains and the scene still rests."""
    decisions: list[Decision] = []
    before = kept = visible_iou(scene)
    for _ in range(config.refine.rounds):
        moved, _ = align(scene, config.refine.align)
        moved, _ = separate(moved, config.separate)
        moved, settled = settle(moved, config.settle)
        gained = visible_iou(moved) if settled.value("at rest") else 0.0
        (scene, kept), decision = keep_better(
            (scene, kept), (moved, gained), score=_second, step="re-alignment under contact", measure="mIoU_visible"
        )
        decisions.append(decision)
        if scene is not moved:
            break
    measures = (Measure(name="mIoU_visible", before=before, after=kept),)
    return scene, Report(stage="refine", measures=measures, decisions=tuple(decisions))


def _without(config: AlignConfig, skip: Collection[str]) -> AlignConfig:
    return replace(
        config,
        camera=config.camera and "align-camera" not in skip,
        objects=config.objects and "align-objects" not in skip,
    )


def _second(pair: tuple[Scene, float]) -> float:
    return pair[1]
