"""The order of the stages: from inputs to a settled scene with its reports and measures."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import partial

from pydantic import JsonValue

from f3sr.backends.protocols import BackgroundCompleter
from f3sr.backends.registry import Backend
from f3sr.background.inpainting import Inpainting
from f3sr.contact_retries import ContactRetries
from f3sr.core.pose_uncertainty import PoseUncertainty
from f3sr.errors import NoAnswerError, require_kind, require_names
from f3sr.io.inputs import Inputs
from f3sr.options import SKIPPABLE
from f3sr.pipeline_config import Config, with_shared_settings
from f3sr.proxies import decomposing
from f3sr.report import Outcome, Report
from f3sr.runtime.daemon_thread import begun
from f3sr.runtime.machine import one_thread
from f3sr.runtime.progress import Progress, silent
from f3sr.runtime.result_forms import ArraysForm, PlainForm
from f3sr.runtime.result_store import Store, digest
from f3sr.runtime.stage_runner import Runner
from f3sr.scene import Scene
from f3sr.settings import changed
from f3sr.stages.align import AlignConfig, Aligned, align
from f3sr.stages.assemble import Assembled, as_given, assemble
from f3sr.stages.close import Closed, close
from f3sr.stages.coarsen import ROUNDS, Coarsened, coarsen
from f3sr.stages.decompose import Decomposed, decompose
from f3sr.stages.evaluate import DirectView, Evaluation, direct_composition, evaluate
from f3sr.stages.inpaint import Inpainted, inpaint
from f3sr.stages.level import Levelled, level
from f3sr.stages.refine import Refined, refine
from f3sr.stages.relate import Described, Related, describe, relate
from f3sr.stages.separate import Separated, separate
from f3sr.stages.settle import Settled, at_rest, settle
from f3sr.stages.uncertainty import Uncertain, uncertainty

BESIDE = 2_000_000
"""Largest photo [pixels] that is completed in parallel with the other stages; that takes 100 bytes a pixel."""
REPEATED_BY_REFINE = {"align", "align-objects", "separate", "settle"}
"""Stages that ``refine`` repeats: skipping one of them skips ``refine``."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Reconstruction:
    """The scene at rest, the levelled input, and the outcome of every stage."""

    scene: Scene
    """The result."""
    direct: Scene
    """The input after ``level``: assets in their given poses, gravity along -Z, ground at z = 0."""
    scenes: Mapping[str, Scene]
    """The scene after every stage that was not skipped, in order; they share photo, masks and meshes."""
    outcomes: tuple[Outcome, ...]
    """The typed outcome of every stage that was not skipped, in order; ``reports`` derives from them."""
    seconds: dict[str, float]
    """Wall time [s] of every stage that ran."""
    resumed: tuple[str, ...]
    """Stages whose results came from the store."""
    config: Config
    """The settings that were used."""
    provenance: Mapping[str, JsonValue]
    """Digests of inputs and settings, settings that are not defaults, skipped stages, back ends that answered."""
    uncertainty: Mapping[int, PoseUncertainty] = field(default_factory=dict[int, PoseUncertainty])
    """How well the pose of every object is known, by id; empty where ``uncertainty`` was skipped."""
    evaluation: Evaluation | None = None
    """Measures of the result and of direct composition; None where ``evaluate`` was skipped."""
    inpainting: Inpainting | None = None
    """The photo completed behind the objects; None where ``inpaint`` was skipped. Only films use it."""

    def __repr__(self) -> str:
        return f"Reconstruction({self.scene.summary}, {len(self.outcomes)} stages)"

    @property
    def reports(self) -> tuple[Report, ...]:
        """Measures and decisions of every stage, in order and ``evaluate`` last, for people and report.html."""
        measured = (self.evaluation.report,) if self.evaluation else ()
        return (*(outcome.report for outcome in self.outcomes), *measured)


@one_thread()
def reconstruct(
    inputs: Inputs,
    config: Config | None = None,
    *,
    skip: Collection[str] = (),
    background: Backend[BackgroundCompleter] | None = None,
    store: Store | None = None,
    progress: Progress = silent,
    seen: Callable[[str, Scene], object] = lambda stage, scene: None,
) -> Reconstruction:
    """Turn validated inputs into a scene at rest (equation 3; docs: method).

    ``skip`` names stages to leave out: any but ``assemble``, as a valid scene always remains. ``refine`` repeats
    alignment, separation and settling, so skipping one of them skips it too; skipping ``settle`` also skips ``close``
    and ``coarsen``. ``store`` holds results of earlier runs: a stage with equal inputs, settings and code is read
    instead of run.
    ``background`` completes the photo behind the objects instead of f3sr's own method. ``progress`` receives one line
    of text per event, ``seen`` the scene after every stage, by name. Equal arguments give equal scenes. Raises
    InputError for arguments of another kind.
    """
    require_kind("inputs", inputs, Inputs, accepted="f3sr.read_inputs(...)")
    require_names("skip", skip)
    given = config or Config()
    config = with_shared_settings(given)
    if REPEATED_BY_REFINE & set(skip):
        skip = {*skip, "refine"}
    if "settle" in skip:
        skip = {*skip, "close", "coarsen"}
    run = Runner(inputs.key, skip=skip, skippable=SKIPPABLE, store=store, progress=progress, seen=seen)
    rests = partial(at_rest, config=config.settle)
    retries = ContactRetries(config=config, closes="close" not in skip)

    scene, _ = run.stage(Assembled, assemble, as_given(inputs), config.assemble, told=inputs.decisions)
    early = "assemble" not in run.resumed and "decompose" not in run.skip
    with decomposing([o.mesh for o in scene], config.decompose) if early else nullcontext() as proxies:
        direct, _ = run.stage(Levelled, level, scene, config.level)
        scene, _ = run.stage(Aligned, align, direct, _without(config.align, skip))
        inpainted = run.beside(
            "inpaint",
            partial(inpaint, direct, config.inpaint, given=inputs.background, completer=background),
            ArraysForm(Inpainting, Inpainted),
            config.inpaint,
            also=background.key if background else "",
            later=inputs.photo.rgb[..., 0].size > BESIDE,
        )
        is_new = "evaluate" not in run.skip and "align" not in run.resumed
        view = begun(DirectView.of, direct, config.evaluate) if is_new else None
        scene, _ = run.stage(Related, relate, scene, config.relate)
        made, decomposed = run.stage(Decomposed, decompose, scene, config.decompose, begun=proxies)
    parted, _ = run.stage(Separated, separate, made, config.separate)
    scene, settled = run.stage(Settled, settle, parted, config.settle)
    scene, _ = run.stage(Closed, close, scene, config.close, settled=rests, restless=settled.restless)
    scene, refined = run.stage(
        Refined,
        refine,
        scene,
        config.refine,
        aligned=made,
        parted=parted,
        retries=retries,
        restless=settled.restless,
    )
    scene, _ = run.stage(
        Coarsened,
        coarsen,
        scene,
        config.coarsen,
        made=made,
        joins=decomposed.joins,
        settled=partial(at_rest, config=config.settle.within(ROUNDS)),
        balanced=retries.rebalanced,
        restless=refined.restless if "refine" not in run.skip else settled.restless,
    )
    scene, _ = run.stage(Described, describe, scene, config.relate)
    scene, uncertain = run.stage(Uncertain, uncertainty, scene, config.uncertainty)
    aligned = _without(config.align, skip).camera and "align" not in skip
    evaluation = run.value(
        "evaluate",
        partial(evaluate, scene, direct, config.evaluate, foreign=not aligned, view=view.result if view else None),
        PlainForm(Evaluation),
        config.evaluate,
    )
    try:
        inpainting, completed = inpainted() or (None, None)
    except NoAnswerError as error:  # not stored: the next run asks again
        inpainting, completed = inpaint(direct, config.inpaint, unanswered=str(error))

    return Reconstruction(
        scene=scene,
        direct=direct,
        scenes=run.scenes,
        outcomes=(*run.outcomes, *([completed] if completed else [])),
        seconds=run.seconds,
        resumed=tuple(run.resumed),
        config=given,
        provenance={
            "inputs": dict[str, JsonValue](inputs.digests),
            "config": digest(asdict(given)),
            "settings": changed(given, Config()),
            "skipped": list[JsonValue](sorted(skip)),
            "camera_aligned": aligned,
            **_named(inputs, background if "inpaint" not in skip else None),
        },
        uncertainty=uncertain.poses,
        evaluation=evaluation,
        inpainting=inpainting,
    )


def composed_directly(
    inputs: Inputs, config: Config | None = None, *, store: Store | None = None, progress: Progress = silent
) -> Scene:
    """Direct composition of the inputs, with proxies, and with no other stage than ``assemble`` and ``level``.

    It is the levelled input, moved vertically until its lowest vertex touches the ground.
    """
    needless = [stage for stage in SKIPPABLE if stage not in ("level", "decompose")]
    result = reconstruct(inputs, config, skip=needless, store=store, progress=progress)
    return direct_composition(result.direct, result.scene)


def _named(inputs: Inputs, background: Backend[BackgroundCompleter] | None) -> dict[str, JsonValue]:
    """For the provenance: the back ends that answered, where there are any."""
    names = dict[str, JsonValue](inputs.fillers)
    if background and inputs.background is None:
        names[background.kind] = background.told
    return {"backends": names} if names else {}


def _without(config: AlignConfig, skip: Collection[str]) -> AlignConfig:
    return replace(
        config,
        camera=config.camera and "align-camera" not in skip,
        objects=config.objects and "align-objects" not in skip,
    )
