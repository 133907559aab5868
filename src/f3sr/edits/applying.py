"""One edit applied to a scene at rest: checked against it, put, brought to rest, and told where it ended otherwise."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from f3sr.core.transforms import Array
from f3sr.edits.edit_list import (
    DeleteEdit,
    Edit,
    FixEdit,
    LabelEdit,
    MaterialEdit,
    MoveEdit,
    ReleaseEdit,
    ScaleEdit,
    SupportEdit,
    TurnEdit,
)
from f3sr.edits.landing import Effort, Landed, land, settled, touching
from f3sr.edits.placing import Put, put, without
from f3sr.files.bounds import MAX_DENSITY, MAX_OBJECT, MIN_DENSITY, MIN_OBJECT
from f3sr.physics.mujoco_model import solid_of
from f3sr.pipeline_config import Config
from f3sr.report import Decision
from f3sr.runtime.machine import one_thread
from f3sr.scene import GROUND, Excluded, Scene, SceneObject, name_of
from f3sr.stages.relate import describe

TOLD = 1e-3
"""Distance [m] from where an edit put an object from which on that is told: contact margins move it by a third."""
TOLD_TURN = math.radians(1)
"""Turn [rad] against the edit's pose from which on that is told."""
SAID_OF = {"density": ("mass ", "density "), "friction": ("friction ",)}
"""How parts of a reason begin that tell of a property."""
STAYS_TURN = 1e-3
"""Turn [rad] below which an object that was at rest counts as still so, as is."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Applied:
    """A scene after an edit, at rest, and what a user should know of it."""

    scene: Scene
    decisions: tuple[Decision, ...] = ()
    given: frozenset[int] = frozenset()
    """Ids of objects whose poses are the edit's, not the photo's."""
    done: bool = True
    """False where the edit was not applied: the scene is the one of before."""


@one_thread()
def apply_edit(scene: Scene, edit: Edit, number: int, config: Config, effort: Effort) -> Applied:
    """The scene after an edit, the ``number``-th of its list. ``config`` is that of ``landing.editing``.

    Objects that do not touch what the edit moves, before or after, stay the very same values. An edit that does not
    fit the scene leaves it as it is: its decision, a fallback, says why.
    """
    if fault := _fault(scene, edit):
        return refused(scene, edit, number, fault)
    if isinstance(edit, LabelEdit):
        named = scene.with_objects(replace(scene[edit.id], label=edit.to))
        said = Decision(choice=f"edit {number}: called {edit.to!r}", reason=f"was {edit.label!r}", about=edit.id)
        return Applied(scene=_described(named, config), decisions=(said,))
    if isinstance(edit, FixEdit):
        held = scene.with_objects(replace(scene[edit.id], mobility="fixed", mobility_source="given"))
        said = Decision(choice=f"edit {number}: fixed where it is", reason="given", about=edit.id)
        return Applied(scene=_described(held, config), decisions=(said,), given=frozenset({edit.id}))
    if isinstance(edit, MaterialEdit):
        return _made_of(scene, edit, number, config, effort)
    if isinstance(edit, ReleaseEdit):
        return _let_go(scene, edit, number, config, effort)
    if isinstance(edit, DeleteEdit):
        return _taken_out(scene, edit, number, config, effort)
    return _moved(scene, edit, number, config, effort)


def refused(scene: Scene, edit: Edit, number: int, why: str) -> Applied:
    """The scene as it was, and a decision that says why."""
    about = edit.id if edit.id in {o.id for o in scene} else None
    said = Decision(choice=f"edit {number} ({edit.kind}) not applied", reason=why, about=about, fallback=True)
    return Applied(scene=scene, decisions=(said,), done=False)


def _fault(scene: Scene, edit: Edit) -> str:
    """Why an edit does not fit a scene; nothing where it does."""
    ids = {o.id for o in scene}
    if edit.id not in ids:
        return f"no object {edit.id}; the scene has {', '.join(map(str, sorted(ids)))}"
    o = scene[edit.id]
    if o.label != edit.label:
        return f"object {edit.id} is {o.label!r} here, the edit was made for {edit.label!r}"
    if isinstance(edit, SupportEdit):
        if edit.on != GROUND and edit.on not in ids:
            return f"no object {edit.on} to stand on; the scene has {', '.join(map(str, sorted(ids)))}"
        if edit.on in scene.subtree(edit.id):
            return f"object {edit.on} rests on object {edit.id} itself"
    if isinstance(edit, ScaleEdit) and not MIN_OBJECT <= o.size * edit.factor <= MAX_OBJECT:
        return f"of {o.size * edit.factor:.3g} m; accepted are {MIN_OBJECT} to {MAX_OBJECT:,.0f} m"
    if isinstance(edit, MaterialEdit) and edit.mass is not None:
        density = edit.mass / _volume(o)
        if not MIN_DENSITY <= density <= MAX_DENSITY:
            accepted = f"{MIN_DENSITY * _volume(o):.3g} to {MAX_DENSITY * _volume(o):.3g} kg"
            return f"{edit.mass:.3g} kg would be {density:.3g} kg/m3; of its size {accepted} can be"
    if isinstance(edit, DeleteEdit) and len(ids) == 1:
        return "it is the last object, and a scene has at least one"
    if isinstance(edit, FixEdit) and o.mobility == "fixed" and o.mobility_source != "found":
        return "it is fixed already"
    if isinstance(edit, ReleaseEdit) and o.mobility == "dynamic":
        return "physics moves it already"
    return ""


def _described(scene: Scene, config: Config) -> Scene:
    return describe(scene, config.relate)[0]


# --- poses --------------------------------------------------------------------------------------------------------


def _moved(
    scene: Scene, edit: MoveEdit | TurnEdit | ScaleEdit | SupportEdit, number: int, config: Config, effort: Effort
) -> Applied:
    decisions = list[Decision]()
    if isinstance(edit, SupportEdit) and scene[edit.id].mobility_source == "found":
        scene = scene.with_objects(replace(scene[edit.id], mobility="dynamic", mobility_source="default"))
        reason = "it was fixed only as nothing that is seen carried it"
        decisions.append(Decision(choice=f"edit {number}: physics moves it again", reason=reason, about=edit.id))
    there = put(scene, edit, number)
    landed = land(scene, there, config, effort)
    decisions.append(_asked(there, landed, edit, number))
    if isinstance(edit, SupportEdit) and edit.on not in landed.scene[edit.id].carriers:
        choice = f"edit {number}: does not stay on {name_of(edit.on)}; rests on {_carriers(landed.scene[edit.id])}"
        decisions.append(Decision(choice=choice, reason="it slid or fell off there", about=edit.id, fallback=True))
    decisions += _others(there.scene, landed, number, but=edit.id)
    return _applied(landed, there, decisions, number, config)


def _asked(there: Put, landed: Landed, edit: Edit, number: int) -> Decision:
    """Whether an object is where it was put."""
    put_there, now = there.scene[edit.id], landed.scene[edit.id]
    off, turn = put_there.way_to(now), put_there.angle_to(now)
    resting = f"rests on {_carriers(now)}" if now.mobility == "dynamic" else "is fixed"
    if there.note:
        return Decision(choice=f"edit {number}: {there.note}", reason=resting, about=edit.id, fallback=True)
    if (sunk := -float(now.bounds_world[0, 2])) > TOLD:
        choice = f"edit {number}: {edit.kind} as asked, {_length(sunk)} into the ground"
        return Decision(choice=choice, reason=resting, about=edit.id, fallback=True)
    if np.linalg.norm(off) <= TOLD and turn <= TOLD_TURN:
        return Decision(choice=f"edit {number}: {edit.kind} as asked", reason=resting, about=edit.id)
    choice = f"edit {number}: moved to rest, {_where(off, turn)} where it was put"
    return Decision(choice=choice, reason=f"it {resting}", about=edit.id, fallback=True)


def _others(
    was: Scene, landed: Landed, number: int, *, but: int | None = None, fallen: Collection[int] = ()
) -> list[Decision]:
    """Objects that came to move by an edit of another one."""
    found = list[Decision]()
    for id in sorted(landed.moving - {but}):
        off, turn = was[id].way_to(landed.scene[id]), was[id].angle_to(landed.scene[id])
        if np.linalg.norm(off) > TOLD or turn > TOLD_TURN:
            verb = "fell" if id in fallen else "moved"
            choice = f"edit {number}: {verb} too, to {_where(off, turn)} where it was"
            reason = f"it rests on {_carriers(landed.scene[id])}"
            found.append(Decision(choice=choice, reason=reason, about=id, fallback=True))
    return found


def _taken_out(scene: Scene, edit: DeleteEdit, number: int, config: Config, effort: Effort) -> Applied:
    there, gone = without(scene, edit.id), scene[edit.id]
    before = replace(scene, objects=tuple(scene[o.id] for o in there.scene))
    landed = land(before, there, config, effort)
    reason = f"deleted by edit {number}"
    excluded = (*landed.scene.excluded, Excluded(mask=gone.mask_name, reason=reason))
    landed = replace(landed, scene=replace(landed.scene, excluded=excluded))
    decisions = [Decision(choice=f"edit {number}: object {edit.id} {gone.label!r} deleted", reason="given")]
    decisions += _others(before, landed, number, fallen=there.placed)
    return _applied(landed, there, decisions, number, config)


def _let_go(scene: Scene, edit: ReleaseEdit, number: int, config: Config, effort: Effort) -> Applied:
    free = scene.with_objects(replace(scene[edit.id], mobility="dynamic", mobility_source="given"))
    there = Put(scene=free, placed=frozenset({edit.id}), roots=(edit.id,))
    if scene[edit.id].supported_by is not None and (stays := _staying(free, edit.id, config)):
        said = Decision(choice=f"edit {number}: released, rests as it is", reason="given", about=edit.id)
        return Applied(scene=_described(stays, config), decisions=(said,), given=there.placed)
    landed = land(free, there, config, effort)
    decisions = [_asked(there, landed, edit, number)]
    decisions += _others(free, landed, number, but=edit.id)
    return _applied(landed, there, decisions, number, config)


def _applied(landed: Landed, there: Put, decisions: list[Decision], number: int, config: Config) -> Applied:
    told = [
        Decision(
            choice=f"edit {number}: does not come to rest", reason="physics still moves it", about=id, fallback=True
        )
        for id in sorted(landed.restless)
    ]
    return Applied(scene=_described(landed.scene, config), decisions=(*decisions, *told), given=there.placed)


def _where(off: Array, turn: float) -> str:
    """A way (3,) [m] and a turn [rad] in words that go before ``where``."""
    beside, up = float(np.linalg.norm(off[:2])), float(off[2])
    parts = [f"{_length(abs(up))} {'above' if up > 0 else 'below'}"] if abs(up) > TOLD else []
    parts += [f"{_length(beside)} beside"] if beside > TOLD or not parts else []
    if turn <= TOLD_TURN:
        return " and ".join(parts)
    degrees = round(math.degrees(turn))
    return f"{' and '.join(parts)}, turned by {degrees} degree{'s' * (degrees != 1)} from"


def _length(meters: float) -> str:
    return f"{100 * meters:.1f} cm" if meters >= 0.01 else f"{1000 * meters:.1f} mm"


def _carriers(o: SceneObject) -> str:
    return " and ".join(name_of(id) for id in o.carriers) or "nothing"


# --- materials ----------------------------------------------------------------------------------------------------


def _made_of(scene: Scene, edit: MaterialEdit, number: int, config: Config, effort: Effort) -> Applied:
    o = scene[edit.id]
    density = edit.density if edit.mass is None else edit.mass / _volume(o)
    said = dict[str, str]()
    if density is not None:
        o = replace(o, density=density, material_source="given")
        of = f"mass {edit.mass:.4g} kg" if edit.mass is not None else f"density {density:.4g} kg/m3"
        said["density"] = of
    if edit.friction is not None:
        o = replace(o, friction=edit.friction)
        said["friction"] = f"friction {edit.friction:.3g}"
    reason = _reason(o.material_reason, said, f"given by edit {number}")
    made = scene.with_objects(replace(o, material_reason=reason))
    given = Decision(choice=f"edit {number}: {', '.join(said.values())}", reason="given", about=o.id)
    if _rests_on_level_ground_alone(made, o.id, config):
        return Applied(scene=_described(made, config), decisions=(given,))
    if stays := _staying(made, o.id, config):
        return Applied(scene=_described(stays, config), decisions=(given,))
    group = touching({o.id}, config, made, made)
    there = Put(scene=made, placed=frozenset(), roots=(), touched=group)
    landed = land(made, there, config, replace(effort, closes=False))
    decisions = [given, *_others(made, landed, number)]
    return _applied(landed, there, decisions, number, config)


def _reason(before: str, said: Mapping[str, str], source: str) -> str:
    """Why the properties are what they are, without what older edits said of the same ones."""
    again = tuple(start for name in said for start in SAID_OF[name])
    kept = [p for p in before.split("; ") if p and not (" given by edit " in p and p.startswith(again))]
    return "; ".join([*kept, *(f"{value} {source}" for value in said.values())])


def _volume(o: SceneObject) -> float:
    """[m3]"""
    return solid_of(o)[0].volume * o.scale**3


def _rests_on_level_ground_alone(scene: Scene, id: int, config: Config) -> bool:
    """Whether an object touches level ground at most: then neither mass nor friction decides how anything rests."""
    o = scene[id]
    is_alone = len(touching({id}, config, scene, scene)) == 1
    return is_alone and (o.mobility == "fixed" or o.carriers == [GROUND])


def _staying(scene: Scene, id: int, config: Config) -> Scene | None:
    """The scene as it is, with the loads that physics finds, where an object and all it touches rest within a contact
    margin of their poses; None where they do not."""
    group = touching({id}, config, scene, scene)
    after = settled(scene, sorted(k for k in group if scene[k].mobility == "dynamic"), config)
    margin = config.settle.physics.contact.body
    stays = not after.restless and all(
        np.linalg.norm(scene[k].way_to(after.scene[k])) <= margin and scene[k].angle_to(after.scene[k]) <= STAYS_TURN
        for k in group
    )
    if not stays:
        return None
    loads = (after.scene[k] for k in sorted(group))
    return scene.with_objects(*(replace(scene[o.id], supports=o.supports, supported_by=o.supported_by) for o in loads))
