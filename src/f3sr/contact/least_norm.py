"""The shortest vector that satisfies linear inequalities (Lawson and Hanson, "Solving Least Squares Problems", chapter
23: least distance by non-negative least squares)."""

from __future__ import annotations

import numpy as np

from f3sr.core.transforms import Array

PRICES = 4
"""Prices from 1 to the wanted one."""
NEWTON_STEPS = 60
"""Most steps; fifteen suffice."""
ROUNDING = 1e-9
"""Share of x that a step must change to go on."""


def shortest(rows: Array) -> Array | None:
    """The shortest x (n,) with ``rows[:, :-1] @ x >= rows[:, -1]`` for rows (k, n + 1), None when there is none, or
    none is found."""
    from scipy.optimize import nnls

    if not len(rows) or (rows[:, -1] <= 0).all():
        return np.zeros(rows.shape[1] - 1)
    # With E = [G'; h'] and f = (0, .., 0, 1), u >= 0 least in |E u - f|, r = E u - f, the shortest x with G x >= h is
    # -r[:n] / r[n]. r = 0 says that no x exists. h is scaled to 1 for the rounding test.
    unit = np.abs(rows[:, -1]).max()
    E = np.vstack([rows[:, :-1].T, rows[:, -1] / unit])
    target = np.zeros(len(E))
    target[-1] = 1
    scale = np.maximum(np.linalg.norm(E, axis=0), 1e-300)
    try:
        u, _ = nnls(E / scale, target, maxiter=30 * E.shape[1])
    except RuntimeError:  # rounding kept it from an end
        return None
    left = (E / scale) @ u - target
    if abs(left[-1]) < 1e-10:
        return None
    return -left[:-1] / left[-1] * unit


def nearly(rows: Array, price: float) -> Array:
    """The x (n,) with the least ``|x|^2 + price |s|^2``, where ``rows[:, :-1] @ x + s >= rows[:, -1]``.

    The gradient is piecewise linear: Newton's method ends after some steps. The price grows, each from where the last
    one ended: at once, a price of 1e12 leads nowhere in one of five cases."""
    x = np.zeros(rows.shape[1] - 1)
    for share in np.linspace(0, 1, PRICES):
        x = _descended(rows[:, :-1], rows[:, -1], price**share, x)
    return x


def _descended(G: Array, h: Array, price: float, x: Array) -> Array:
    """Where ``_cost`` is least, from ``x``."""
    short = h - G @ x
    cost = _cost(x, short, price)
    for _ in range(NEWTON_STEPS):
        active = short > 0
        A = G[active]
        gradient = x - price * A.T @ short[active]
        step = -np.linalg.solve(np.eye(len(x)) + price * A.T @ A, gradient)
        size, slope, along = 1.0, float(gradient @ step), G @ step
        while (new := _cost(x + size * step, short - size * along, price)) > cost + 1e-4 * size * slope:
            size /= 2
            if size <= ROUNDING:
                break
        x, short, cost = x + size * step, short - size * along, new
        if size * np.abs(step).max() <= ROUNDING * (1 + np.abs(x).max()):
            break
    return x


def _cost(x: Array, short: Array, price: float) -> float:
    missing = np.maximum(short, 0)
    return float(x @ x + price * missing @ missing) / 2
