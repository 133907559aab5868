"""The order of the stages: from inputs to a settled scene with its reports and measures."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import partial

from pydantic import JsonValue

from f3sr.backends.protocols import BackgroundCompleter
from f3sr.backends.registry import Backend
from f3sr.background import BackgroundConfig
from f3sr.background.inpainting import Inpainting
from f3sr.core.pose_uncertainty import PoseUncertainty
from f3sr.core.transforms import Array
from f3sr.errors import NoAnswerError, require_kind, require_names
from f3sr.io.inputs import Inputs
from f3sr.metrics.contact_groups import SettledScene
from f3sr.options import SKIPPABLE
from f3sr.proxies import ProxyConfig, decomposing
from f3sr.report import Outcome, Report
from f3sr.runtime.daemon_thread import begun
from f3sr.runtime.progress import Progress, silent
from f3sr.runtime.result_forms import ArraysForm, PlainForm
from f3sr.runtime.result_store import Store, digest
from f3sr.runtime.stage_runner import Runner
from f3sr.scene import Scene
from f3sr.settings import changed, settings
from f3sr.stages.align import AlignConfig, Aligned, align
from f3sr.stages.assemble import AssembleConfig, Assembled, as_given, assemble
from f3sr.stages.balance import balance
from f3sr.stages.close import CloseConfig, Closed, close, lowered
from f3sr.stages.coarsen import ROUNDS, CoarsenConfig, Coarsened, coarsen
from f3sr.stages.decompose import Decomposed, decompose
from f3sr.stages.evaluate import DirectView, EvaluateConfig, Evaluation, direct_composition, evaluate
from f3sr.stages.inpaint import Inpainted, inpaint
from f3sr.stages.level import LevelConfig, Levelled, level
from f3sr.stages.refine import UPRIGHT, RefineConfig, Refined, Restarted, Retry, moved_off_masks, refine
from f3sr.stages.relate import Described, RelateConfig, Related, describe, relate
from f3sr.stages.separate import SeparateConfig, Separated, on_footings_in_place, on_own_footings, separate
from f3sr.stages.settle import Settled, SettleStageConfig, settle
from f3sr.stages.uncertainty import Uncertain, uncertainty
from f3sr.uncertainty.config import UncertaintyConfig
from f3sr.uncertainty.pose_information import precisions

BESIDE = 2_000_000
"""Largest photo [pixels] that is completed in parallel with the other stages; that takes 100 bytes a pixel."""
REPEATED_BY_REFINE = {"align", "align-objects", "separate", "settle"}
"""Stages that ``refine`` repeats: skipping one of them skips ``refine``."""


@settings
class Config:
    """The settings of every stage; ``f3sr config`` prints them with unit, range and meaning.

    Values out of range raise ValueError. Change one with ``dataclasses.replace``.
    """

    assemble: AssembleConfig = field(default_factory=AssembleConfig)
    level: LevelConfig = field(default_factory=LevelConfig)
    align: AlignConfig = field(default_factory=AlignConfig)
    relate: RelateConfig = field(default_factory=RelateConfig)
    decompose: ProxyConfig = field(default_factory=ProxyConfig)
    separate: SeparateConfig = field(default_factory=SeparateConfig)
    settle: SettleStageConfig = field(default_factory=SettleStageConfig)
    close: CloseConfig = field(default_factory=CloseConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    coarsen: CoarsenConfig = field(default_factory=CoarsenConfig)
    uncertainty: UncertaintyConfig = field(default_factory=UncertaintyConfig)
    evaluate: EvaluateConfig = field(default_factory=EvaluateConfig)
    inpaint: BackgroundConfig = field(default_factory=BackgroundConfig)


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
        """Measures and decisions of every stage, in order, for people and report.html."""
        return tuple(outcome.report for outcome in self.outcomes)


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
    at_rest = partial(_rested, config=config.settle)
    again = partial(_made_again, config=config, closes="close" not in skip)
    balanced = partial(_moved_into_balance, config=config, closes="close" not in skip)

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
    scene, _ = run.stage(Closed, close, scene, config.close, settled=at_rest, restless=settled.restless)
    scene, refined = run.stage(
        Refined,
        refine,
        scene,
        config.refine,
        aligned=made,
        parted=parted,
        balanced=balanced,
        replaced=again,
        stood_up=partial(again, aligning=config.align.upright(within=UPRIGHT), gives_up=False),
        realigned=partial(again, aligning=config.align.under_contact()),
        restless=settled.restless,
    )
    scene, _ = run.stage(
        Coarsened,
        coarsen,
        scene,
        config.coarsen,
        made=made,
        joins=decomposed.joins,
        settled=partial(_rested, config=config.settle.within(ROUNDS)),
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


def with_shared_settings(config: Config) -> Config:
    """The settings with one contact margin for every stage, that of the physics in which the scene settles, and one
    kind of footings, that of ``separate``."""
    contact = config.settle.physics.contact
    return replace(
        config,
        relate=replace(config.relate, contact=contact),
        separate=replace(config.separate, contact=contact),
        close=replace(config.close, contact=contact, footing=config.separate.footing),
        refine=replace(config.refine, contact=contact),
        coarsen=replace(config.coarsen, contact=contact, footing=config.separate.footing),
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


def _rested(scene: Scene, config: SettleStageConfig) -> SettledScene:
    scene, settled = settle(scene, config)
    return SettledScene(scene=scene, restless=settled.restless)


def _made_again(
    scene: Scene,
    ids: Collection[int],
    *,
    start: Scene | None = None,
    moving: frozenset[int] | None = None,
    balanced: frozenset[int] = frozenset(),
    aligning: AlignConfig | None = None,
    config: Config,
    closes: bool,
    gives_up: bool = True,
) -> SettledScene:
    """The scene after another alignment of some objects, if any, as it would be delivered: at rest and closed.

    Objects that are not ``moving`` are held where they rest; the others begin where they are in ``start``. By default
    groups move that gain by the alignment. They are separated, but for what is ``balanced``: with such objects all go
    to the nearest equilibrium. ``gives_up``: groups that lost too much by then are not closed, but put back."""
    aligned = start or scene
    if aligning:
        aligned, _ = align(aligned, aligning, only=ids)
    contact = config.refine.contact
    retry = Retry.of(scene, aligned, ids, contact) if moving is None else Retry.of_moving(scene, aligned, moving)
    if not retry.moving:
        return SettledScene(scene=scene, restless=frozenset())
    if retry.moving & balanced:
        rested = _nearest_balance(retry.scene, _costs(retry.scene, config), config)
    else:
        parted, _ = separate(retry.scene, config.separate, ground=False, margin=False)
        rested = _rested(parted, config.settle)
    return _ended(retry, rested, config, closes=closes, gives_up=gives_up)


def _moved_into_balance(
    scene: Scene, ids: Collection[int], *, start: Scene, moving: frozenset[int], config: Config, closes: bool
) -> SettledScene:
    """As ``_made_again``, but ``moving`` objects go to their nearest equilibrium instead of being separated.

    Closing cuts colliders back where they meet. If it then moves a group off its masks, the equilibrium is sought once
    more, with colliders that are cut back as to lower the group from the first one."""
    contact, retry = config.refine.contact, Retry.of_moving(scene, start, moving)
    rested = _balanced(retry.scene, config)
    best = _ended(retry, rested, config, closes=closes)
    if moved_off_masks(best, rested, contact):
        down = lowered(rested.scene, config.close)
        cut = (replace(o, parts=down[o.id].parts) for o in retry.scene if o.id in moving)
        retry = replace(retry, scene=retry.scene.with_objects(*cut))
        again = _ended(retry, _balanced(retry.scene, config), config, closes=closes)
        best = best.or_better(again, contact.apart)
    return best


def _ended(retry: Retry, rested: SettledScene, config: Config, *, closes: bool, gives_up: bool = True) -> SettledScene:
    """What came to rest as it would be delivered: closed, if it is worth it, and with all that was held free again."""
    contact, at_rest = config.refine.contact, partial(_rested, config=config.settle)
    retry = retry.without_losers(rested, contact) if gives_up else replace(retry, scene=rested.scene)
    scene = retry.scene
    if closes and retry.moving:
        scene, _ = close(scene, config.close, settled=at_rest, restless=rested.restless)
    return retry.ended(replace(rested, scene=scene), contact, settled=at_rest)


def _balanced(scene: Scene, config: Config) -> SettledScene:
    """Contact groups at rest near their equilibria, each at the best of up to three.

    Another one is sought while some group loses much of what it showed: from where nothing overlaps, and from where the
    best so far rests."""
    contact, seen = config.refine.contact, SettledScene(scene=scene, restless=frozenset())
    search = partial(_nearest_balance, scene, _costs(scene, config), config)
    best = search()
    if moved_off_masks(best, seen, contact):
        best = best.or_better(search(apart=True), contact.apart)
    if moved_off_masks(best, seen, contact):
        best = best.or_better(search(start=best.scene), contact.apart)
    return best


def _costs(scene: Scene, config: Config) -> Mapping[int, Array]:
    """What moves of each free object cost in ``balance``, by id."""
    return precisions(scene, [o.id for o in scene if o.mobility != "fixed"], config.uncertainty)


def _nearest_balance(
    scene: Scene, costs: Mapping[int, Array], config: Config, *, apart: bool = False, start: Scene | None = None
) -> SettledScene:
    """Contact groups at rest near an equilibrium, each on the better of two kinds of footings."""
    contact = config.refine.contact
    footed = partial(on_own_footings, config=config.separate)
    placed = balance(scene, costs, contact, footed=footed, apart=apart, start=start)
    standing = on_footings_in_place(placed, config.separate)
    return _rested(placed, config.settle).or_better(_rested(standing, config.settle), contact.apart)


def settling(config: Config) -> Restarted:
    """What brings objects of a scene to rest from other poses, as ``reconstruct`` would deliver them."""
    return partial(_made_again, config=with_shared_settings(config), closes=True, gives_up=False)


def _without(config: AlignConfig, skip: Collection[str]) -> AlignConfig:
    return replace(
        config,
        camera=config.camera and "align-camera" not in skip,
        objects=config.objects and "align-objects" not in skip,
    )
