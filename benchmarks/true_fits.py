"""Real SAM 3D assets fitted to the true surfaces by one similarity each: what no placing of them can do better.

usage: python benchmarks/true_fits.py PACKAGES [--data PATH]
``PACKAGES`` holds a package for each scene of ``sam3d``, by its name; their poses are where the fits start.
Bottoms and centres of bounding boxes are as ``truth_points.py`` of the referee has them.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

import f3sr
import tables
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array, transform
from poses import similarity
from run import REPO

SAMPLES = 4000
"""Points of a surface, as many as the truth has."""
STEPS = 60
"""Iterations of a fit; the points nearest to each other no longer change then."""


def main() -> int:
    args = _arguments()
    rows: dict[str, tuple[float, ...]] = {}
    for folder in sorted((args.data / "sam3d").glob("*/truth_points.npz")):
        name, truth = folder.parent.name, np.load(folder)
        scene = f3sr.read_package(args.packages / name).scene
        T_true_world = np.linalg.inv(truth["T_camera_world"]) @ scene.camera.T_camera_world
        for o in scene:
            there = truth[f"object_{o.id:02d}"].astype(float)
            came = transform(T_true_world, sample_surface(o.vertices_world, o.mesh.faces, SAMPLES))
            rows[f"{name} {o.id}"] = (*_off(came, there), *_off(fitted(came, there), there))
    if not rows:
        print(f"skipped: no sam3d in {args.data} (--data PATH names another folder)")
        return 0
    medians = np.median(np.abs(list(rows.values())), axis=0)
    head = ["", "bottom cm", "centre cm", "fitted: bottom cm", "centre cm"]
    shown = [*rows.items(), ("median", tuple(medians))]
    tables.show([head, *([name, *(f"{100 * v:.3f}" for v in row)] for name, row in shown)])
    return 0


def fitted(points: Array, onto: Array) -> Array:
    """Points (n, 3) under the similarity that brings them nearest to others (m, 3), each side to its nearest of the
    other (iterative closest points, Besl and McKay 1992)."""
    there = KDTree(onto)
    for _ in range(STEPS):
        a = np.concatenate([points, points[KDTree(points).query(onto)[1]]])
        b = np.concatenate([onto[there.query(points)[1]], onto])
        R, scale = similarity(a, b)
        points = scale * (points - a.mean(0)) @ R.T + b.mean(0)
    return points


def _off(points: Array, truth: Array) -> tuple[float, float]:
    """Of the lowest point, and of the centre of the bounding box [m]."""
    bottom = float(points[:, 2].min() - truth[:, 2].min())
    middles = [(p.min(0) + p.max(0)) / 2 for p in (points, truth)]
    return bottom, float(np.linalg.norm(middles[0] - middles[1]))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("packages", type=Path, help="folder of packages")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data", help="holds sam3d/")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
