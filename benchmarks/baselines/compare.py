"""The report's table with its two other baselines: ten scenes, every method once, the five measures, and a figure.

usage: python benchmarks/baselines/compare.py [--scenes NAME ...] [--methods NAME ...] [--referee SCRIPT] [--data PATH]
                                              [--out FOLDER] [--again] [--figure FILE]
``--referee`` measures the packages by an independent script, with this Python; without it f3sr measures them. Rows that
earlier runs of the same f3sr measured are taken from OUT/rows.json, unless --again. ``--figure`` writes a JPEG of
two scenes. Exit codes: 0 done (or no data), 1 a package that could not be measured.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

sys.path.append(str(Path(__file__).resolve().parents[1]))
import ablation
import contact as bench
from baselines import figure, pat3d, tabletopgen
from baselines.given import given
from f3sr import pipeline
from f3sr.io import inputs
from f3sr.metrics.camera_fit import fitted_camera
from f3sr.runtime import kernels
from f3sr.scene import Scene
from f3sr.scene_package.package import read_package, write_package
from f3sr.stages.evaluate import direct_composition
from poses import true_scene
from run import REPO

REPORTED = ("PSNR", "mIoU", "R_pen", "K_max_J", "D_max_cm")
"""The five measures of the report's table."""
BESIDE = ("mIoU_visible", "gap_pct", "centre_pct", "chamfer_pct", "asset_residual", "cpu_s")
"""What they do not see."""
NEEDLESS = ("uncertainty", "evaluate", "inpaint")
"""Stages that change no pose."""


@dataclass(frozen=True, kw_only=True)
class Made:
    """A scene, and processor time [s] from the input folder on; collision proxies are in the cache."""

    scene: Scene
    cpu: float


def foreign(scene: Made, layout: Callable[[Scene], Scene]) -> Made:
    """A layout of the given scene, with a camera of its own."""
    began = time.process_time()
    laid_out = own_camera(layout(scene.scene))
    return Made(scene=laid_out, cpu=scene.cpu + time.process_time() - began)


def own_camera(scene: Scene) -> Scene:
    """The scene with a camera that is fitted inside bounds to its masks, where that raises their mean IoU."""
    return replace(scene, camera=fitted_camera(scene)[0])


def report_recipe(folder: Path) -> Scene:
    """The report's own alignment, separation and settling, as the ablation has them; its camera is fitted once more."""
    variant = ablation.ROWS["report's recipe"]
    return own_camera(variant.end(ablation.run(folder, variant)))


def whole(folder: Path, *skip: str) -> Scene:
    return pipeline.reconstruct(inputs.read(folder), skip=(*NEEDLESS, *skip)).scene


FOREIGN: Mapping[str, Callable[[Scene], Scene]] = {
    "direct composition": lambda scene: direct_composition(scene, scene),
    "TabletopGen": tabletopgen.reconstruct,
    "PAT3D": lambda scene: pat3d.reconstruct(scene)[0],
}
"""Layouts of the given scene, by name; two are re-implementations."""
ALIGNED: Mapping[str, Callable[[Path], Scene]] = {
    "F3SR": report_recipe,
    "f3sr, no object alignment": lambda folder: whole(folder, "align-objects"),
    "f3sr": whole,
}
"""Those that align a camera themselves; the first is a re-implementation. f3sr's camera is not fitted again."""
METHODS = (*FOREIGN, *ALIGNED)


def main() -> int:
    args = _arguments()
    folders = {name: folder for name, (group, folder) in bench.chosen(args).items() if group == "rendered"}
    if not folders:
        return 0
    kernels.warm_up()
    methods = [name for name in METHODS if name in (args.methods or METHODS)]
    kept = bench.Kept(args.out / "rows.json", again=args.again)
    for scene, folder in folders.items():
        keys = {name: f"{scene} | {name}" for name in methods}
        wanted = {name: key for name, key in keys.items() if key not in kept.rows}
        start = timed(given, folder) if wanted.keys() & FOREIGN.keys() else None
        for name, key in wanted.items():
            print(f"{key} ...", flush=True)
            made = foreign(start, FOREIGN[name]) if start and name in FOREIGN else timed(ALIGNED[name], folder)
            kept.add(key, row(made, folder, package_of(args.out, scene, name), args))
    scenes = [{name: kept.rows[f"{scene} | {name}"] for name in methods} for scene in folders]
    means = bench.means_of(scenes)
    print(f"\nmeans over {len(scenes)} scenes")
    bench.show(means, (*REPORTED, *BESIDE))
    print("\nmedians and the worst")
    bench.show(spread(scenes), [f"{m}{of}" for m in REPORTED for of in ("", ", worst")])
    results = {"means": means, "scenes": dict(zip(folders, scenes, strict=True))}
    (args.out / "results.json").write_text(json.dumps(results, indent=1) + "\n")
    if args.figure:
        figure.save([block(scene, args, kept.rows) for scene in figure.SCENES], args.figure)
    return 0


def block(scene: str, args: argparse.Namespace, rows: Mapping[str, bench.Row]) -> figure.Block:
    """One scene of the figure: by method its package and its measures, and the truth."""
    packages = {method: read_package(package_of(args.out, scene, method)).scene for method in figure.METHODS}
    measured = {method: rows[f"{scene} | {method}"] for method in figure.METHODS}
    last = figure.METHODS[-1]
    true = true_scene(packages[last], args.data / "scenes" / scene, args.data / "objects")
    assert true is not None
    return figure.Block(
        scenes=packages, rows=measured, true=as_seen(true, packages[last], measured[last]["true_scale"])
    )


def as_seen(true: Scene, scene: Scene, scale: float) -> Scene:
    """A true scene in the world of another, whose camera sees it as its own does; ``scale`` is from the other's
    lengths to metres."""
    T = scene.camera.T_world_camera @ true.camera.T_camera_world
    shrunk = (o.moved(true.camera.homothety(1 / scale), scale=1 / scale, stage="truth", reason="unit") for o in true)
    return replace(true.with_objects(*(o.moved(T, stage="truth", reason="world") for o in shrunk)), camera=scene.camera)


def timed(make: Callable[[Path], Scene], folder: Path) -> Made:
    began = time.process_time()
    return Made(scene=make(folder), cpu=time.process_time() - began)


def row(made: Made, folder: Path, out: Path, args: argparse.Namespace) -> bench.Row:
    """Write the package of a scene and measure it."""
    write_package(made.scene, out, overwrite=True)
    found = refereed(args.referee, folder, out) if args.referee else own(made.scene, folder, args.data / "objects")
    return {**found, "cpu_s": made.cpu}


def refereed(script: Path, folder: Path, package: Path) -> bench.Row:
    """What the independent script says of a package."""
    command = [sys.executable, str(script), str(folder), str(package)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{script}: {' / '.join(done.stderr.strip().splitlines()[-3:])}")
    answer = json.loads(done.stdout.strip().splitlines()[-1])
    return {name: float(value) for name, value in answer.items() if isinstance(value, int | float)}


def own(scene: Scene, folder: Path, objects: Path) -> bench.Row:
    return bench.measured(scene, scene, folder, objects)


def spread(scenes: list[bench.Rows]) -> bench.Rows:
    """Median and worst scene of the five measures, by method: means of K and D are those of the scenes that fall."""
    worst = {m: (min if m in ("PSNR", "mIoU") else max) for m in REPORTED}
    return {
        name: {
            key: value
            for m in REPORTED
            for values in [[rows[name][m] for rows in scenes]]
            for key, value in ((m, median(values)), (f"{m}, worst", worst[m](values)))
        }
        for name in scenes[0]
    }


def package_of(out: Path, scene: str, method: str) -> Path:
    return out / scene / method.replace(", ", " ").replace(" ", "_")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=[], metavar="NAME", help="only these")
    parser.add_argument("--methods", nargs="+", default=[], choices=METHODS, metavar="NAME", help=", ".join(METHODS))
    parser.add_argument("--referee", type=Path, metavar="SCRIPT", help="measures packages instead of f3sr")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "bench" / "baselines", help="packages and rows")
    parser.add_argument("--again", action="store_true", help="measure anew what is in --out already")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="write the figure of two scenes, a JPEG")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
