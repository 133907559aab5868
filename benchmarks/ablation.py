"""The ablation table: what each part is worth, by all measures, against the truth where it is known.

usage: python benchmarks/ablation.py [--rows NAME ...] [--scenes NAME ...] [--data PATH] [--out FOLDER] [--again]
                                     [--referee PYTHON SCRIPT] [--update]
Stages come from the store, rows that earlier runs of the same code measured from OUT/ablation.json. ``--referee``
measures the packages of the rows with an independent script instead.
Exit codes: 0 no regression (or no data), 1 a regression.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import contact as bench
import contact_report
import peers
import staged
from f3sr import pipeline
from f3sr.pipeline import Reconstruction
from f3sr.pipeline_config import Config
from f3sr.report import Outcome
from f3sr.runtime import kernels
from f3sr.scene import Scene
from f3sr.scene_package import package
from f3sr.stages.decompose import Decomposed
from f3sr.stages.evaluate import direct_composition

COLUMNS = (
    *("mIoU_visible", "mIoU", "PSNR", "R_pen", "N_cross", "K_max_J", "D_max_cm", "gap_pct", "below_pct", "inside"),
    *("proxy_out_pct", "proxy_far_pct", "inflation", "tilt_deg", "centre_pct", "chamfer_pct"),
    *("support_precision", "support_recall"),
)
WORST = ("N_cross", "inside", "K_max_J", "D_max_cm", "gap_pct", "below_pct", "proxy_out_pct", "proxy_far_pct")
"""Measures of which the worst scene is shown too."""
"""The measure of ``decompose`` that becomes ``inflation``: the largest of a scene."""

Step = Callable[[Reconstruction], Scene]


def _result(result: Reconstruction) -> Scene:
    return result.scene


def _as_it_came(result: Reconstruction) -> Scene:
    return direct_composition(result.direct, result.scene)


def _report_recipe(result: Reconstruction) -> Scene:
    return contact_report.settle(contact_report.separate(result.scene))


def _nothing_hidden(mask: Any, *_: Any) -> Any:
    return np.zeros_like(mask)


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A run of the pipeline with some ``settings`` (dotted names) changed and stages left out, and what is measured."""

    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    skip: tuple[str, ...] = ()
    instead: Mapping[str, Callable[..., tuple[Scene, Outcome]]] = field(default_factory=dict[str, Any])
    """What runs in place of stages of these names."""
    patched: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """What takes the place of attributes of modules, by their dotted names."""
    optional: bool = False
    """Its settings may be missing, of a part that is not there: then the row is left out."""
    end: Step = _result


ROWS: Mapping[str, Variant] = {
    "full": Variant(),
    "no per-object alignment": Variant(skip=("align-objects",)),
    "no homothety": Variant(settings={"separate.max_ray_scale": 0.0}),
    "no facets": Variant(settings={"align.facets.enabled": False}),
    "no re-alignment": Variant(settings={"refine.rounds": 0}),
    "no cover": Variant(instead={"decompose": peers.stage("coacd")}),
    "no footings": Variant(settings={"separate.footing.enabled": False}),
    "no statics": Variant(settings={"separate.landing.max_turn": 0.0, "separate.balancing.max_shift": 0.0}),
    "no laying down": Variant(patched={"f3sr.stages.separate.standing._lie_down": lambda *_: None}),
    "no shifts until stable": Variant(patched={"f3sr.stages.separate.steady": lambda *_, **__: (None, [])}),
    "pairwise separation": Variant(patched={"f3sr.stages.separate.ways.part": contact_report.part}),
    "no removal of wrong supports": Variant(patched={"f3sr.stages.separate.take_beside": lambda *_: []}),
    "no closing": Variant(skip=("close",)),
    "closing without cuts": Variant(patched={"f3sr.stages.close._Lowered._trim": lambda *_: False}),
    "no damping": Variant(settings={"settle.settling.damping": 1e-9}),
    "no focal length from the ground": Variant(settings={"level.focal_sigma": 0.0}),
    "no search of orientations": Variant(settings={"align.orientations.enabled": False}),
    "no hidden parts": Variant(patched={"f3sr.vision.occlusion.behind_the_photo": _nothing_hidden}),
    "no moves inwards": Variant(patched={"f3sr.stages.separate.support_contact._aside": lambda *_: (None, np.inf)}),
    "no weights by mismatch": Variant(patched={"f3sr.stages.separate.placement.MATCHED": 1.0}),
    "report's contact": Variant(skip=tuple(bench.after_proxies()), end=_report_recipe),
    "report's recipe": Variant(instead={"align": staged.align}, skip=tuple(bench.after_proxies()), end=_report_recipe),
    "direct composition": Variant(skip=tuple(bench.after_proxies()), end=_as_it_came),
}
"""By name. ``report's contact`` is its separation and settling after our alignment, ``report's recipe`` its alignment
too; without per-object alignment nothing is re-aligned either."""


def main() -> int:
    args = bench.arguments(__doc__, "ablation", _options)
    folders = bench.chosen(args)
    if not folders:
        return 0
    kernels.warm_up()
    variants = {name: v for name, v in ROWS.items() if name in (args.rows or ROWS) and there_is(v, name)}
    kept = bench.Kept(args.out / ("referee.json" if args.referee else "ablation.json"), again=args.again)
    for scene, (_, folder) in folders.items():
        for name, variant in variants.items():
            if (key := f"{scene} | {name}") not in kept.rows:
                print(f"{key} ...", flush=True)
                measured = refereed if args.referee else row
                kept.add(key, measured(run(folder, variant), variant, folder, args))
    found: dict[str, bench.Row] = {}
    for group in dict.fromkeys(group for group, _ in folders.values()):
        of = [scene for scene, (its, _) in folders.items() if its == group]
        scenes = [{name: kept.rows[f"{scene} | {name}"] for name in variants} for scene in of]
        means, worst = bench.means_of(scenes), worst_of(scenes)
        print(f"\n{group}: means over {len(of)} scenes")
        bench.show(means, COLUMNS)
        print(f"\n{group}: the worst scene")
        bench.show(worst, WORST)
        found |= {f"{group}: {name}": mean for name, mean in means.items()}
        found |= {f"{group}: {name}, worst": most for name, most in worst.items()}
    if args.referee:
        return 0
    return bench.judge({f"ablation, {name}": mean for name, mean in found.items()}, set(folders), update=args.update)


def there_is(variant: Variant, name: str) -> bool:
    """Whether the product has the settings of a variant; an optional one that it lacks is said to be left out."""
    try:
        configured(Config(), variant.settings)
    except AttributeError as error:
        if not variant.optional:
            raise
        print(f"left out: {name}, {error}")
        return False
    return True


def configured(config: Any, values: Mapping[str, Any]) -> Any:
    """Settings with some changed, by their dotted names; AttributeError where there is no such setting."""
    for dotted, value in values.items():
        config = _with(config, dotted.split("."), value)
    return config


def _with(config: Any, names: list[str], value: Any) -> Any:
    known = [f.name for f in fields(config)] if is_dataclass(config) else []
    if names[0] not in known:
        raise AttributeError(f"no setting {names[0]}; there are {', '.join(known)}")
    inner = value if len(names) == 1 else _with(getattr(config, names[0]), names[1:], value)
    return replace(config, **{names[0]: inner})


def run(folder: Path, variant: Variant) -> Reconstruction:
    """What the stages make of a scene under a variant, the last of them never: measures are taken here."""
    config = configured(Config(), variant.settings)
    with ExitStack() as stack:
        for name, stage in variant.instead.items():
            stack.enter_context(mock.patch.object(pipeline, name, stage))
        for name, other in variant.patched.items():
            stack.enter_context(mock.patch(name, other))
        stored = not variant.instead and not variant.patched  # keys of stored results do not know of these stages
        return bench.reconstructed(folder, config, skip=sorted({"evaluate", *variant.skip}), stored=stored)


def row(result: Reconstruction, variant: Variant, folder: Path, args: argparse.Namespace) -> bench.Row:
    """All measures of what a variant ends with."""
    found = bench.measured(variant.end(result), result.direct, folder, args.data / "objects")
    fits = [fit for x in result.outcomes if isinstance(x, Decomposed) for fit in x.fits.values()]
    inflated = [fit.inflation for fit in fits if fit.inflation is not None]
    return {**found, **({"inflation": max(inflated)} if inflated else {})}


def refereed(result: Reconstruction, variant: Variant, folder: Path, args: argparse.Namespace) -> bench.Row:
    """What the independent script says of the variant's package."""
    python, script = args.referee
    out = args.out / "package"
    package.write_package(variant.end(result), out, direct=result.direct, overwrite=True)
    done = subprocess.run([python, script, folder, out], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{script}: {' / '.join(done.stderr.strip().splitlines()[-3:])}")
    answer = json.loads(done.stdout.strip().splitlines()[-1])
    return {name: float(value) for name, value in answer.items() if isinstance(value, int | float)}


def worst_of(scenes: list[bench.Rows]) -> bench.Rows:
    """The largest of every measure that should be small, by row."""
    return {
        name: {m: max(rows[name][m] for rows in scenes) for m in WORST if all(m in rows[name] for rows in scenes)}
        for name in scenes[0]
    }


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rows", nargs="+", default=[], choices=ROWS, metavar="NAME", help=", ".join(ROWS))
    parser.add_argument("--referee", nargs=2, metavar=("PYTHON", "SCRIPT"), help="measures packages instead")


if __name__ == "__main__":
    sys.exit(main())
