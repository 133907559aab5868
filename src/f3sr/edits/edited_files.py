"""The files of an edited package: its scene, its list of edits, and the package as it was before them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

from pydantic import JsonValue

from f3sr.delivery import deliver
from f3sr.edits.edit_list import Edit, edits_digest, edits_json
from f3sr.edits.edit_session import EditSession
from f3sr.edits.unedited import BEHIND
from f3sr.errors import require_kind
from f3sr.options import EDIT
from f3sr.pipeline import Reconstruction
from f3sr.report import Measure, Outcome
from f3sr.report_page import report_page
from f3sr.runtime.atomic_folder import claimed
from f3sr.runtime.progress import Progress, silent, timed
from f3sr.scene import Scene
from f3sr.scene_package.package import package_files, read_package
from f3sr.scene_package.package_folder import EDITS, PAGE, SCENE, UNEDITED, placed, require_replaceable
from f3sr.scene_package.scene_json import ObjectRecord, SceneDocument, to_document, to_json
from f3sr.stages.evaluate import Evaluation
from f3sr.vision.pictures import pictures_of


@dataclass(frozen=True, kw_only=True)
class EditsApplied(Outcome):
    """All edits of a list, as one stage after the others."""

    stage: ClassVar[str] = EDIT
    numbers: tuple[Measure, ...] = ()

    @property
    def measures(self) -> tuple[Measure, ...]:
        return self.numbers


def write_edited(
    session: EditSession, out: str | Path, *, overwrite: bool = False, progress: Progress = silent
) -> Path:
    """Write the edited package to ``out``, which may be the session's own folder, and return the folder's full path.

    Raises OutputError if ``out`` is not an f3sr package, or is one with rollouts without ``overwrite``."""
    require_kind("session", session, EditSession, accepted="f3sr.EditSession(...)")
    folder = placed(out)
    with (
        timed("package", progress),
        claimed(folder, lambda folder: require_replaceable(folder, overwrite=overwrite, edits=True)) as claim,
    ):
        for name, data in edited_files(session):
            claim.write(name, data)
        claim.replace()
    return folder


def deliver_edited(
    result: Reconstruction,
    edits: Sequence[Edit],
    out: str | Path,
    *,
    overwrite: bool = False,
    progress: Progress = silent,
) -> tuple[Path, EditSession]:
    """Write a reconstruction with edits as a package, and return the folder's full path and the session.

    The edits are those of the package that ``deliver`` writes, read again: the poses are the same to the bit."""
    with TemporaryDirectory(prefix="f3sr-") as made:
        package = read_package(deliver(result, Path(made) / "package", progress=progress))
        session = EditSession(package, edits, config=result.config, progress=progress)
    return write_edited(session, out, overwrite=overwrite, progress=progress), session


def edited_files(session: EditSession) -> Iterator[tuple[str, bytes]]:
    """Every file of the edited package with its relative path: the same for equal packages and lists.

    Without edits it is the package itself. scene.json comes last."""
    base, edits, files = session.unedited.package, session.edits, session.unedited.files
    reconstruction = _as_reconstruction(session)
    document = edited_document(session)
    yield from ((name, files[name]) for name in BEHIND if name in files)
    if edits:
        yield EDITS, edits_json(edits)
        yield from ((f"{UNEDITED}/{name}", data) for name, data in files.items())
    made = package_files(
        session.scene,
        direct=reconstruction.direct if base.direct else None,
        metrics={},
        provenance={},
        report=_report(session),
        pictures=pictures_of(reconstruction.direct, session.scene),
        page=_page(session, reconstruction),
    )
    yield from (file for file in made if file[0] != SCENE)
    yield SCENE, to_json(document)


def edited_document(session: EditSession) -> SceneDocument:
    """scene.json of the edited package. Objects that no edit moved have the very record of before."""
    base, edits = session.unedited.package, session.edits
    if not edits:
        return base.document
    outcome = session.outcome
    known = {id: u for id, u in base.uncertainty.items() if id not in outcome.given}
    provenance: dict[str, JsonValue] = {
        **base.document.provenance,
        "edits": {"count": len(edits), "sha256": edits_digest(edits), "of": session.unedited.digest},
    }
    made = to_document(
        outcome.scene,
        direct=_some(base.direct, outcome.scene) if base.direct else None,
        uncertainty=known,
        metrics={**base.document.metrics, **outcome.measures.as_dict()},
        provenance=provenance,
    )
    before = {record.id: record for record in base.document.objects}
    same = {o.id for o in outcome.scene if o is base.scene[o.id]}
    objects = tuple(_kept(before[r.id], r) if r.id in same else r for r in made.objects)
    return made.model_copy(update={"objects": objects})


def _kept(before: ObjectRecord, now: ObjectRecord) -> ObjectRecord:
    """The record of before, with the paths of now: numbers that are computed again may differ by rounding."""
    return before.model_copy(update={"mesh": now.mesh, "collision": now.collision, "footing": now.footing})


def _as_reconstruction(session: EditSession) -> Reconstruction:
    """The edits as a run of one stage, from the package before them: what the report shows."""
    base, outcome = session.unedited.package, session.outcome
    report = session.report
    before = _some(base.scene, outcome.scene)
    direct = _some(base.direct, outcome.scene) if base.direct else before
    done = EditsApplied(decisions=report.decisions, numbers=report.measures)
    return Reconstruction(
        scene=outcome.scene,
        direct=direct,
        scenes={"package": before, done.stage: outcome.scene},
        outcomes=(done,),
        seconds={},
        resumed=(),
        config=session.config,
        provenance=base.document.provenance,
        uncertainty={id: u for id, u in base.uncertainty.items() if id not in outcome.given},
        evaluation=Evaluation(
            result=outcome.measures, direct=None, result_details=outcome.details, direct_details=None
        ),
    )


def _page(session: EditSession, reconstruction: Reconstruction) -> Callable[[], bytes] | None:
    """What makes report.html: the edits' own, or without edits that of the package, where it has one."""
    kept = session.unedited.files.get(PAGE)
    if session.edits:
        return partial(report_page, reconstruction)
    return None if kept is None else lambda: kept


def _some(scene: Scene, like: Scene) -> Scene:
    """The objects of a scene that another one has too."""
    ids = {o.id for o in like}
    return replace(scene, objects=tuple(o for o in scene if o.id in ids))


def _report(session: EditSession) -> Mapping[str, Any]:
    """report.json: that of the package, with the edits as one more stage."""
    tree = session.unedited.report
    if not session.edits:
        return tree
    measures = {**tree.get("measures", {}), "edited": session.outcome.measures.as_dict()}
    return {**tree, "measures": measures, "stages": [*tree.get("stages", []), asdict(session.report)]}
