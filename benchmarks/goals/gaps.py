"""The distance of two bodies of convex parts, by non-negative least squares."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.optimize import nnls

FAR = 0.05
"""[m] Gaps beyond this are not measured, only known to be at least so large."""


def least_gap(A: list[np.ndarray], B: list[np.ndarray], far: float = FAR) -> float:
    """The least distance of any part of A to any of B, nearest boxes first."""
    boxes = [[(p.min(axis=0), p.max(axis=0)) for p in parts] for parts in (A, B)]
    pairs = sorted(
        (float(np.linalg.norm(np.maximum(0, np.maximum(b[0] - a[1], a[0] - b[1])))), i, j)
        for (i, a), (j, b) in itertools.product(enumerate(boxes[0]), enumerate(boxes[1]))
    )
    least = far
    for bound, i, j in pairs:
        if bound >= least or least == 0:
            break
        least = min(least, hull_gap(A[i], B[j]))
    return least


def hull_gap(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two convex hulls of points: weights of both that bring two of their points nearest."""
    middle, scale = b.mean(axis=0), float(np.abs(b - b.mean(axis=0)).max() + np.abs(a - a.mean(axis=0)).max())
    P, Q = (a - middle) / scale, (b - middle) / scale
    heavy = 1e3  # how much the weights' sums of 1 count against the distance, whose unit is the bodies' size
    M = np.zeros((5, len(P) + len(Q)))
    M[:3, : len(P)], M[:3, len(P) :] = P.T, -Q.T
    M[3, : len(P)], M[4, len(P) :] = heavy, heavy
    weights, _ = nnls(M, np.array([0, 0, 0, heavy, heavy]), maxiter=50 * M.shape[1])
    p, q = weights[: len(P)], weights[len(P) :]
    found = float(np.linalg.norm(p @ P / p.sum() - q @ Q / q.sum())) * scale
    return 0.0 if found < 1e-6 else found
