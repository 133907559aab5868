"""Torch against the compiled kernels: processor and wall time of one evaluation of the silhouette integrals.

usage: twin.py [--device torch-cpu|cuda] [--batch 16] [--pixels 512]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
import trimesh

from f3sr.devices import Answers, open_torch
from f3sr.frames import Array, Camera, pose, rotation_from_vector
from f3sr.freedom import ObjectFreedom
from f3sr.silhouette import Surface, Target
from f3sr.silhouette_fit import ObjectFit, one_by_one

FORWARD = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
REPEATS = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", choices=["torch-cpu", "cuda"], default="torch-cpu")
    parser.add_argument("--batch", type=int, default=16, help="evaluations at a time")
    parser.add_argument("--pixels", type=int, default=512)
    given = parser.parse_args()
    opened = open_torch(given.device)
    print(f"{opened.name}; {given.batch} evaluations at a time, {given.pixels} px; ms per evaluation")
    print(f"{'triangles':>9} {'kernels cpu':>12} {'torch cpu':>10} {'torch wall':>11} {'cpu ratio':>10}")
    for sections in (100, 224):
        fit = ring(sections, given.pixels)
        questions = [(fit, u) for u in np.random.default_rng(0).uniform(-0.3, 0.3, (given.batch, 6))]
        (kernels, _), (cpu, wall) = best(one_by_one, questions), best(opened.answers, questions)
        print(f"{len(fit.surface.faces):9} {kernels:12.2f} {cpu:10.2f} {wall:11.2f} {cpu / kernels:10.1f}")


def ring(sections: int, pixels: int) -> ObjectFit:
    """A ring of 2 * sections^2 triangles over about 30,000 of 512^2 pixels."""
    mesh = trimesh.creation.torus(0.2, 0.09, major_sections=sections, minor_sections=sections)
    surface = Surface.of(
        [(np.asarray(mesh.vertices) @ rotation_from_vector([0.9, 0.3, 0.2]).T, np.asarray(mesh.faces))]
    )
    K = np.array([[pixels, 0, 0.5 * pixels], [0, pixels, 0.5 * pixels], [0, 0, 1.0]])
    camera = Camera(width=pixels, height=pixels, K=K, T_world_camera=pose(FORWARD, [0, -1.2, 0]))
    freedom = ObjectFreedom(anchor=np.zeros(3), basis=FORWARD[:, :2], reach=np.full(6, 0.2))
    target = Target.of(surface.silhouette(camera))
    return ObjectFit(surface=surface, camera=camera, target=target, freedom=freedom, prior=np.zeros(6))


def best(answers: Answers, questions: Sequence[tuple[ObjectFit, Array]]) -> Array:
    """Least processor and wall time of some runs (2,), per question [ms]."""
    times = list[tuple[float, float]]()
    for _ in range(REPEATS):
        cpu, wall = time.process_time(), time.perf_counter()
        answers(questions)
        times.append((time.process_time() - cpu, time.perf_counter() - wall))
    return 1000 * np.min(times, axis=0) / len(questions)


if __name__ == "__main__":
    main()
