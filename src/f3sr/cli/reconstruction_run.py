"""From a prompted-image folder and a checked request to a package on disk, told on the console."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

from f3sr.errors import InputError
from f3sr.runtime.kept_imports import kept_imports

if TYPE_CHECKING:
    from f3sr.cli.run_request import RunRequest
    from f3sr.stages.evaluate import Evaluation


class Reading(TypedDict, total=False):
    """How ``read_inputs`` reads the folder, in its words."""

    ignore: Collection[str]
    asset_frame: str
    geometry_noise: float | None
    mask_overlap: float | None


def make_package(
    folder: Path,
    out: Path,
    request: RunRequest,
    *,
    skip: Collection[str] = (),
    formats: Sequence[str] = (),
    overwrite: bool = False,
    json: bool = False,
    **reading: Unpack[Reading],
) -> None:
    """Reconstruct the folder into ``out``, export it to ``formats``, and print measures and places.

    Raises F3srError."""
    with kept_imports():
        from f3sr import pipeline, scene_export
        from f3sr.cli import console
        from f3sr.delivery import deliver
        from f3sr.edits import deliver_edited
        from f3sr.io.input_folder import INPUT_FOLDER
        from f3sr.photo_inputs import read_inputs
        from f3sr.runtime import kernels
        from f3sr.runtime.progress import timed, words_to
        from f3sr.runtime.result_store import Store
        from f3sr.scene_package import package, package_folder
    if package_folder.is_package(folder):
        raise InputError(folder, found=package_folder.PACKAGE, accepted=INPUT_FOLDER)
    with console.steps_shown(quiet=json) as progress, kernels.compiling() as compilers:
        with timed("read", progress):
            fillers = request.fillers.telling(words_to(progress))
            given = read_inputs(folder, fillers=fillers, hints=request.hints, **reading)
        package.prepare_output(out, inputs=folder, overwrite=overwrite, edits=request.edits is not None)
        compilers.begin(progress)
        result = pipeline.reconstruct(
            given,
            request.config,
            skip=skip,
            background=request.background,
            store=Store.default(),
            progress=progress,
        )
        reports, columns = list(result.reports), columns_of(result.evaluation)
        if request.edits is None:
            written = deliver(result, out, overwrite=overwrite, progress=progress)
        else:
            written, session = deliver_edited(result, request.edits, out, overwrite=overwrite, progress=progress)
            reports.append(session.report)
            columns["edited"] = session.outcome.measures.as_dict()
        exported = None
        if formats:
            exported = scene_export.export_package(
                package.read_package(written), scene_export.beside(out), formats, overwrite=overwrite, progress=progress
            )
    if json:
        places = {"package": str(written), **({"export": str(exported)} if exported else {})}
        console.print_json({**places, "seconds": result.seconds, **columns})
        return
    console.say_fallbacks(reports)
    console.print_measures(columns)
    console.say(f"package:  {written}")
    console.say(f"report:   {written / package.PAGE}")
    if exported:
        console.say(f"export:   {exported}")


def columns_of(evaluation: Evaluation | None, name: str = "f3sr") -> dict[str, dict[str, float]]:
    """The measures of direct composition, where known, and of the result, by title."""
    return {title: measures.as_dict() for title, measures in evaluation.rows(name).items()} if evaluation else {}
