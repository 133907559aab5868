"""A package, a list of edits, and the scene after each of them: edits are added, undone and done again."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from f3sr.edits.applying import Applied, apply_edit, refused
from f3sr.edits.edit_list import EDITS, KINDS, MAX_EDITS, Edit
from f3sr.edits.landing import Effort, editing
from f3sr.edits.unedited import Unedited, read_edited
from f3sr.errors import InputError, OutputError, require_kind, require_path
from f3sr.metrics.measures import Details, Measures, MeshMeasures, measure_with_details
from f3sr.options import EDIT
from f3sr.pipeline_config import Config
from f3sr.report import Decision, Measure, Report
from f3sr.runtime.daemon_thread import begun
from f3sr.runtime.progress import Progress, silent, timed
from f3sr.scene import Scene
from f3sr.scene_package.package import Package, faults
from f3sr.scene_package.scene_json import to_document

REST = 0.1
"""Largest travel of a centre of mass in 5 s of undamped physics [cm] that counts as rest."""
EFFORTS = (Effort(), Effort(again=2), Effort(closes=False, again=2))
"""In this order until the scene rests and nothing crosses."""


@dataclass(frozen=True, eq=False, kw_only=True)
class EditOutcome:
    """The scene after an edit, measured, and what a user should know of it."""

    number: int
    """Of the edit in its list, from 1; 0 of the scene before all edits."""
    edit: Edit | None
    scene: Scene
    measures: Measures
    details: Details
    """Measures per object, gaps and overlaps with their places."""
    decisions: tuple[Decision, ...]
    """Of this edit alone; a fallback tells what was done otherwise than asked."""
    moved: frozenset[int]
    """Ids of objects that are other values than before."""
    given: frozenset[int]
    """Ids of objects whose poses are no longer those of the photo, by any edit so far."""
    done: bool
    """False where the edit was not applied."""
    seconds: float
    """Wall time [s], measuring included."""


class EditSession:
    """Edits of a package, one after another. Equal packages and equal lists give equal bytes.

    Every state stays in memory: ``undo`` and ``redo`` are instant, and the next edit starts from the last scene."""

    def __init__(
        self,
        package: Package,
        edits: Sequence[Edit] = (),
        *,
        config: Config | None = None,
        progress: Progress = silent,
    ) -> None:
        """Start from a package as it is, and apply a list to it. Raises InputError for anything but a package."""
        require_kind("package", package, Package, accepted="f3sr.read_package(...)")
        self.unedited = Unedited.of(package)
        """The package before all edits."""
        self.config = config or Config()
        self._editing = editing(self.config)
        self._outcomes = [_measured_base(package.scene)]
        self._undone: list[EditOutcome] = []
        for edit in edits:
            self.add(edit, progress=progress)

    @classmethod
    def open(cls, folder: str | Path, *, config: Config | None = None, progress: Progress = silent) -> Self:
        """The session of a package folder: one that was edited goes on with its list. Raises InputError."""
        base, edits = read_edited(require_path("folder", folder))
        return cls(base, edits, config=config, progress=progress)

    @property
    def edits(self) -> tuple[Edit, ...]:
        """Those that are applied, in order."""
        return tuple(o.edit for o in self._outcomes if o.edit is not None)

    @property
    def outcome(self) -> EditOutcome:
        """The state of now."""
        return self._outcomes[-1]

    @property
    def outcomes(self) -> tuple[EditOutcome, ...]:
        """Of every edit that is applied, in order, after that of the scene before all."""
        return tuple(self._outcomes)

    @property
    def scene(self) -> Scene:
        return self.outcome.scene

    @property
    def can_undo(self) -> bool:
        return len(self._outcomes) > 1

    @property
    def can_redo(self) -> bool:
        return bool(self._undone)

    @property
    def report(self) -> Report:
        """The result sheet of all edits, as of a stage; it tells once more what nothing that is seen carries."""
        first, last = self._outcomes[0], self.outcome
        told = tuple(d for o in self._outcomes for d in o.decisions)
        held = tuple(_still_held(o.id) for o in self.scene if o.mobility_source == "found")
        names = (("mIoU_visible", ""), ("N_cross", ""), ("K_max_J", "J"), ("D_max_cm", "cm"), ("gap_pct", "%"))
        was, now = first.measures.as_dict(), last.measures.as_dict()
        measures = tuple(Measure(name=n, before=was[n], after=now[n], unit=unit) for n, unit in names)
        return Report(stage=EDIT, measures=measures, decisions=(*told, *held))

    def add(self, edit: Edit, *, progress: Progress = silent) -> EditOutcome:
        """Apply an edit to the scene of now, and measure it. What was undone before is forgotten.

        Raises InputError for what is no edit and where the list is full. An edit that does not fit stays in the list
        and changes nothing: its outcome's decision says why."""
        require_kind("edit", edit, *EDITS, accepted=f"an edit as f3sr.read_edits gives: {', '.join(KINDS)}")
        if len(self._outcomes) > MAX_EDITS:
            raise InputError("edits", found=f"{MAX_EDITS + 1} edits", accepted=f"at most {MAX_EDITS}")
        number = len(self._outcomes)
        with timed(f"edit {number}: {edit.kind} object {edit.id}", progress):
            self._outcomes.append(_outcome(self.outcome, edit, number, self._editing))
        self._undone.clear()
        return self.outcome

    def undo(self) -> EditOutcome:
        """The state before the last edit. Raises InputError where there is none."""
        if not self.can_undo:
            raise InputError("undo", found="no edit", accepted="a session with edits")
        self._undone.append(self._outcomes.pop())
        return self.outcome

    def discard(self) -> EditOutcome:
        """The state before the last edit, which is forgotten: ``redo`` does not bring it back. Raises InputError."""
        outcome = self.undo()
        self._undone.pop()
        return outcome

    def redo(self) -> EditOutcome:
        """The state after the edit that was undone last. Raises InputError where there is none."""
        if not self.can_redo:
            raise InputError("redo", found="nothing undone", accepted="a session with an undone edit")
        self._outcomes.append(self._undone.pop())
        return self.outcome


def _measured_base(scene: Scene) -> EditOutcome:
    start = time.perf_counter()
    measures, details = _measured(scene)
    return EditOutcome(
        number=0,
        edit=None,
        scene=scene,
        measures=measures,
        details=details,
        decisions=(),
        moved=frozenset(),
        given=frozenset(),
        done=True,
        seconds=time.perf_counter() - start,
    )


def _outcome(before: EditOutcome, edit: Edit, number: int, config: Config) -> EditOutcome:
    """The state after an edit; the one of before where the edit would make surfaces cross."""
    start = time.perf_counter()
    applied, measures, details = _tried(before, edit, number, config)
    known = {o.id: o for o in before.scene}
    return EditOutcome(
        number=number,
        edit=edit,
        scene=applied.scene,
        measures=measures,
        details=details,
        decisions=(*applied.decisions, *_restless(applied, measures, number)),
        moved=frozenset(o.id for o in applied.scene if o is not known[o.id]),
        given=(before.given | applied.given) & {o.id for o in applied.scene},
        done=applied.done,
        seconds=time.perf_counter() - start,
    )


def _tried(before: EditOutcome, edit: Edit, number: int, config: Config) -> tuple[Applied, Measures, Details]:
    """The edit applied with the first effort that leaves the scene at rest and free of crossings, else with that after
    which it moves least; not at all where surfaces cross by all of them."""
    best: tuple[Applied, Measures, Details] | None = None
    crossings = 0
    for effort in EFFORTS:
        applied = apply_edit(before.scene, edit, number, config, effort)
        if applied.done and (fault := _unwritable(applied.scene)):
            applied = refused(before.scene, edit, number, fault)
        if not applied.done or _measures_alike(before.scene, applied.scene):
            return applied, before.measures, before.details
        measures, details = _measured(applied.scene)
        if measures.N_cross > before.measures.N_cross:
            crossings = measures.N_cross
        elif best is None or measures.D_max_cm < best[1].D_max_cm:
            best = applied, measures, details
        if best and best[1].D_max_cm <= max(REST, before.measures.D_max_cm):
            return best
    why = f"it would end in {crossings} crossings of surfaces, with no free place near"
    return best or (refused(before.scene, edit, number, why), before.measures, before.details)


def _unwritable(scene: Scene) -> str:
    """Why no package may hold a scene; nothing where one may."""
    for o in scene:
        if fault := next(faults(o, scene.camera), None):
            return f"object {o.id} would be one {fault}"
    try:
        to_document(scene, direct=None, uncertainty={}, metrics={}, provenance={})
    except OutputError as error:
        return str(error)
    return ""


def _measured(scene: Scene) -> tuple[Measures, Details]:
    return measure_with_details(scene, of_meshes=begun(MeshMeasures.of, scene).result)


def _measures_alike(a: Scene, b: Scene) -> bool:
    """Whether all measures of two scenes are equal: they know neither labels nor materials."""
    shape = ("mesh", "T_world_object", "parts", "footing")
    return len(a.objects) == len(b.objects) and all(
        (p.id, p.scale, p.mobility) == (q.id, q.scale, q.mobility)
        and all(getattr(p, name) is getattr(q, name) for name in shape)
        for p, q in zip(a, b, strict=True)
    )


def _restless(applied: Applied, now: Measures, number: int) -> list[Decision]:
    if not applied.done or now.D_max_cm <= REST:
        return []
    choice = f"edit {number}: the scene is not at rest"
    reason = f"released without damping, an object moves {now.D_max_cm:.2f} cm in 5 s"
    return [Decision(choice=choice, reason=reason, fallback=True)]


def _still_held(id: int) -> Decision:
    reason = "nothing that is seen carried it where the photo shows it; a support edit lets it move"
    return Decision(choice="still fixed", reason=reason, about=id, fallback=True)
