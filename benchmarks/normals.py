"""What a network's normals add to the camera of a photo: tilt and focal length with and without them.

usage: python benchmarks/normals.py [NAME ...] [--data PATH]
The normals of the rendered scenes' ``geometry.npz`` are planted as the network's answer, with three kinds of noise:
``pixel`` differs at every pixel, ``smooth`` goes over in a fifth of the photo, ``common`` turns the whole photo's alike
(angles are standard deviations about each axis). z is the error of the tilt over the stated one. The axes are
scrambled, and found by the photo and by points. Exit codes: 0 all bounds hold, 1 one does not.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from camera_of_photo import truth
from f3sr.backends.protocols import EstimatedNormals, PromptedImage
from f3sr.core.transforms import Array, rotation_from_vector
from f3sr.io import inputs
from f3sr.metrology.camera_estimate import CameraEstimate, estimate_camera
from f3sr.metrology.ground_normal import ground_normal
from f3sr.metrology.network_normals import COMMON
from f3sr.vision.normal_axes import AxisSigns, axis_signs, signs_by_outlines, signs_by_points
from run import REPO

CASES = (
    ("pixel", 0.0),
    ("pixel", 5.0),
    ("pixel", 15.0),
    ("smooth", 5.0),
    ("smooth", 15.0),
    ("common", 2.0),
    ("common", 5.0),
    ("common", 15.0),
)
AXES = tuple(map("".join, itertools.product("rl", "du", "fb")))
Row = dict[str, Any]


def main() -> int:
    args = _arguments()
    folders = [f for f in sorted(args.data.glob("*")) if (f / "truth.json").exists()]
    folders = [f for f in folders if not args.names or f.name in args.names]
    if not folders:
        print(f"skipped: no such data in {args.data}")
        return 0
    rows, wrong, told = list[Row](), [0, 0], [0, 0]
    for number, folder in enumerate(folders):
        given = inputs.read(folder)
        rows += _cameras(folder, given, number)
        for k, (bad, good) in enumerate(_axes_found(given, number)):
            wrong[k] += bad
            told[k] += good
        print(folder.name, "done", flush=True)
    total = len(AXES) * len(folders) * 3
    for k, name in enumerate(("the photo", "points")):
        print(f"axes by {name}: {told[k]} of {total} told, {wrong[k]} of them wrong")
    return int(_judge(rows) or any(wrong))


def noisy(normals: Array, kind: str, degrees: float, rng: np.random.Generator) -> Array:
    """Unit normals (h, w, 3), zero where unknown, turned by a noise."""
    h, w = normals.shape[:2]
    sigma = math.radians(degrees)
    if kind == "common":
        turned = normals @ rotation_from_vector(sigma * rng.standard_normal(3)).T
    else:
        turns = rng.standard_normal((h, w, 3))
        if kind == "smooth":
            turns = gaussian_filter(turns, (h / 10, w / 10, 0), mode="reflect")
            turns /= turns.std()
        turned = normals + np.cross(sigma * turns, normals)
    lengths = np.linalg.norm(turned, axis=2, keepdims=True)
    return turned / np.where(lengths > 0, lengths, 1)


def _cameras(folder: Path, given: inputs.Inputs, number: int) -> list[Row]:
    true = truth(folder)
    assert true is not None and given.geometry.normals is not None
    K, up = true
    normals, image = np.asarray(given.geometry.normals, float), _image(given)
    rows = [
        _row("none", 0, estimate_camera(given.photo.rgb, [i.mask for i in given.instances], given.ground_mask), K, up)
    ]
    for n, (kind, degrees) in enumerate(CASES):
        values = noisy(normals, kind, degrees, np.random.default_rng([number, n]))
        normal = ground_normal(_image(given, values))
        assert normal is not None
        camera = estimate_camera(image.photo.rgb, [i.mask for i in image.instances], image.ground_mask, normal=normal)
        row = _row(kind, degrees, camera, K, up)
        rows.append(
            {
                **row,
                "alone": math.degrees(math.acos(min(1, float(normal.normal @ up)))),
                "sigma": math.degrees(normal.error / 2),
            }
        )
    return rows


def _row(kind: str, degrees: float, camera: CameraEstimate, K: Array, up: Array) -> Row:
    tilt = math.acos(min(1.0, float(camera.up @ up)))
    z = tilt / math.hypot(*camera.errors[1:])
    return {
        "kind": kind,
        "degrees": degrees,
        "tilt": math.degrees(tilt),
        "z": z,
        "focal": 100 * (camera.focal / K[0, 0] - 1),
    }


def _axes_found(given: inputs.Inputs, number: int) -> list[tuple[int, int]]:
    """How many of the scrambled axes are wrong, and how many are told, by the photo and by points."""
    counts = np.zeros((2, 2), int)
    assert given.geometry.normals is not None
    for n, (axes, degrees) in enumerate(itertools.product(AXES, (0.0, 5.0, 15.0))):
        scrambled = axis_signs(axes)
        assert scrambled is not None
        values = noisy(np.asarray(given.geometry.normals, float), "smooth", degrees, np.random.default_rng([number, n]))
        values = values * scrambled.signs
        masks = [i.mask for i in given.instances]
        found = (
            signs_by_outlines(values, masks, given.ground_mask),
            signs_by_points(values, given.geometry.points, given.geometry.valid),
        )
        for k, one in enumerate(found):
            counts[k] += _compared(one, scrambled)
    return [tuple(row) for row in counts.tolist()]


def _compared(found: AxisSigns, true: AxisSigns) -> NDArray[np.int64]:
    return np.array([(found.signs * true.signs < 0).any(), (found.signs != 0).all()], int)


def _image(given: inputs.Inputs, values: Array | None = None) -> PromptedImage:
    seen = None if values is None else EstimatedNormals(values=values, error=COMMON)
    return PromptedImage(photo=given.photo, instances=given.instances, ground_mask=given.ground_mask, normals=seen)


def _judge(rows: Sequence[Row]) -> bool:
    base = [r for r in rows if r["kind"] == "none"]
    limit, bad = _rms(base, "tilt"), False
    print(
        "| noise | tilt, median | tilt, rms | worst | z, rms | focal, rms | normals alone, rms | their stated error |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for kind, degrees in (("none", 0), *CASES):
        own = [r for r in rows if (r["kind"], r["degrees"]) == (kind, degrees)]
        tilts = [r["tilt"] for r in own]
        alone = f"{_rms(own, 'alone'):.2f} | {np.median([r['sigma'] for r in own]):.2f}" if kind != "none" else " | "
        print(
            f"| {kind} {degrees:g} | {np.median(tilts):.2f} | {_rms(own, 'tilt'):.2f} | {max(tilts):.2f} | "
            f"{_rms(own, 'z'):.2f} | {_rms(own, 'focal'):.1f} % | {alone} |"
        )
        if kind in ("pixel", "smooth") and degrees <= 5:
            bad |= _rms(own, "tilt") > limit
    return bad


def _rms(rows: Sequence[Row], key: str) -> float:
    return math.sqrt(sum(r[key] ** 2 for r in rows) / len(rows))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="only these")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data" / "scenes")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
