"""A played goal on disk: plan.json, rollout.npz and verdict.json, all of them or none."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from f3sr.errors import InputError, OutputError, require_kind
from f3sr.files import limited_file
from f3sr.files.limited_file import MAX_JSON_BYTES
from f3sr.goals import checks, verify
from f3sr.goals import plan as plans
from f3sr.goals import rollout as rollouts
from f3sr.goals.file_names import FILMS, PLAN, ROLLOUT, VERDICT
from f3sr.goals.plan import Plan
from f3sr.goals.rollout import Rollout
from f3sr.goals.sequence import played_phases
from f3sr.play.goal_loop import Played, scene_sha
from f3sr.runtime.atomic_folder import BusyError, being_written, check, claimed, recover, recover_all
from f3sr.scene_package.package import Package, read_package
from f3sr.scene_package.package_folder import ROLLOUTS, is_package, placed

FILES = {PLAN, ROLLOUT, VERDICT, *FILMS}


def require_place(out: Path, package: Path, *, overwrite: bool = False) -> Path:
    """The full path of a folder for a rollout. Raises OutputError if it holds anything else."""
    out = placed(out, rollout=True)
    if package.resolve().is_relative_to(out):
        raise OutputError(f"{out}: holds the package itself; give another folder")
    return check(out, lambda out: _require_replaceable(out, overwrite))


def require_next(package: Path) -> None:
    """Raises OutputError if the package's next rollout could not be written."""
    check(_next(package), lambda _: None)


def write_played(played: Played, out: Path, *, overwrite: bool = False) -> Path:
    """Write plan.json, rollout.npz and verdict.json to the folder ``out``, all or none; returns its full path.

    Raises OutputError if ``out`` holds anything else, or an older rollout without ``overwrite``.
    """
    require_kind("played", played, Played, accepted="a played goal, no refusal")
    return _written(played, placed(out, rollout=True), lambda out: _require_replaceable(out, overwrite))


def write_next(played: Played, package: Path) -> Path:
    """``write_played`` to the package's next rollout: the first number that no other process has or takes."""
    while True:
        try:
            return _written(played, _next(package), _require_free)
        except BusyError:
            continue


def require_film_place(folder: Path) -> Path:
    """The full path of a rollout's folder. Raises OutputError if no film could be written there."""
    return check(placed(folder, rollout=True), _require_filmable)


def write_film(files: Mapping[str, bytes], folder: Path) -> None:
    """Write the files of a film (``Filmed.files``) to the folder of its rollout, all or none; older ones are replaced.

    Raises OutputError if ``folder`` is no rollout's or cannot be written.
    """
    with claimed(placed(folder, rollout=True), _require_filmable) as claim:
        for name, data in files.items():
            claim.write(name, data)
        claim.add()


def _next(package: Path) -> Path:
    """The folder of the package's next rollout: one more than the highest number that is taken."""
    folder = placed(_after_all(package / ROLLOUTS), rollout=True).parent
    recover_all(folder)
    return _after_all(folder)


def _after_all(folder: Path) -> Path:
    names = [*(p.name for p in folder.iterdir()), *being_written(folder)] if folder.is_dir() else []
    return folder / str(max((int(name) for name in names if name.isdecimal()), default=0) + 1)


def _written(played: Played, out: Path, allowed: Callable[[Path], object]) -> Path:
    with claimed(out, allowed) as claim:
        claim.write(PLAN, plans.to_json(played.plan))
        claim.write(ROLLOUT, rollouts.to_npz(played.rollout))
        claim.write(VERDICT, verify.to_json(played.verdict))
        claim.replace()
    return out


def _require_replaceable(out: Path, overwrite: bool) -> None:
    if not os.path.lexists(out):
        return
    if not out.is_dir():
        raise OutputError(f"{out}: is a file; give a folder")
    strangers = sorted(p.name for p in out.iterdir() if p.name not in FILES)
    if is_package(out) or strangers:
        raise OutputError(
            f"{out}: holds {strangers[0] if strangers else 'a package'}, which is no rollout's; nothing replaced"
        )
    if any(out.iterdir()) and not overwrite:
        raise OutputError(f"{out}: holds a rollout already; replaced only with --overwrite")


def _require_free(out: Path) -> None:
    if os.path.lexists(out):
        raise BusyError(f"{out}: another run has written it")


def _require_filmable(folder: Path) -> None:
    if not folder.is_dir():
        raise OutputError(f"{folder}: is not a folder with a rollout")
    if taken := next((folder / name for name in FILMS if (folder / name).is_dir()), None):
        raise OutputError(f"{taken}: is a folder, where a film's file goes")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"{folder}: is not writable")


@dataclass(frozen=True, eq=False, kw_only=True)
class StoredRollout:
    """A rollout's folder, and the package whose scene it plays."""

    plan: Plan
    rollout: Rollout
    package: Package


def read_played(folder: Path, package: Path | None = None) -> StoredRollout:
    """Read a written rollout with its package: by default the one whose folder contains it.

    Raises InputError if either is missing or damaged, or the rollout belongs to another scene.
    """
    plan = read_plan(folder / PLAN)
    rollout = rollouts.from_npz(folder / ROLLOUT)
    if package is None:
        package = folder.resolve().parent.parent
        if not is_package(package):
            accepted = "a rollout in its package's folder, or --package with the package"
            raise InputError(folder, found="no package around it", accepted=accepted)
    content = read_package(package)
    if plan.scene != scene_sha(content):
        raise InputError(folder, found=f"a rollout of another scene than {package}", accepted="one of this package")
    if rollout.ids.tolist() != [o.id for o in content.scene]:
        accepted = f"objects {[o.id for o in content.scene]}, as the scene has them"
        raise InputError(folder / ROLLOUT, found=f"objects {rollout.ids.tolist()[:20]}", accepted=accepted)
    if fault := next(checks.rollout_faults(rollout, plan), None):
        found, _, accepted = fault.partition("; accepted: ")
        raise InputError(folder / ROLLOUT, found=found, accepted=accepted)
    for played in played_phases(content.scene, plan, rollout):
        if fault := next(checks.faults_of(played.phase, played.scene), None):
            raise InputError(folder / PLAN, found=fault, accepted="a plan that this package can be played by")
    return StoredRollout(plan=plan, rollout=rollout, package=content)


def plan_file(place: Path) -> Path:
    """The plan.json of a rollout's folder; any other path as it is."""
    return place / PLAN if os.path.exists(place / PLAN) else place  # noqa: PTH110 - false for impossible names


def read_plan(file: Path) -> Plan:
    """Read a plan.json. Raises InputError if it is invalid."""
    accepted = "a plan.json that f3sr wrote"
    recover(file)
    data = limited_file.read(file, most=MAX_JSON_BYTES, accepted=accepted)
    try:
        return plans.from_json(data)
    except ValueError as error:
        raise InputError(file, found=_first_line(error), accepted=accepted) from None


def _first_line(error: ValueError) -> str:
    """What pydantic, or the JSON reader, says first."""
    details = getattr(error, "errors", None)
    if details is None:
        return str(error)
    first = details(include_url=False)[0]
    return f"{'.'.join(map(str, first['loc'])) or 'the document'}: {first['msg']}"
