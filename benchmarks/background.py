"""The photo completed behind its objects, against OpenCV's Telea and Navier-Stokes: real removals, and holes of the
objects' shapes on empty parts of the same photos, where the truth is known.

Peers run where OpenCV can be imported (`pip install --target FOLDER --no-deps opencv-python-headless`, FOLDER on
PYTHONPATH); the project does not depend on it.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import binary_dilation, binary_erosion, distance_transform_edt, gaussian_filter

from f3sr.background import BackgroundConfig, complete_background, patchmatch, widened
from f3sr.background.shadows import PhotoShadowConfig
from f3sr.background.support import support_of
from f3sr.io import inputs
from f3sr.pipeline import SKIPPABLE, reconstruct
from f3sr.scene import Photo
from tables import show

REPO = Path(__file__).resolve().parents[1]
Pixels = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Fill = Callable[[Pixels, Mask, Mask], Pixels]

AS_GIVEN = BackgroundConfig(margin=0.0, shadows=PhotoShadowConfig(reach=0.0))
"""A hole as it is."""
PEER_RADIUS = 5
"""Neighbourhood of OpenCV's inpainting [px]."""
APART = 8
"""Pixels between a made hole and what is replaced anyway."""
TRIALS = 300
"""Places tried for a made hole."""
LEAST = 400
"""Pixels of the smallest object that counts."""
SHOWN, SIDE, AROUND = 2, 150, 12
"""Objects of every photo on the sheet, the side of a picture there, and what is shown around an object [px]."""
TIMED = (960, 720)
"""Size of the photo that is timed [px]."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data", help="holds scenes/ and real/")
    parser.add_argument("--out", type=Path, help="folder for results.json and sheets of every photo")
    arguments = parser.parse_args()
    places = [*sorted((arguments.data / "scenes").glob("*")), *sorted((arguments.data / "real").glob("ycb_table_*"))]
    if not places:
        parser.exit(message=f"no photos in {arguments.data}\n")
    patchmatch.warm_up()
    fills = dict(_fills())
    rows: dict[str, list[dict[str, Any]]] = {"removed": [], "made": []}
    crops: list[Pixels] = []
    for place in places:
        rgb, masks, support = read(place)
        background = complete_background(Photo(rgb=rgb), masks, support=support)
        pictures = {"photo": rgb}
        for name, fill in fills.items():
            pictures[name] = background.rgb if name == "f3sr" else fill(rgb, background.replaced, support)
            rows["removed"] += [
                {"photo": place.name, "object": k, "by": name, **_removal(pictures[name], background.replaced, part)}
                for k, part in _parts(background.replaced, masks)
            ]
        made = _made_holes(masks, background.replaced, np.random.default_rng(0))
        hole = np.any([background.replaced, *made.values()], axis=0)
        for name, fill in fills.items():
            filled = fill(rgb, hole, support)
            rows["made"] += [
                {"photo": place.name, "object": k, "by": name, **_against_truth(filled, rgb, part)}
                for k, part in made.items()
            ]
        crops += [_crops(pictures, part) for _, part in list(_parts(background.replaced, masks))[:SHOWN]]
        if arguments.out:
            arguments.out.mkdir(parents=True, exist_ok=True)
            sheet = Image.fromarray(np.hstack(list(pictures.values())))
            sheet.save(arguments.out / f"{place.name}.png")
        print(place.name, f"{100 * background.replaced.mean():.0f}% replaced", flush=True)
    for kind, lines in rows.items():
        _print(kind, lines, fills)
    _print_time(places)
    if arguments.out:
        (arguments.out / "results.json").write_text(json.dumps(rows, indent=1))
        Image.fromarray(_sheet(crops)).save(arguments.out / "removed.jpg", quality=85)


def read(place: Path) -> tuple[Pixels, list[Mask], Mask]:
    """A photo, the masks of its objects, and where it shows their support, as the pipeline finds it."""
    scene = reconstruct(inputs.read(place), skip=[stage for stage in SKIPPABLE if stage != "level"]).direct
    masks = [o.mask for o in scene]
    return scene.photo.rgb, masks, support_of(scene, widened(masks, BackgroundConfig().margin))


def _crops(pictures: Mapping[str, Pixels], part: Mask) -> Pixels:
    """What was removed, as the photo and every method has it, beside each other."""
    rows, columns = np.flatnonzero(part.any(1)), np.flatnonzero(part.any(0))
    half = max(np.ptp(rows), np.ptp(columns)) // 2 + AROUND
    box = (int(columns.mean()) - half, int(rows.mean()) - half, int(columns.mean()) + half, int(rows.mean()) + half)
    return np.hstack([np.asarray(Image.fromarray(p).crop(box).resize((SIDE, SIDE))) for p in pictures.values()])


def _sheet(crops: list[Pixels]) -> Pixels:
    """Two columns of rows."""
    half = -(-len(crops) // 2)
    blank = np.full_like(crops[0], 255)
    columns = [np.vstack(([*crops, blank])[k * half : (k + 1) * half]) for k in range(2)]
    return np.hstack([columns[0], np.full((columns[0].shape[0], 12, 3), 255, np.uint8), columns[1]])


def _fills() -> Iterator[tuple[str, Fill]]:
    yield "f3sr", lambda rgb, hole, support: complete_background(Photo(rgb=rgb), [hole], AS_GIVEN, support=support).rgb
    try:
        import cv2
    except ImportError:
        print("no peers: cv2 cannot be imported")
        return
    for name, method in (("Telea", cv2.INPAINT_TELEA), ("NS", cv2.INPAINT_NS)):
        yield name, lambda rgb, hole, _, method=method: cv2.inpaint(rgb, hole.astype(np.uint8), PEER_RADIUS, method)


def _parts(replaced: Mask, masks: list[Mask]) -> Iterator[tuple[int, Mask]]:
    """The part of what is replaced that is nearest to each object's mask."""
    distances = np.stack([distance_transform_edt(~mask) for mask in masks])
    owner = distances.argmin(0)
    for k, mask in enumerate(masks):
        if mask.sum() >= LEAST and (part := replaced & (owner == k)).any():
            yield k, part


def _made_holes(masks: list[Mask], replaced: Mask, rng: np.random.Generator) -> dict[int, Mask]:
    """The objects' shapes, each moved to a place where the photo shows nothing but background; those that find one."""
    holes: dict[int, Mask] = {}
    free = np.asarray(distance_transform_edt(~replaced)) > APART
    for k, mask in enumerate(masks):
        pixels = np.argwhere(mask)
        low, size = pixels.min(0), np.ptp(pixels, axis=0) + 1
        for _ in range(TRIALS if len(pixels) >= LEAST else 0):
            y, x = (pixels - low + rng.integers(np.array(mask.shape) - size + 1)).T
            if free[y, x].all():
                holes[k] = np.zeros_like(mask)
                holes[k][y, x] = True
                free &= ~binary_dilation(holes[k], iterations=APART)
                break
    return holes


def _removal(filled: Pixels, replaced: Mask, part: Mask) -> dict[str, float]:
    """``seam``: mean step across the border over that between neighbours just outside, 1 for none; ``texture``: how
    far the steps inside are from those around, in their mean."""
    outside = np.asarray(binary_dilation(part, iterations=APART)) & ~replaced
    across, beside = [], []
    for here, there, step in _neighbours(filled):
        across.append(step[part[here] & outside[there] | outside[here] & part[there]])
        beside.append(step[outside[here] & outside[there]])
    both = [np.concatenate(steps) for steps in (across, beside)]
    seam = float(both[0].mean() / max(both[1].mean(), 1e-9)) if all(map(len, both)) else np.nan
    return {"seam": seam, "texture": _texture(filled, binary_erosion(part, iterations=2), filled, outside)}


def _against_truth(filled: Pixels, truth: Pixels, hole: Mask) -> dict[str, float]:
    squares = (filled[hole].astype(float) - truth[hole]) ** 2
    return {
        "PSNR": float(10 * np.log10(255**2 / max(squares.mean(), 1e-9))),
        "SSIM": float(_similarity(filled.mean(2), truth.mean(2))[hole].mean()),
        "texture": _texture(filled, hole, truth, hole),
    }


def _similarity(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """SSIM by pixel (Wang et al. 2004), Gaussian of 1.5 px."""

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(gaussian_filter(values, 1.5))

    m, n, c, d = mean(a), mean(b), (0.01 * 255) ** 2, (0.03 * 255) ** 2
    both, va, vb = mean(a * b) - m * n, mean(a * a) - m * m, mean(b * b) - n * n
    return (2 * m * n + c) * (2 * both + d) / ((m * m + n * n + c) * (va + vb + d))


def _texture(a: Pixels, inside: Any, b: Pixels, around: Mask) -> float:
    """Distance between the distributions of steps along four directions, over the mean step around (sliced Wasserstein
    distance of gradients)."""
    levels, distances, sizes = np.linspace(0, 1, 65)[1:-1], [], []
    pairs = zip(_neighbours(a, diagonal=True), _neighbours(b, diagonal=True), strict=True)
    for (here, there, own), (_, _, other) in pairs:
        own, other = own[inside[here] & inside[there]], other[around[here] & around[there]]
        if len(own) and len(other):
            distances.append(np.abs(np.quantile(own, levels) - np.quantile(other, levels)).mean())
            sizes.append(other.mean())
    return float(np.mean(distances) / max(np.mean(sizes), 1e-9)) if distances else np.nan


def _neighbours(rgb: Pixels, diagonal: bool = False) -> Iterator[tuple[Any, Any, NDArray[np.float64]]]:
    """Slices of pixels and of their neighbours along some directions, and the size of the step between them."""
    ahead, behind, whole = slice(1, None), slice(None, -1), slice(None)
    ways = [((behind, whole), (ahead, whole)), ((whole, behind), (whole, ahead))]
    if diagonal:
        ways += [((behind, behind), (ahead, ahead)), ((behind, ahead), (ahead, behind))]
    values = rgb.astype(float)
    for here, there in ways:
        yield here, there, np.abs(values[there] - values[here]).mean(2)


def _print(kind: str, lines: list[dict[str, Any]], fills: Mapping[str, Fill]) -> None:
    names = [k for k in lines[0] if k not in ("photo", "object", "by")]
    count = len({(line["photo"], line["object"]) for line in lines})
    print(f"\n{kind}: {count} objects; medians, then means over rendered and over real photos")
    header = [kind, *(f"{n} {how}" for n in names for how in ("median", "rendered", "real"))]
    table = [header]
    for fill in fills:
        own = [line for line in lines if line["by"] == fill]
        real = [line["photo"].startswith("ycb") for line in own]
        cells: list[str] = []
        for n in names:
            values = np.array([line[n] for line in own])
            groups = (np.nanmedian(values), np.nanmean(values[~np.array(real)]), np.nanmean(values[np.array(real)]))
            cells += [f"{g:.3f}" for g in groups]
        table.append([fill, *cells])
    show(table)


def _print_time(places: list[Path]) -> None:
    place = next((p for p in places if len(list((p / "masks").glob("*.png"))) == 8), places[0])
    rgb, masks, support = read(place)
    photo = Photo(rgb=np.asarray(Image.fromarray(rgb).resize(TIMED)))
    small = [np.asarray(Image.fromarray(m).resize(TIMED, Image.Resampling.NEAREST)) for m in masks]
    ground = np.asarray(Image.fromarray(support).resize(TIMED, Image.Resampling.NEAREST))
    runs: list[tuple[float, float]] = []
    for _ in range(3):
        wall, cpu = time.perf_counter(), time.process_time()
        complete_background(photo, small, support=ground)
        runs.append((time.perf_counter() - wall, time.process_time() - cpu))
    wall, cpu = sorted(runs)[1]
    print(f"\n{TIMED[0]}x{TIMED[1]}, {len(masks)} objects: {wall:.2f} s wall, {cpu:.2f} s of processor, median of 3")


if __name__ == "__main__":
    main()
