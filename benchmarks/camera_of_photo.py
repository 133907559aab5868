"""The camera of a photo, estimated from photo, masks and ground mask, against the truth and a constant prior.

usage: python benchmarks/camera_of_photo.py [NAME ...] [--data PATH] [--without masks,ground] [--draw FOLDER]
Exit codes: 0 all bounds hold, 1 one does not.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from f3sr.core.transforms import Array
from f3sr.io.images import as_rgb, open_image
from f3sr.metrology.camera_estimate import CameraEstimate, attitude, estimate_camera
from f3sr.vision.ground_plane import fit_plane
from run import REPO

GROUPS = {"rendered": "scenes/*", "frames": "real/*", "photos": "photos/*"}
PRIOR_FOCAL, PRIOR_PITCH = 0.9, math.radians(32)
"""The constant prior: focal length [image widths] and angle below the horizon [rad]."""
MOST_TILT, MOST_FOCAL = 3.0, 7.0
"""Bounds of the medians [deg], [%]."""
TOLD = 0.12
"""Standard error of the focal length's logarithm up to which the photo itself tells it: half of the prior's."""

Row = dict[str, Any]


def main() -> int:
    args = _arguments()
    folders = [(g, f) for g, pattern in GROUPS.items() for f in sorted(args.data.glob(pattern)) if f.is_dir()]
    folders = [(g, f) for g, f in folders if not args.names or f.name in args.names]
    if not folders:
        print(f"skipped: no such data in {args.data}")
        return 0
    rows = list[Row]()
    for group, folder in folders:
        rows.append({"name": folder.name, "group": group, **measured(folder, args.without, args.draw)})
        print(_line(rows[-1]), flush=True)
    return int(judge([r for r in rows if "tilt" in r]))


def measured(folder: Path, without: Sequence[str], draw: Path | None) -> Row:
    """The estimate of one folder, and its errors where the truth is known."""
    photo = as_rgb(open_image(next(folder.glob("image.*"))))
    files = [] if "masks" in without else sorted((folder / "masks").glob("*.png"))
    masks = [_mask(f) for f in files]
    ground = _mask(folder / "ground.png") if (folder / "ground.png").exists() and "ground" not in without else None
    if ground is not None and masks:
        ground &= ~np.any(masks, axis=0)
    started = time.perf_counter()
    camera = estimate_camera(photo, masks, ground)
    row: Row = {"seconds": time.perf_counter() - started, "camera": camera}
    if draw is not None:
        draw.mkdir(parents=True, exist_ok=True)
        drawn(photo, camera).save(draw / f"{folder.name}.jpg")
    if (true := truth(folder)) is None:
        return row
    K, up = true
    focal = camera.focal / K[0, 0]
    pitch, roll = math.asin(-float(up[2])), math.atan2(float(up[0]), -float(up[1]))
    prior = attitude(PRIOR_PITCH, 0)[:, 2]
    return {
        **row,
        "tilt": _angle(camera.up, up),
        "focal": 100 * (focal - 1),
        "prior_tilt": _angle(prior, up),
        "prior_focal": 100 * (PRIOR_FOCAL * max(photo.shape[:2]) / K[0, 0] - 1),
        "z": (math.log(focal), camera.pitch - pitch, camera.roll - roll) / np.array(camera.errors),
    }


def truth(folder: Path) -> tuple[Array, Array] | None:
    """K (3, 3) and the direction against gravity (3,) in the camera; of a depth frame the ground's normal."""
    if (folder / "truth.json").exists():
        known = json.loads((folder / "truth.json").read_text())
        return np.array(known["K"]), np.array(known["T_world_camera"])[2, :3]
    if not (folder / "intrinsics.json").exists():
        return None
    meta = json.loads((folder / "intrinsics.json").read_text())
    K = np.array(meta["K"])
    depth = np.asarray(Image.open(folder / "depth.png")).astype(float) * meta["depth_scale"]
    rows, columns = np.nonzero(_mask(folder / "ground.png") & (depth > 0))
    rays = np.column_stack([columns + 0.5, rows + 0.5, np.ones(len(rows))]) @ np.linalg.inv(K).T
    plane = fit_plane(rays * depth[rows, columns][:, None], np.random.default_rng(0), 0.01)
    return K, plane.normal


def judge(rows: Sequence[Row]) -> bool:
    """Print medians, calibration and bounds; whether one does not hold."""
    wrong = False
    for group in (*dict.fromkeys(r["group"] for r in rows), "all"):
        own = [r for r in rows if group in (r["group"], "all")]
        sure = [r for r in own if r["camera"].errors[0] <= TOLD]
        print(
            f"{group}: {len(own)} photos; median tilt {_median(own, 'tilt'):.2f} deg (prior "
            f"{_median(own, 'prior_tilt'):.2f}), worst {max(abs(r['tilt']) for r in own):.1f}; median focal error "
            f"{_median(own, 'focal'):.1f} % (prior {_median(own, 'prior_focal'):.1f}); where the photo tells it "
            f"({len(sure)}): {_median(sure, 'focal'):.1f} %"
        )
    z = np.array([r["z"] for r in rows])
    for k, name in enumerate(("focal length", "pitch", "roll")):
        print(f"z of {name}: rms {np.sqrt(np.mean(z[:, k] ** 2)):.2f}, largest {np.abs(z[:, k]).max():.1f}")
    sure = [r for r in rows if r["camera"].errors[0] <= TOLD]
    bounds = [("median tilt [deg]", _median(rows, "tilt"), MOST_TILT)]
    bounds.append(("median focal error where told [%]", _median(sure, "focal"), MOST_FOCAL))
    for group in dict.fromkeys(r["group"] for r in rows):
        own = [r for r in rows if r["group"] == group]
        for key in ("tilt", "focal"):
            bounds.append((f"{group}: rms {key} below the prior's", _rms(own, key), _rms(own, f"prior_{key}")))
    for name, value, bound in bounds:
        wrong |= value > bound
        print(f"{name}: {value:.2f} (at most {bound:.2f}){'' if value <= bound else '  DOES NOT HOLD'}")
    return wrong


def drawn(photo: NDArray[np.uint8], camera: CameraEstimate) -> Image.Image:
    """The photo with the horizon (red), level squares of the ground (yellow) and vertical lines (blue)."""
    image = Image.fromarray(photo)
    pen = ImageDraw.Draw(image)
    w, h = image.size
    width = max(2, max(w, h) // 400)
    R, f, centre = attitude(camera.pitch, camera.roll), camera.focal, np.array([w, h]) / 2

    def line(a: Array, b: Array, colour: str) -> None:
        a, b = R @ a, R @ b
        if a[2] > 1e-2 and b[2] > 1e-2:
            ends = [(float(x), float(y)) for x, y in (centre + f * p[:2] / p[2] for p in (a, b))]
            if max(abs(v) for end in ends for v in end) < 20 * max(w, h):
                pen.line(ends, fill=colour, width=width)

    line(np.array([-50.0, 50, 0]), np.array([50.0, 50, 0]), "red")
    for k in np.linspace(-3, 3, 13):
        line(np.array([k, 0.2, -1]), np.array([k, 6, -1]), "yellow")
        line(np.array([-3, k + 3.2, -1]), np.array([3, k + 3.2, -1]), "yellow")
        for far in (1.5, 3.0):
            line(np.array([k * far / 2, far, -1.0]), np.array([k * far / 2, far, 0]), "deepskyblue")
    return image


def _mask(file: Path) -> NDArray[np.bool_]:
    image = np.asarray(Image.open(file))
    return (image if image.ndim == 2 else image[..., 0]) > 0


def _angle(a: Array, b: Array) -> float:
    return math.degrees(math.acos(min(1.0, float(a @ b))))


def _median(rows: Sequence[Row], key: str) -> float:
    return median(abs(r[key]) for r in rows) if rows else 0.0


def _rms(rows: Sequence[Row], key: str) -> float:
    return math.sqrt(sum(r[key] ** 2 for r in rows) / len(rows))


def _line(row: Mapping[str, Any]) -> str:
    camera: CameraEstimate = row["camera"]
    f, pitch, roll = camera.errors
    text = (
        f"{row['name']}: focal {camera.focal:.0f} px +- {100 * f:.1f} %, pitch {math.degrees(camera.pitch):.1f} +- "
        f"{math.degrees(pitch):.1f}, roll {math.degrees(camera.roll):.1f} +- {math.degrees(roll):.1f} deg, "
        f"{camera.segments} segments, {camera.rims} rims, {row['seconds']:.2f} s"
    )
    if "tilt" not in row:
        return text
    z = ", ".join(f"{v:.1f}" for v in row["z"])
    return (
        f"{text}; tilt {row['tilt']:.2f} deg (prior {row['prior_tilt']:.1f}), focal {row['focal']:+.1f} % (prior "
        f"{row['prior_focal']:+.1f}), z {z}"
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="only these")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--without", type=lambda s: s.split(","), default=[], help="masks, ground")
    parser.add_argument("--draw", type=Path, help="folder for photos with horizon and verticals drawn in")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
