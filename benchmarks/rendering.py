"""The film's renderer on finished packages: likeness to the photo with nothing moved, and time per frame.

usage: python benchmarks/rendering.py [--packages FOLDER] [--scenes NAME ...] [--frames COUNT] [--out FOLDER]
FOLDER holds packages, as benchmarks/run.py leaves them in out/bench. A row for VTK is drawn in the same run where it
can be imported (`pip install --target FOLDER vtk`, FOLDER on PYTHONPATH); the project does not depend on it.
Exit codes: 0, also without packages; 1 where one of the bounds that the printed table names is broken.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from f3sr.background import complete_background
from f3sr.core.srgb import linear, srgb
from f3sr.core.transforms import Array, rotation_from_vector
from f3sr.rendering import Renderer
from f3sr.runtime import kernels
from f3sr.scene import Photo, Scene
from f3sr.scene_package.package import is_package, read_package
from f3sr.vision import rasterizer
from f3sr.vision.silhouette import union_of
from tables import show

REPO = Path(__file__).resolve().parents[1]
Pixels = NDArray[np.uint8]
Mask = NDArray[np.bool_]

TIMED = (960, 720)
"""Size of the picture that is timed [px]."""
OBJECTS = 8
"""How many objects are timed, of 16,384 triangles each."""
LEAST_GAIN, LEAST_OUTSIDE = 2.0, 30.0
"""PSNR [dB]: lit over unlit inside masks in the mean over scenes, and outside of masks and shadows in each."""
SHADOW = 0.02
"""Share of its light that a pixel in the shadow of the scene at rest lacks."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--packages", type=Path, default=REPO / "out" / "bench", help="finished packages")
    parser.add_argument("--scenes", nargs="*", default=[], help="only these")
    parser.add_argument("--frames", type=int, default=90, help="of a timed film")
    parser.add_argument("--out", type=Path, help="folder for photo and first frame of every scene")
    args = parser.parse_args()
    places = [p for p in sorted(args.packages.glob("*")) if p.is_dir() and is_package(p)]
    places = [p for p in places if not args.scenes or p.name in args.scenes]
    if not places:
        print(f"no packages in {args.packages}")
        return 0
    kernels.warm_up()
    table = [["PSNR dB", "unlit", "one gain", "lit", "more", "outside", "ground", "without shadow", "whole", "setup s"]]
    rows: list[list[float]] = []
    for place in places:
        scene = read_package(place).scene
        rows.append(likeness(scene, args.out and args.out / f"{place.name}.png"))
        table.append([place.name, *(f"{v:.2f}" for v in rows[-1])])
        print(place.name, flush=True)
    means = np.mean(rows, axis=0)
    show([*table, ["mean", *(f"{v:.2f}" for v in means)]])
    broken = means[3] < LEAST_GAIN or min(r[4] for r in rows) < LEAST_OUTSIDE
    bounds = f"more >= {LEAST_GAIN} in the mean, outside >= {LEAST_OUTSIDE} in each"
    print(f"bounds: {bounds}: {'BROKEN' if broken else 'held'}")
    print_times([read_package(p).scene for p in places], args.frames)
    return int(broken)


def likeness(scene: Scene, out: Path | None) -> list[float]:
    """Inside masks: unlit, unlit with the best common gain per channel, lit, and its lead over unlit; outside masks and
    shadows; ground in shadow, and the same without shadows drawn; the whole picture; seconds to set up."""
    photo, masks = scene.photo.rgb, [o.mask for o in scene.objects]
    background = complete_background(scene.photo, masks)
    began = time.process_time()
    renderer = Renderer.of(scene, background.rgb)
    seconds = time.process_time() - began
    frame = renderer.frame(np.array([o.T_world_object for o in scene.objects]))
    fragments = rasterizer.render(scene.objects, scene.camera)
    seen, inside = fragments.ids >= 0, union_of(masks, photo.shape[:2])
    unlit = rasterizer.shade(fragments, scene.objects)
    both = seen & inside
    light, wanted = linear(unlit[both]), linear(photo[both] / 255)
    gain = (light * wanted).sum(0) / (light * light).sum(0)
    gained = srgb(np.clip(linear(unlit) * gain, 0, 1))
    plain, common = (np.where(seen[..., None], np.rint(255 * c), background.rgb) for c in (unlit, gained))
    shadow = background.shadows | (renderer.rest_light.min(2) < 1 - SHADOW)
    own = [psnr(p, photo, inside) for p in (plain, common, frame)]
    if out:
        out.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.hstack([photo, frame])).save(out)
    return [
        *own,
        own[2] - own[0],
        psnr(frame, photo, ~inside & ~shadow & ~seen),
        psnr(frame, photo, ~inside & background.replaced),
        psnr(background.rgb, photo, ~inside & background.replaced),
        psnr(frame, photo, np.ones_like(inside)),
        seconds,
    ]


def psnr(a: NDArray[np.generic], b: Pixels, where: Mask) -> float:
    return float(10 * np.log10(255**2 / max(float(np.mean((a[where].astype(float) - b[where]) ** 2)), 1e-9)))


def print_times(scenes: list[Scene], count: int) -> None:
    """Frames of a scene with enough objects, enlarged or reduced to ``TIMED``."""
    chosen = next((s for s in scenes if len(s.objects) >= OBJECTS), None)
    if chosen is None:
        print(f"no times: no scene with {OBJECTS} objects")
        return
    scene = resized(chosen)
    triangles = sum(len(o.mesh.faces) for o in scene.objects)
    renderer = Renderer.of(scene, complete_background(scene.photo, [o.mask for o in scene.objects]).rgb)
    print(f"\n{TIMED[0]}x{TIMED[1]}, {len(scene.objects)} objects, {triangles:,} triangles, 2x2 samples, shadows")
    films = {"all objects move": range(OBJECTS), "two move": range(2), "one moves": range(1)}
    lines = [["film", "cpu ms/frame", "wall ms/frame", "slowest ms", f"{count} frames s"]]
    for name, moving in films.items():
        lines.append([name, *timed(renderer.frame, film(scene, moving, count))])
    lines += peers(scene, count)
    show(lines)


def resized(scene: Scene) -> Scene:
    from dataclasses import replace

    def small(mask: Mask) -> Mask:
        return np.asarray(Image.fromarray(mask).resize(TIMED, Image.Resampling.NEAREST))

    return replace(
        scene,
        photo=Photo(rgb=np.asarray(Image.fromarray(scene.photo.rgb).resize(TIMED))),
        camera=scene.camera.resized(*TIMED),
        objects=tuple(replace(o, mask=small(o.mask)) for o in scene.objects[:OBJECTS]),
    )


def film(scene: Scene, moving: range, count: int) -> Iterator[Array]:
    """Objects hop and turn where they stand."""
    rest = np.array([o.T_world_object for o in scene.objects])
    for k in range(count):
        poses = rest.copy()
        for i in moving:
            poses[i, :3, :3] = rotation_from_vector([0, 0, 0.05 * k]) @ rest[i, :3, :3]
            poses[i, 2, 3] += 0.1 * abs(np.sin(0.1 * k + i))
        yield poses


def timed(draw: Callable[[Array], object], poses: Iterator[Array]) -> list[str]:
    draw(next(poses))
    walls, cpu = [time.perf_counter()], time.process_time()
    for T in poses:
        draw(T)
        walls.append(time.perf_counter())
    steps = np.diff(walls)
    spent = (time.process_time() - cpu) / len(steps)
    numbers = (1e3 * spent, 1e3 * steps.mean(), 1e3 * steps.max())
    return [*(f"{n:.0f}" for n in numbers), f"{steps.mean() * (len(steps) + 1):.1f}"]


def peers(scene: Scene, count: int) -> list[list[str]]:
    """VTK's OpenGL renderer of the same meshes at the same size, with 2x2 multisampling, without shadows."""
    try:
        import vtk_peer
    except ImportError as error:
        print(f"no row for VTK: {error}")
        return []
    return [["VTK, no shadows", *timed(vtk_peer.Renderer(scene).frame, film(scene, range(OBJECTS), count))]]


if __name__ == "__main__":
    raise SystemExit(main())
