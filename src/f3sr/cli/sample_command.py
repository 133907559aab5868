"""The command for samples of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import JsonValue
from tyro.conf import arg

from f3sr.cli.arguments import MaybeOut, PackageFolder
from f3sr.errors import F3srError, OutputError

if TYPE_CHECKING:
    from f3sr.scene import SceneObject
    from f3sr.scene_package.package import Package
    from f3sr.uncertainty.sampling import Sample

Count = Annotated[int, arg(aliases=["-n"], metavar="N")]
INDEX = "samples.json"


def sample(
    package: PackageFolder, /, count: Count = 20, out: MaybeOut = None, seed: int = 0, json: bool = False
) -> None:
    """Draw scenes that the photo may show as well: each meets the masks, penetrates nothing and rests.

    Args:
        package: What ``f3sr reconstruct`` wrote.
        count: How many scenes.
        out: A new folder for them. Each scene is a package of its own, 001, 002 and so on; samples.json lists them.
            Without it, PACKAGE_samples.
        seed: Of the draws: equal seeds give equal scenes.
        json: Print one JSON object instead of text.
    """
    from f3sr.cli import console
    from f3sr.play.goal_loop import scene_sha
    from f3sr.runtime import kernels
    from f3sr.runtime.atomic_folder import claimed, recover
    from f3sr.scene import name_of
    from f3sr.scene_package.package import read_package
    from f3sr.scene_package.package_folder import placed
    from f3sr.scene_package.scene_json import dump_json
    from f3sr.scene_samples import require_count, sample_scenes
    from f3sr.uncertainty.sampling import Sample

    require_count("-n", count)
    recover(*(place for place in (package, out) if place))
    content = read_package(package)
    whole = Path(package).absolute()
    folder = placed(out or whole.with_name(f"{whole.name}_samples"))
    of, rows, rejected, kept = scene_sha(content), list[dict[str, Any]](), list[str](), list[Sample]()
    with (
        claimed(folder, _require_new) as claim,
        console.steps_shown(quiet=json) as progress,
        kernels.compiling() as compilers,
    ):
        compilers.finish(progress)
        for number, drawn in enumerate(sample_scenes(content, count, seed=seed, progress=progress), 1):
            provenance: dict[str, JsonValue] = {"of": of, "seed": seed, "number": number}
            for name, data in _files(drawn.sample, content, provenance):
                claim.write(f"{number:03d}/{name}", data)
            rejected += [r.reason for r in drawn.rejected]
            kept.append(drawn.sample)
            rows.append(_row(drawn.sample, f"{number:03d}"))
        if not rows:
            raise F3srError(f"no sample of {package} rests on its masks")
        told: dict[str, Any] = {"scene": of, "seed": seed, "wanted": count, "samples": rows, "rejected": rejected}
        told["spread"] = [_spread(o, kept) for o in content.scene if o.mobility == "dynamic"]
        told["held"] = [o.id for o in content.scene if o.mobility_source == "found"]
        claim.write(INDEX, dump_json(told))
        claim.replace()
    if json:
        console.print_json(told | {"folder": str(folder)})
        return
    console.print_table(
        [(f"{s['id']}", s["label"], f"{s['position_mm']:.1f}", f"{s['turn_deg']:.1f}", f"{s['size_pct']:.1f}")
         for s in told["spread"]],
        header=("id", "object", "position [mm]", "turn [deg]", "size [%]"),
    )  # fmt: skip
    for id in told["held"]:
        console.say(f"fallback: {name_of(id)} is fixed, as nothing that is seen carries it; no sample moves it")
    if len(rows) < count:
        console.say(f"fallback: only {len(rows)} of {count} samples; of the others {rejected[-1]}")
    if bound := sum(bool(r["moved_as_one"]) for r in rows):
        console.say(f"fallback: in {bound} samples a group moved as one body; with poses of their own they fell")
    console.say(f"samples:  {folder}, {len(rows)} packages, {len(rejected)} scenes rejected")


def _require_new(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(f"{folder}: is there already; give a new or empty folder with -o")


def _files(sample: Sample, content: Package, provenance: dict[str, JsonValue]) -> Iterator[tuple[str, bytes]]:
    """The files of a sample's package: it has the package's completed photo, for films."""
    from f3sr.background.inpainting import Inpainting
    from f3sr.scene_package.package import package_files

    rgb, support, kept = content.background(), content.support(), content.kept_depth()
    if rgb is None or support is None or kept is None:
        inpainting = None
    else:
        inpainting = Inpainting(rgb=rgb, support=support, kept=kept)
    measures = sample.measures.as_dict()
    return package_files(sample.scene, metrics=measures, provenance={"sample": provenance}, inpainting=inpainting)


def _row(sample: Sample, name: str) -> dict[str, Any]:
    names = ("mIoU_visible", "N_cross", "K_max_J", "D_max_cm", "gap_pct")
    measures = sample.measures.as_dict()
    return {"folder": name, **{n: measures[n] for n in names}, "moved_as_one": sorted(sample.as_one)}


def _spread(o: SceneObject, samples: list[Sample]) -> dict[str, Any]:
    """Root mean squares of how far an object is from where the package has it."""
    ends = [s.scene[o.id] for s in samples]
    away = [np.linalg.norm(o.way_to(e)) for e in ends]
    turns = [o.angle_to(e) for e in ends]
    sizes = [np.log(e.scale / o.scale) for e in ends]
    rms = [float(np.sqrt(np.mean(np.square(v)))) for v in (away, turns, sizes)]
    return {
        "id": o.id,
        "label": o.label,
        "position_mm": 1000 * rms[0],
        "turn_deg": float(np.degrees(rms[1])),
        "size_pct": 100 * rms[2],
    }
