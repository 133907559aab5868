"""The work of a job, by its kind: from a project's files to others, each written whole or not at all."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from f3sr import pipeline
from f3sr.agents.played_by_model import Agent
from f3sr.background.completers import BACKGROUND_COMPLETERS
from f3sr.certificate.certification import certify
from f3sr.delivery import deliver
from f3sr.edits import deliver_edited, read_edits
from f3sr.errors import F3srError, InputError
from f3sr.files import strict_json
from f3sr.film.studio import FilmConfig, film_played
from f3sr.goals.file_names import PLAN
from f3sr.goals.refusal import Refusal
from f3sr.io.images import encode_png
from f3sr.io.inputs import Fillers
from f3sr.io.photo_hints import PhotoHints, known_of
from f3sr.lifting.generators import ASSET_GENERATORS
from f3sr.metrology.estimators import GEOMETRY_ESTIMATORS
from f3sr.photo_inputs import read_inputs
from f3sr.play.goal_loop import Played, replay_plan, simulate_goal
from f3sr.play.rollout_folder import read_plan, write_film, write_played
from f3sr.play.sample_rollouts import success_rate
from f3sr.play.telling import telling
from f3sr.report import Report
from f3sr.runtime import kernels
from f3sr.runtime.atomic_file import write_whole
from f3sr.runtime.progress import Progress, Step, timed, words_to
from f3sr.runtime.result_store import Store
from f3sr.scene import Scene
from f3sr.scene_export import export_package
from f3sr.scene_package.package import prepare_output, read_package
from f3sr.scene_samples import sample_scenes
from f3sr.studio.job_options import (
    CertifyOptions,
    ExportOptions,
    JobOptions,
    PlayOptions,
    ReconstructOptions,
    VaryOptions,
)
from f3sr.studio.job_record import SHOWN_STAGES, JobFolder
from f3sr.studio.plan_variation import varied
from f3sr.studio.workspace import Project
from f3sr.vision.pictures import Backdrop, overlay

PICTURE = 900
"""Longest side of such a picture [px]."""


def work(job: JobFolder, options: JobOptions, project: Project) -> dict[str, Any]:
    """Do a job and return what its page is told. Raises F3srError where it cannot be done; nothing is half written."""

    def progress(step: Step) -> None:
        job.tell("step", **asdict(step))

    match options:
        case ReconstructOptions():
            return _reconstruct(job, options, project, progress)
        case PlayOptions():
            return _play(options, project, progress)
        case VaryOptions():
            return _vary(options, project, progress)
        case ExportOptions():
            package = read_package(project.package)
            export_package(package, project.exported, options.formats, overwrite=True, progress=progress)
            return {}
        case CertifyOptions():
            package = read_package(project.package)
            certify(package, project.certificate, clients=options.engines, overwrite=True, progress=progress)
            return {}
        case _:
            raise AssertionError(options)


def _reconstruct(job: JobFolder, options: ReconstructOptions, project: Project, progress: Progress) -> dict[str, Any]:
    fillers = Fillers(
        geometry=GEOMETRY_ESTIMATORS.find(options.geometry) if options.geometry else None,
        assets=ASSET_GENERATORS.find(options.assets) if options.assets else None,
    )
    hints = PhotoHints(focal=options.focal, camera_height=options.camera_height, known=known_of(options.known))
    background = BACKGROUND_COMPLETERS.find(options.background) if options.background else None
    edits = read_edits(project.edits) if project.edits.exists() else ()
    with kernels.compiling() as compilers:
        with timed("read", progress):
            given = read_inputs(project.input, fillers=fillers.telling(words_to(progress)), hints=hints)
        prepare_output(project.package, inputs=project.input, overwrite=True, edits=True)
        compilers.begin(progress)
        result = pipeline.reconstruct(
            given, background=background, store=Store.default(), progress=progress, seen=_drawn(job)
        )
        for report in result.reports:
            _tell(job, report)
        if edits:
            _, session = deliver_edited(result, edits, project.package, overwrite=True, progress=progress)
            _tell(job, session.report)
        else:
            deliver(result, project.package, overwrite=True, progress=progress)
    project.outlines_changed.unlink(missing_ok=True)
    return {"measures": result.evaluation.result.as_dict() if result.evaluation else {}}


def _drawn(job: JobFolder) -> Callable[[str, Scene], None]:
    """Draws the scene over the photo after some stages, and says where the picture is."""

    def seen(stage: str, scene: Scene) -> None:
        if name := SHOWN_STAGES.get(stage):
            file = f"{name}.png"
            write_whole(job.pictures / file, encode_png(overlay(scene, Backdrop.of(scene, PICTURE))))
            job.tell("picture", name=name, file=file)

    return seen


def _tell(job: JobFolder, report: Report) -> None:
    for decision in report.decisions:
        job.tell("decision", stage=report.stage, **asdict(decision))


def _play(options: PlayOptions, project: Project, progress: Progress) -> dict[str, Any]:
    package, start = read_package(project.package), time.perf_counter()
    with timed("search for a launch that does it", progress):
        agent = Agent.of(options.model) if options.model else None
        played = agent.simulate(package, options.goal) if agent else simulate_goal(package, options.goal)
    if isinstance(played, Refusal):
        return telling(options.goal, played, None, time.perf_counter() - start, replayed=False)
    told = _written(options.goal, played, project, options.slow, progress, replayed=False)
    if not options.samples:
        return told
    with timed(f"draw {options.samples} samples", progress):
        scenes = [drawn.sample.scene for drawn in sample_scenes(package, options.samples)]
    if not scenes:
        raise F3srError("the film stands, but no sample of the scene rests on its masks")
    with timed("play in the samples", progress):
        rate = success_rate(played.plan, scenes)
    return told | {"samples": {"count": rate.count, "met": rate.met, "interval": list(rate.interval)}}


def _vary(options: VaryOptions, project: Project, progress: Progress) -> dict[str, Any]:
    folder = project.rollouts / str(options.rollout)
    if not (folder / PLAN).is_file():
        raise InputError("the rollout", found=str(options.rollout), accepted="one that was played")
    plan = varied(read_plan(folder / PLAN), speed=options.speed, turn=math.radians(options.turn))
    with timed("play it", progress):
        played = replay_plan(read_package(project.package), plan)
    told = _written(plan.goal, played, project, options.slow, progress, replayed=True)
    before = project.rollouts / f"{options.rollout}.json"
    speed, turn = 1.0, 0.0
    if before.exists():  # of what was itself varied
        known = strict_json.read(before, most=1000, accepted="a variation")
        speed, turn = float(known["speed"]), float(known["turn"])
    varied_by = {"of": options.rollout, "speed": speed * options.speed, "turn": turn + options.turn}
    write_whole(project.rollouts / f"{told['rollout']}.json", json.dumps(varied_by).encode())
    return told


def _written(
    goal: str, played: Played, project: Project, slow: float, progress: Progress, *, replayed: bool
) -> dict[str, Any]:
    """The rollout and its film in the next folder."""
    project.rollouts.mkdir(exist_ok=True)
    taken = [int(entry.name) for entry in project.rollouts.iterdir() if entry.name.isdigit()]
    number, start = max(taken, default=0) + 1, time.perf_counter()
    place = write_played(played, project.rollouts / str(number))
    with timed("film it", progress):
        filmed = film_played(read_package(project.package), played, FilmConfig(slow=slow))
        write_film(filmed.files, place)
    told = telling(goal, played, place, time.perf_counter() - start, replayed=replayed)
    del told["folder"]
    return told | {"rollout": number, "said": played.verdict.said, "decisions": list(filmed.decisions)}
