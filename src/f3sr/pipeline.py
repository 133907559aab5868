"""The order of the stages: from inputs to a settled scene with its reports and measures."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, replace

from pydantic import JsonValue

from f3sr.background import BackgroundConfig
from f3sr.background.inpainting import Inpainting
from f3sr.io.inputs import Inputs
from f3sr.metrics.contact_groups import SettledScene
from f3sr.options import SKIPPABLE
from f3sr.proxies import ProxyConfig
from f3sr.report import Report
from f3sr.runtime.progress import Progress, silent
from f3sr.runtime.result_store import Store, digest
from f3sr.runtime.stage_runner import Runner
from f3sr.scene import Scene
from f3sr.settings import changed, settings
from f3sr.stages.align import AlignConfig, align
from f3sr.stages.align.config import FacetConfig
from f3sr.stages.assemble import AssembleConfig, as_given, assemble
from f3sr.stages.close import CloseConfig, close
from f3sr.stages.decompose import decompose
from f3sr.stages.evaluate import EvaluateConfig, Evaluation, direct_composition, evaluate
from f3sr.stages.inpaint import inpaint
from f3sr.stages.level import LevelConfig, level
from f3sr.stages.refine import RefineConfig, refine
from f3sr.stages.relate import RelateConfig, describe, relate
from f3sr.stages.separate import SeparateConfig, separate
from f3sr.stages.settle import SettleStageConfig, restless, settle

BESIDE = 2_000_000
"""Pixels of the photo up to which it is completed beside the other stages: that takes 100 bytes a pixel for a while."""
REPEATED_BY_REFINE = {"align", "align-objects", "separate", "settle"}
"""Stages that ``refine`` does again: without one of them there is no refining either."""


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
    refine: RefineConfig = field(default_factory=RefineConfig)
    close: CloseConfig = field(default_factory=CloseConfig)
    evaluate: EvaluateConfig = field(default_factory=EvaluateConfig)
    inpaint: BackgroundConfig = field(default_factory=BackgroundConfig)


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
    inpainting: Inpainting | None = None
    """The photo completed behind the objects; nothing else depends on it."""


def reconstruct(
    inputs: Inputs,
    config: Config | None = None,
    *,
    skip: Collection[str] = (),
    store: Store | None = None,
    progress: Progress = silent,
) -> Reconstruction:
    """Run every stage that is not skipped. Any stage but ``assemble`` may be skipped: a valid scene remains.
    ``refine`` repeats alignment, separation and settling, so it goes with any of them; ``close`` goes with settling.

    Stages whose results are in ``store`` are not done again. ``progress`` is told of every stage.
    """
    config = config or Config()
    if REPEATED_BY_REFINE & set(skip):
        skip = {*skip, "refine"}
    if "settle" in skip:
        skip = {*skip, "close"}
    run = Runner(inputs.key, skip=skip, skippable=SKIPPABLE, store=store, progress=progress)

    scene = run.stage("assemble", _assembled, as_given(inputs), config.assemble, inputs=inputs)
    scene = direct = run.stage("level", level, scene, config.level)
    inpainted = run.beside(
        "inpaint",
        lambda: inpaint(direct, config.inpaint, given=inputs.background),
        Inpainting.restored,
        Inpainting.stored,
        config.inpaint,
        later=inputs.photo.rgb[..., 0].size > BESIDE,
    )
    scene = run.stage("align", align, scene, _without(config.align, skip))
    scene = run.stage("relate", relate, scene, config.relate)
    scene = run.stage("decompose", decompose, scene, config.decompose)
    scene = parted = run.stage("separate", separate, scene, config.separate)
    scene = run.stage("settle", settle, scene, config.settle)
    settled = run.reports[-1]
    scene = run.stage("close", _closed, scene, config, settled=settled)
    scene = run.stage("refine", _refined, scene, config, parted=parted, settled=settled, closes="close" not in skip)
    scene = run.stage("describe", describe, scene, config.relate)
    aligned = _without(config.align, skip).camera and "align" not in skip
    evaluation = run.value(
        "evaluate",
        lambda: evaluate(scene, direct, config.evaluate, foreign=not aligned),
        Evaluation.restored,
        Evaluation.stored,
        config.evaluate,
    )
    inpainting = inpainted()

    return Reconstruction(
        scene=scene,
        direct=direct,
        scenes=run.scenes,
        reports=(*run.reports, *([inpainting.report] if inpainting else [])),
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
        inpainting=inpainting,
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


def _refined(scene: Scene, config: Config, *, parted: Scene, settled: Report, closes: bool) -> tuple[Scene, Report]:
    """``refine`` with this pipeline's stages: what is compared is what would be delivered, at rest and closed."""
    parting = replace(config.separate, ground=False, margin=False)
    on_a_facet = replace(config.align, camera=False, facets=FacetConfig(most=config.refine.upright, loss=1.0))

    def again(moved: Scene) -> SettledScene:
        rested = _settled(separate(moved, parting)[0], config)
        return replace(rested, scene=_touching(rested, config)[0]) if closes else rested

    return refine(
        SettledScene(scene=scene, restless=restless(settled, config.settle)),
        config.refine,
        parted=parted,
        stood_up=lambda scene, ids: again(align(scene, on_a_facet, only=ids)[0]),
        realigned=lambda scene, ids: again(align(scene, config.refine.align, only=ids)[0]),
    )


def _closed(scene: Scene, config: Config, *, settled: Report) -> tuple[Scene, Report]:
    return _touching(SettledScene(scene=scene, restless=restless(settled, config.settle)), config)


def _touching(rested: SettledScene, config: Config) -> tuple[Scene, Report]:
    """``close`` with this pipeline's physics."""
    return close(rested.scene, config.close, settled=lambda scene: _settled(scene, config), restless=rested.restless)


def _settled(scene: Scene, config: Config) -> SettledScene:
    scene, report = settle(scene, config.settle)
    return SettledScene(scene=scene, restless=restless(report, config.settle))


def _without(config: AlignConfig, skip: Collection[str]) -> AlignConfig:
    return replace(
        config,
        camera=config.camera and "align-camera" not in skip,
        objects=config.objects and "align-objects" not in skip,
    )
