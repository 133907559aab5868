"""The work of a job: an input folder becomes a package, its goals are played, and all of it is measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from f3sr import pipeline, settings
from f3sr.backends.kinds import SCENE_GRAPHERS
from f3sr.background.completers import BACKGROUND_COMPLETERS, DEFAULT_COMPLETER
from f3sr.batch.job import Job
from f3sr.dataset.layout import PACKAGE_FOLDER
from f3sr.dataset.storage import is_full
from f3sr.delivery import deliver
from f3sr.errors import F3srError, InputError
from f3sr.film.studio import FilmConfig, Studio
from f3sr.goals.file_names import FILM
from f3sr.goals.refusal import Refusal
from f3sr.io.input_folder import INPUT_FOLDER
from f3sr.io.inputs import Fillers
from f3sr.lifting.generators import ASSET_GENERATORS
from f3sr.metrology.estimators import GEOMETRY_ESTIMATORS, NORMAL_ESTIMATORS
from f3sr.photo_inputs import read_inputs
from f3sr.pipeline import Reconstruction
from f3sr.play.goal_loop import Played, simulate_goal
from f3sr.play.rollout_folder import write_film, write_played
from f3sr.runtime import kernels
from f3sr.runtime.progress import Progress, timed, words_to
from f3sr.runtime.result_store import Store
from f3sr.scene_package.package import Package, read_package
from f3sr.scene_package.package_folder import PACKAGE, ROLLOUTS, is_package

if TYPE_CHECKING:
    from f3sr.scene_package.scene_json import ObjectRecord

Patiently = Callable[[Callable[[], Any]], Any]
"""Calls an action, again and again while the disk is full."""


def preload() -> None:
    """Import what jobs use and load compiled kernels, once for all jobs of a worker."""
    kernels.warm_up()
    from f3sr.physics.mujoco_model import engine

    engine()


def work(
    job: Job, source: Path, folder: Path, stages: Path, *, progress: Progress, patiently: Patiently
) -> dict[str, Any]:
    """Make ``folder/package`` of an input folder; returns rows of scene, objects and goals for the record.

    Finished stages are kept in ``stages``, so that a killed job goes on where it ended. Raises InputError for bad
    input.
    """
    if is_package(source):
        raise InputError(source, found=PACKAGE, accepted=INPUT_FOLDER)
    names = job.backends
    fillers = Fillers(
        geometry=GEOMETRY_ESTIMATORS.find(names["geometry"], job.choice) if "geometry" in names else None,
        normals=NORMAL_ESTIMATORS.find(names["normals"], job.choice) if "normals" in names else None,
        assets=ASSET_GENERATORS.find(names["assets"], job.choice) if "assets" in names else None,
        scene_graph=SCENE_GRAPHERS.find(names["scene_graph"], job.choice) if "scene_graph" in names else None,
    )
    background = names.get("background", DEFAULT_COMPLETER)
    config = settings.with_values(job.name, job.settings, pipeline.Config())
    with timed("read", progress):
        given = read_inputs(
            source, ignore=job.ignore, asset_frame=job.asset_frame, fillers=fillers.telling(words_to(progress))
        )
    result = pipeline.reconstruct(
        given,
        config,
        skip=job.skip,
        background=BACKGROUND_COMPLETERS.find(background, job.choice) if background != DEFAULT_COMPLETER else None,
        store=Store(stages),
        progress=progress,
    )
    out = folder / PACKAGE_FOLDER
    patiently(lambda: deliver(result, out, overwrite=True, times=False, progress=progress))
    package = read_package(out)
    goals = goal_rows(package, job, progress, patiently)
    return {
        "scene": _scene(result) | {"goals": len(goals), "goals_met": sum(g["state"] == "met" for g in goals)},
        "objects": [_object(record, result) for record in package.document.objects],
        "goals": goals,
        "stages": result.seconds,
    }


def goal_rows(package: Package, job: Job, progress: Progress, patiently: Patiently) -> list[dict[str, Any]]:
    """The goals of a job played in its package, with films if it asks for them."""
    return _Goals(package, job, progress, patiently).played()


class _Goals:
    """The goals of one package, played one after another into its folder of rollouts."""

    def __init__(self, package: Package, job: Job, progress: Progress, patiently: Patiently) -> None:
        self.package, self.job, self.progress, self.patiently = package, job, progress, patiently
        self.studio: Studio | None = None

    def played(self) -> list[dict[str, Any]]:
        return [self._row(number, goal) for number, goal in enumerate(self.job.goals, 1)]

    def _row(self, number: int, goal: str) -> dict[str, Any]:
        """One goal; what is refused, or cannot be played, is a row with its reason."""
        row: dict[str, Any] = {"number": number, "goal": goal}
        try:
            with timed(f"goal {number}", self.progress):
                played = simulate_goal(self.package, goal)
            if isinstance(played, Refusal):
                return row | {"state": "refused", "goal_reason": f"{played.reason}: {played.message}"}
            place = Path(ROLLOUTS, str(number))
            self.patiently(lambda: write_played(played, self.package.folder / place, overwrite=True))
        except F3srError as error:
            if is_full(error):
                raise
            return row | {"state": "failed", "goal_reason": str(error)}
        filmed = self._film(played, place) if self.job.film else {}
        return row | _told(played) | {"folder": place.as_posix()} | filmed

    def _film(self, played: Played, place: Path) -> dict[str, Any]:
        """Where the film of a goal is; one that fails leaves the goal as it is."""
        try:
            with timed("film", self.progress):
                self.studio = self.studio or Studio.of(self.package, FilmConfig())
                made = self.studio.film(played)
            self.patiently(lambda: write_film(made.files, self.package.folder / place))
        except F3srError as error:
            if is_full(error):
                raise
            return {"film_reason": str(error)}
        return {"film": (place / FILM).as_posix()}


def _told(played: Played) -> dict[str, Any]:
    phases = played.plan.phases
    return {
        "state": "met" if played.verdict.met else "missed",
        "goal_reason": "" if played.verdict.met else played.verdict.said,
        "margin": played.verdict.margin,
        "rollouts": played.plan.rollouts,
        "task": ", ".join(phase.task.kind for phase in phases),
        "interpretation": ", then ".join(phase.task.interpretation for phase in phases),
        "simulated_s": sum(phase.simulation.duration for phase in phases),
    }


def _scene(result: Reconstruction) -> dict[str, Any]:
    """Measures of the result, those of direct composition, and how many fallbacks there were."""
    row: dict[str, Any] = {"fallbacks": sum(len(report.fallbacks) for report in result.reports)}
    if result.evaluation is None:
        return row
    if result.evaluation.direct is not None:
        direct: Mapping[str, float] = result.evaluation.direct.as_dict()
        row |= {f"direct_{name}": direct[name] for name in ("mIoU", "mIoU_visible", "PSNR")}
    return row | result.evaluation.result.as_dict()


def _object(record: ObjectRecord, result: Reconstruction) -> dict[str, Any]:
    names = ("id", "label", "mask", "mobility", "material", "mass", "density", "friction", "restitution")
    row: dict[str, Any] = {name: getattr(record, name) for name in names}
    row |= {
        "parts": len(record.collision) - record.footing,
        "footing": record.footing,
        "supported_by": record.supported_by,
    }
    if result.evaluation is None:
        return row
    details = result.evaluation.result_details
    with suppress(StopIteration):
        seen = next(o for o in details.objects if o.id == record.id)
        row |= {"IoU": seen.IoU, "IoU_visible": seen.IoU_visible}
    with suppress(StopIteration):
        gap = next(g for g in details.gaps if g.id == record.id)
        row |= {"gap_m": gap.distance, "below_m": gap.below}
    return row
