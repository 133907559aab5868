"""The commands for many scenes: batch, and what is made of a dataset."""

from __future__ import annotations

import json as json_
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction, arg

from f3sr import options
from f3sr.cli.arguments import (
    Axes,
    DeviceName,
    Ignore,
    MaybeFile,
    MaybeOut,
    Name,
    NormalAxes,
    PrecisionName,
    Skip,
    default_shown,
)
from f3sr.errors import F3srError, InputError, printable, require_known
from f3sr.io.pose_conventions import require_asset_frame

if TYPE_CHECKING:
    from f3sr.backends.model_choice import ModelChoice

Sources = Annotated[Positional[Path], arg(metavar="INPUTS")]
DatasetPlace = Annotated[Positional[str], arg(metavar="DATASET")]
DatasetOut = Annotated[str, arg(aliases=["-o"], metavar="DATASET")]
MaybeDataset = Annotated[str | None, arg(aliases=["-o"], metavar="DATASET", help_behavior_hint=default_shown)]
FolderOut = Annotated[Path, arg(aliases=["-o"], metavar="OUT")]
Address = Annotated[str | None, arg(metavar="auto|ADDRESS", help_behavior_hint=default_shown)]
Where = Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="CONDITION", help_behavior_hint=default_shown)]
Keep = Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="DATASET", help_behavior_hint=default_shown)]
RowKind = Annotated[Literal["scene", "object", "goal"], arg(metavar="scene|object|goal")]
Gigabytes = Annotated[float, arg(metavar="GB", help_behavior_hint=lambda v: "" if v == "0.0" else f"(default: {v})")]
Count = Annotated[int, arg(metavar="N", help_behavior_hint=lambda v: "" if v == "0" else f"(default: {v})")]
Seconds = Annotated[float, arg(metavar="S")]
Patterns = Annotated[str, arg(metavar="PATTERNS", help_behavior_hint=default_shown)]

LEAST_MEMORY_GB = 0.1
SHARE = 0.8
"""Of the machine's memory that all jobs together may use."""


def batch(
    inputs: Sources,
    /,
    out: DatasetOut,
    goals: MaybeFile = None,
    jobs: Count = 0,
    timeout: Seconds = 1800.0,
    memory: Gigabytes = 0.0,
    retries: Count = 1,
    retry_bad: bool = False,
    wait: Seconds = 3600.0,
    film: bool = False,
    ray: Address = None,
    skip: Skip = "",
    ignore: Ignore = "",
    asset_frame: Axes = "auto",
    geometry: Name = None,
    normals: Name = None,
    normals_axes: NormalAxes = "",
    assets: Name = None,
    scene_graph: Name = None,
    background: Name = None,
    device: DeviceName = "auto",
    precision: PrecisionName = "auto",
    allow_downloads: bool = False,
    config: MaybeFile = None,
    json: bool = False,
) -> None:
    """Turn many input folders into a dataset of scene packages. What is done already is not done again.

    Args:
        inputs: A folder of input folders, or a manifest: a csv or jsonl file whose rows have path, and may have name,
            goals, asset-frame, skip, ignore and settings by dotted name.
        out: The dataset: a folder, or with the extra ray a URL such as s3://bucket/folder.
        goals: A text file with one goal a line, played in every scene whose row names no goals.
        jobs: Jobs at a time. Without it, as many as processors; on Ray, two a processor, of which one waits.
        timeout: Longest wall time of a job [s], 1 to 604800.
        memory: Most memory of a job with its subprocesses. Without it, an equal share of 80 % of the machine's.
        retries: Further attempts at a job that crashed, or exceeded time or memory, 0 to 100.
        retry_bad: Also try inputs again that were found to be bad in an earlier run and did not change since.
        wait: How long a job waits for room on a full disk [s].
        film: Make films of goals too.
        ray: Run on the Ray cluster of this machine (auto) or at an address, instead of in processes of this command.
        geometry: Back end that estimates geometry where a folder has none.
        normals: Back end that estimates surface normals where a geometry has none.
        normals_axes: Axes of these normals, where photos do not tell them, as rdf.
        assets: Back end that generates meshes where a folder has none.
        scene_graph: Back end that proposes relations where a folder has none.
        background: Back end that completes photos behind the objects.
        device: Where models of back ends run; auto is the first of cuda, mps and cpu that is there.
        precision: Their numbers; auto is float32 on a CPU, what a model usually runs in elsewhere.
        allow_downloads: Fetch weights of such models from the hub where they are not on this machine.
        config: TOML file of settings, as for ``reconstruct``.
        json: Print one JSON object a line for every event instead of text.
    """
    from f3sr import pipeline, settings
    from f3sr.backends.model_choice import ModelChoice
    from f3sr.batch.job import Job
    from f3sr.batch.manifest import read_goals
    from f3sr.batch.runs import RunPlan, run_batch
    from f3sr.batch.supervisor import JobLimits
    from f3sr.cli.batch_progress import progress_shown
    from f3sr.dataset.index import arrow
    from f3sr.runtime import signals
    from f3sr.runtime.machine import usable_cores, usable_memory

    chosen = settings.read(config, pipeline.Config()) if config else pipeline.Config()
    require_known("--skip", _names(skip), options.SKIPPABLE)
    require_known("--ignore", _names(ignore), options.PARTS)
    require_asset_frame("--asset-frame", asset_frame)
    _require("--jobs", jobs, 0, 10_000)
    _require("--timeout", timeout, 1, 604_800)
    _require("--retries", retries, 0, 100)
    _require("--wait", wait, 0, 604_800)
    if memory:
        _require("--memory", memory, LEAST_MEMORY_GB, 100_000)
    backends = {"geometry": geometry, "normals": normals, "assets": assets}
    backends |= {"scene_graph": scene_graph, "background": background}
    named = {kind: name for kind, name in backends.items() if name}
    if normals_axes and not normals:
        raise InputError("--normals-axes", found=normals_axes, accepted="together with --normals")
    slots = jobs or (0 if ray else usable_cores())
    share = memory or SHARE * usable_memory() / (slots or usable_cores())
    plan = RunPlan(
        slots=slots,
        limits=JobLimits(wall_s=timeout, memory_mb=1000 * share, storage_wait_s=wait),
        retries=retries,
        again=retry_bad,
        ray=ray,
    )
    common = Job(
        name="",
        source="",
        goals=read_goals(goals) if goals else (),
        skip=tuple(sorted(_names(skip))),
        ignore=tuple(sorted(_names(ignore))),
        asset_frame=asset_frame,
        settings=settings.changed(chosen, pipeline.Config()),
        backends=named,
        device=device,
        precision=precision,
        allow_downloads=allow_downloads,
        normals_axes=normals_axes,
        backend_keys=_backend_keys(named, ModelChoice(device=device, precision=precision, axes=normals_axes)),
        film=film,
        work=plan.work,
    )
    arrow()  # before any work
    signals.keeps("finished jobs are kept; the same command does the rest")
    with progress_shown(json=json) as shown:
        tally = run_batch(inputs, out, common, chosen, plan, shown.report, begun=shown.begin)
        shown.end(tally, str(out))
    if failed := tally.counts["failed"]:
        kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(tally.failures.items()))
        raise F3srError(f"{failed} of {tally.jobs} jobs failed ({kinds}); {out} has all others, and every reason")


def stats(dataset: DatasetPlace, /, where: Where = (), json: bool = False) -> None:
    """Count jobs by status, failures by reason and goals by state, and show measures and costs by quantiles.

    Args:
        dataset: What ``f3sr batch`` wrote.
        where: A condition on scenes, as "mIoU_visible > .9 and status = 'done'"; of several all must hold.
        json: Print one JSON object instead of text.
    """
    from f3sr.cli import console
    from f3sr.dataset.layout import Dataset
    from f3sr.dataset.summary import QUANTILES, summary

    told = summary(Dataset.read(dataset), where)
    if json:
        console.print_json(told)
        return
    console.say(f"{told['scenes']} scenes: {_counted(told['status'])}")
    console.say(f"{told['objects']} objects; goals: {_counted(told['goals']) or 'none'}")
    console.say(f"{told['total']['cpu_s']:.0f} s of processor time, {told['total']['package_bytes'] / 1e6:.0f} MB")
    for reason, count in told["reasons"].items():
        console.say(f"failed {count}: {printable(reason)}")
    columns = ("mean", *QUANTILES)
    rows = [
        (name, *(f"{values[c]:.4g}" for c in columns)) for name, values in (told["measures"] | told["costs"]).items()
    ]
    if rows:
        console.print_table(rows, header=("", *columns), numbers=True)


def filter_(
    dataset: DatasetPlace,
    /,
    where: Where = (),
    of: RowKind = "scene",
    out: MaybeDataset = None,
    json: bool = False,
) -> None:
    """List scenes that meet conditions, or write a dataset that refers to them.

    Args:
        dataset: What ``f3sr batch`` or ``f3sr dataset filter`` wrote.
        where: A condition on columns of the index: = != < <= > >= in contains, is null, and, or, not, parentheses.
            Of several all must hold.
        of: The rows that must meet them: the scene, or one of its objects or goals.
        out: A dataset of the scenes found, which refers to the packages of this one.
        json: Print one JSON object a line instead of names.
    """
    from dataclasses import asdict

    from f3sr.cli import console
    from f3sr.dataset.layout import Dataset
    from f3sr.dataset.row_selection import refer, scenes_with

    if not where:
        raise InputError("--where", found="no condition", accepted='at least one, as "mIoU_visible > .9"')
    found = Dataset.read(dataset)
    jobs = scenes_with(found, where, of)
    if out is not None:
        refer(found, jobs, out)
        console.say(
            json_.dumps({"dataset": out, "scenes": len(jobs)}) if json else f"dataset:  {out}, {len(jobs)} scenes"
        )
        return
    for job in jobs:
        console.say(json_.dumps(asdict(job)) if json else printable(job.name))


def sheet(dataset: DatasetPlace, /, out: MaybeOut = None, where: Where = (), json: bool = False) -> None:
    """Write a static page with a thumbnail and the main measures of every scene, to open in a browser.

    Args:
        dataset: What ``f3sr batch`` or ``f3sr dataset filter`` wrote.
        out: The folder of the page; an older page there is replaced. Without it, DATASET/sheet.
        where: A condition on scenes; of several all must hold.
        json: Print one JSON object instead of text.
    """
    from f3sr.cli import console
    from f3sr.dataset.layout import SHEET, Dataset
    from f3sr.dataset.sheet import write_sheet

    if out is None and "://" in dataset:
        raise InputError("--out", found="none", accepted="a local folder for the page of a remote dataset")
    page = write_sheet(Dataset.read(dataset), out or Path(dataset, SHEET), where)
    console.say(json_.dumps({"page": str(page)}) if json else f"page:     {page}")


def export(
    dataset: DatasetPlace,
    /,
    out: FolderOut,
    size: Annotated[float, arg(metavar="MB")] = 500.0,
    files: Patterns = "",
    where: Where = (),
    json: bool = False,
) -> None:
    """Write the packages of a dataset as WebDataset shards: tar files with a sample a scene.

    Args:
        dataset: What ``f3sr batch`` or ``f3sr dataset filter`` wrote.
        out: A new folder for the shards.
        size: About the largest size of a shard [MB], 1 to 1000000.
        files: Patterns of paths in a package, comma separated; * is all of it. Without it: photo, masks, scene.json,
            scene.glb and rollouts.
        where: A condition on scenes; of several all must hold.
        json: Print one JSON object instead of text.
    """
    from f3sr.cli import console
    from f3sr.dataset.layout import Dataset
    from f3sr.dataset.row_selection import scenes_with
    from f3sr.dataset.shards import CONTENTS, DEFAULT_FILES
    from f3sr.dataset.shards import export as write_shards

    _require("--size", size, 1, 1_000_000)
    found = Dataset.read(dataset)
    jobs = scenes_with(found, where) if where else list(found.listed())
    written = write_shards(found, jobs, out, megabytes=size, files=_names(files) or DEFAULT_FILES)
    console.say(json_.dumps({"shards": str(written)}) if json else f"shards:   {written}, listed in {CONTENTS}")


def prune(dataset: DatasetPlace, /, keep: Keep = (), dry_run: bool = False, json: bool = False) -> None:
    """Remove packages that no job of the dataset has any more: of older inputs, settings or code.

    Args:
        dataset: What ``f3sr batch`` wrote. No run may write it meanwhile, nor may its last run have been cut off.
        keep: A dataset by reference whose packages stay; several are possible.
        dry_run: Only say what would be removed.
        json: Print one JSON object instead of text.
    """
    from dataclasses import asdict

    from f3sr.cli import console
    from f3sr.dataset.layout import Dataset
    from f3sr.dataset.prune import prune as removed

    found = removed(Dataset.read(dataset), keep=[Dataset.read(place) for place in keep], dry_run=dry_run)
    if json:
        console.say(json_.dumps({"dry_run": dry_run, **asdict(found)}))
        return
    begun = "would remove" if dry_run else "removed"
    console.say(
        f"{begun} {_plural(found.packages, 'package')} of {found.bytes / 1e6:.1f} MB, "
        f"{_plural(found.failures, 'record')} of failures"
    )


DATASET_COMMANDS: Mapping[str, Any] = {
    "stats": stats,
    "filter": filter_,
    "sheet": sheet,
    "export": export,
    "prune": prune,
}


def dataset() -> None:
    """Look at a dataset of scenes: stats, filter, sheet, export, prune; ``f3sr dataset COMMAND --help`` tells more."""
    raise InputError("dataset", found="no command", accepted=", ".join(DATASET_COMMANDS))


# --- words -------------------------------------------------------------------------------------------------------


def _backend_keys(named: Mapping[str, str], choice: ModelChoice) -> tuple[str, ...]:
    """Versions and sources of back ends: another one makes other packages."""
    if not named:
        return ()
    from f3sr.backends.kinds import SCENE_GRAPHERS
    from f3sr.background.completers import BACKGROUND_COMPLETERS
    from f3sr.lifting.generators import ASSET_GENERATORS
    from f3sr.metrology.estimators import GEOMETRY_ESTIMATORS, NORMAL_ESTIMATORS

    kinds: dict[str, Any] = {
        "geometry": GEOMETRY_ESTIMATORS,
        "normals": NORMAL_ESTIMATORS,
        "assets": ASSET_GENERATORS,
        "scene_graph": SCENE_GRAPHERS,
        "background": BACKGROUND_COMPLETERS,
    }
    return tuple(kinds[kind].find(name, choice).key for kind, name in sorted(named.items()))


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _require(option: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise InputError(option, found=f"{value:g}", accepted=f"a number from {least:g} to {most:g}")


def _plural(count: int, thing: str) -> str:
    return f"{count} {thing}{'' if count == 1 else 's'}"


def _counted(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items())
