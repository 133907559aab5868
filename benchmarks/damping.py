"""The damping ablation: how often objects topple, slide off or lose contact while they settle, with damping or without.

A trial is one aligned and separated scene whose objects are moved by what generated poses miss, put back into contact
by `separate`, and settled twice from there. At least 60 trials: the scenes with truth and the bundled example, each
disturbed by several seeds.

usage: python benchmarks/damping.py [--trials N] [--scenes NAME ...] [--data PATH] [--out FOLDER] [--again] [--update]
Writes OUT/damping.json and OUT/damping.png. Exit codes: 0 no regression (or no data), 1 a regression.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean, stdev

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import contact as bench
import tables
from f3sr import example
from f3sr.core.transforms import Array, pose, rotation_about, rotation_from_vector
from f3sr.physics import settling as physics_settling
from f3sr.physics.settling import SettleConfig
from f3sr.runtime import kernels
from f3sr.scene import GROUND, Scene, SceneObject
from f3sr.stages.separate import separate
from f3sr.stages.settle import SettleStageConfig

TRIALS = 66
TOPPLED = np.radians(20)
"""Tilt from which on an object has toppled [rad]."""
OFF = 0.25
"""Way over its support, in sizes of its footprint, from which on an object has left it."""
SIDEWAYS, DEPTH, TURN = 0.01, 0.03, np.radians(2.0)
"""Standard deviations of what is added to poses: across the viewing ray and along it in object sizes, and a turn [rad].
About a third of what a generator misses, which alignment has taken away already."""
NO_DAMPING = 1e-9
"""[1/s]: a setting must be positive."""
ARMS: Mapping[str, float | None] = {"with damping": None, "without damping": NO_DAMPING}
"""Damping rate by name, None for the product's own."""
EXAMPLE = "example"

Trial = dict[str, dict[str, float]]


def main() -> int:
    args = bench.arguments(__doc__, "damping", _trials)
    folders = {name: folder for name, (_, folder) in bench.chosen(args).items() if (folder / "truth.json").exists()}
    if not args.scenes:
        folders[EXAMPLE] = example.folder()
    kernels.warm_up()
    kept = bench.Kept(args.out / "damping.json", again=args.again)
    for k in range(args.trials):
        name, seed = list(folders)[k % len(folders)], k // len(folders)
        if (key := f"{name} {seed}") not in kept.rows:
            scene = disturbed(separated(folders[name]), np.random.default_rng([seed, *name.encode()]))
            scene, _ = separate(scene)
            kept.add(key, {arm: outcome(scene, rate) for arm, rate in ARMS.items()})
            print(key, {arm: row["unstable"] for arm, row in kept.rows[key].items()}, flush=True)
    rates = {arm: rates_of([trial[arm] for trial in kept.rows.values()]) for arm in ARMS}
    _show(rates, len(kept.rows))
    chart({arm: rate["unstable_pct"] for arm, rate in rates.items()}, args.out / "damping.png")
    if len(kept.rows) < TRIALS:
        print(f"not judged with less than {TRIALS} trials")
        return 0
    return bench.judge({f"damping: {arm}": rate for arm, rate in rates.items()}, set(folders), update=args.update)


def separated(folder: Path) -> Scene:
    """The scene after ``separate``, as the product has it."""
    skip = [stage for stage in bench.after_proxies() if stage != "separate"]
    return bench.reconstructed(folder, skip=skip).scene


def disturbed(scene: Scene, rng: np.random.Generator) -> Scene:
    """Every object shifted and turned at random about its middle."""
    return scene.with_objects(*(_moved(o, scene.camera.center, rng) for o in scene if o.mobility == "dynamic"))


def _moved(o: SceneObject, eye: Array, rng: np.random.Generator) -> SceneObject:
    middle = o.middle
    ray = (middle - eye) / np.linalg.norm(middle - eye)
    across = np.linalg.svd(ray[None])[2][1:]
    shift = o.size * (DEPTH * rng.normal() * ray + SIDEWAYS * rng.normal(size=2) @ across)
    R = rotation_from_vector(TURN / np.sqrt(3) * rng.normal(size=3)) @ rotation_about([0, 0, 1], TURN * rng.normal())
    return o.moved(pose(R, middle - R @ middle + shift), stage="disturb", reason="what generated poses miss")


def outcome(scene: Scene, damping: float | None) -> dict[str, float]:
    """How many objects of a scene are unstable, and why, once it has settled with a damping rate [1/s]."""
    config = SettleStageConfig()
    settling = config.settling if damping is None else _with_rate(config.settling, damping)
    settled = physics_settling.settle(scene.objects, config.physics, settling=settling)
    after = {o.id: replace(o, T_world_object=settled.T_world_object[o.id]) for o in scene}
    toppled = {o.id for o in scene if tilt(o, after[o.id]) > TOPPLED}
    slid = {o.id for o in scene if slide(o, after, scene) > OFF}
    lost = {o.id for o in scene if o.supported_by is not None and (o.id, o.supported_by) not in settled.loads}
    return {
        "objects": len(scene.objects),
        "toppled": len(toppled),
        "slid": len(slid),
        "lost": len(lost),
        "unstable": len(toppled | slid | lost),
        "at_rest": float(settled.at_rest),
        "seconds": settled.seconds,
        "max_speed": settled.max_speed,
    }


def _with_rate(settling: SettleConfig, damping: float) -> SettleConfig:
    return replace(settling, damping=damping)


def tilt(before: SceneObject, after: SceneObject) -> float:
    """By how much an object was turned about anything but the vertical [rad]."""
    R = after.T_world_object[:3, :3] @ before.T_world_object[:3, :3].T
    return float(np.arccos(np.clip(R[2, 2], -1, 1)))


def slide(o: SceneObject, after: Mapping[int, SceneObject], scene: Scene) -> float:
    """How far an object's middle went over its support, in sizes of its footprint; the support's own move taken off."""
    base = np.eye(4)
    if o.supported_by not in (None, GROUND):
        base = after[o.supported_by].T_world_object @ np.linalg.inv(scene[o.supported_by].T_world_object)
    middle = o.middle
    carried = base[:3, :3] @ middle + base[:3, 3]
    footprint = float(np.ptp(o.bounds_world[:, :2], axis=0).mean())
    return float(np.linalg.norm((after[o.id].middle - carried)[:2])) / footprint


def rates_of(trials: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Shares of all objects [%], and of trials in which nothing is unstable or all came to rest."""
    total = sum(t["objects"] for t in trials)
    shares = {f"{kind}_pct": 100 * sum(t[kind] for t in trials) / total for kind in ("toppled", "slid", "lost")}
    each = [100 * t["unstable"] / t["objects"] for t in trials]
    return {
        "unstable_pct": 100 * sum(t["unstable"] for t in trials) / total,
        **shares,
        "error_pct": stdev(each) / np.sqrt(len(each)) if len(each) > 1 else 0.0,
        "whole_pct": 100 * fmean(t["unstable"] == 0 for t in trials),
        "at_rest_pct": 100 * fmean(t["at_rest"] for t in trials),
        "seconds": fmean(t["seconds"] for t in trials),
        "objects": total,
    }


def _show(rates: Mapping[str, Mapping[str, float]], trials: int) -> None:
    print(f"\n{trials} trials")
    names = list(next(iter(rates.values())))
    tables.show([["", *names], *([arm, *(f"{r[n]:.3g}" for n in names)] for arm, r in rates.items())])


def chart(rates: Mapping[str, float], file: Path) -> None:
    """A bar per arm: its instability rate [%]."""
    width, height, left, base = 560, 420, 70, 350
    picture = Image.new("RGB", (width, height), "white")
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(18)
    top = max(5.0, 5 * np.ceil(max(rates.values()) / 5))
    for tick in np.linspace(0, top, 6):
        y = base - tick / top * (base - 50)
        draw.line([left, y, width - 20, y], fill="#d8d8d8")
        draw.text((left - 10, y), f"{tick:g}", "#404040", font, anchor="rm")
    step = (width - 20 - left) / len(rates)
    for k, (name, rate) in enumerate(rates.items()):
        x, y = left + (k + 0.5) * step, base - rate / top * (base - 50)
        draw.rectangle([x - 60, y, x + 60, base], fill=("#3b6fb5", "#c4563d")[k % 2])
        draw.text((x, y - 6), f"{rate:.1f}", "#202020", font, anchor="mb")
        draw.text((x, base + 10), name, "#202020", font, anchor="ma")
    draw.line([left, base, width - 20, base], fill="#202020")
    draw.text((left, 12), "objects unstable after settling [%]", "#202020", font, anchor="la")
    picture.save(file)


def _trials(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--trials", type=int, default=TRIALS, metavar="N")


if __name__ == "__main__":
    sys.exit(main())
