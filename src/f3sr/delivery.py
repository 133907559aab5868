"""deliver: a reconstruction written as a package, with its pictures and its report."""

from __future__ import annotations

from pathlib import Path

from f3sr.errors import require_kind
from f3sr.pipeline import Reconstruction
from f3sr.report_page import report_page
from f3sr.runtime.daemon_thread import begun
from f3sr.runtime.progress import Progress, silent, timed
from f3sr.scene_package import package
from f3sr.vision import pictures


def deliver(
    result: Reconstruction,
    out: str | Path,
    *,
    overwrite: bool = False,
    times: bool = True,
    progress: Progress = silent,
) -> Path:
    """Write the scene package (docs: conventions) to ``out`` and return the folder's full path.

    An older f3sr package there is replaced. One with rollouts is replaced only with ``overwrite``. An error leaves it
    unchanged. Without ``times`` report.json has no seconds, and equal inputs give equal bytes. Raises OutputError if
    ``out`` holds anything else, or cannot be written.
    """
    require_kind("result", result, Reconstruction, accepted="f3sr.reconstruct(...)")
    evaluation = result.evaluation
    page = begun(report_page, result)
    with timed("pictures", progress):
        shown = pictures.pictures_of(result.direct, result.scene)
    with timed("package", progress):
        return package.write_package(
            result.scene,
            out,
            direct=result.direct,
            uncertainty=result.uncertainty,
            metrics=evaluation.result.as_dict() if evaluation else {},
            provenance=result.provenance,
            reports=result.reports,
            rows={title: row.as_dict() for title, row in evaluation.rows().items()} if evaluation else {},
            seconds=result.seconds if times else {},
            pictures=shown,
            inpainting=result.inpainting,
            page=page.result,
            physics=result.config.settle.physics,
            overwrite=overwrite,
        )
