"""Kernels of the light's fit: sums over samples of what a light makes of their albedo, per group of samples."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from f3sr.runtime.kernels import inline_kernel, kernel


@inline_kernel
def _lit(bases: NDArray[Any], i: int, strength: NDArray[Any]) -> float:
    return bases[i, 0] * strength[0] + bases[i, 1] * strength[1] + bases[i, 2] * strength[2] + bases[i, 3] * strength[3]


@kernel
def sum_lit(
    group: NDArray[Any], albedo: NDArray[Any], bases: NDArray[Any], strength: NDArray[Any], sums: NDArray[Any]
) -> None:
    """Add to ``sums`` (groups, 3) the albedo (n, 3) of their samples under light of ``strength`` (4,) in ``bases``
    (n, 4)."""
    for i in range(len(group)):
        light = _lit(bases, i, strength)
        for c in range(3):
            sums[group[i], c] += light * albedo[i, c]


@kernel
def sum_misfits(
    group: NDArray[Any],
    albedo: NDArray[Any],
    photo: NDArray[Any],
    slope: NDArray[Any],
    bases: NDArray[Any],
    strength: NDArray[Any],
    gains: NDArray[Any],
    sums: NDArray[Any],
) -> None:
    """Add the misfits of samples to the ``sums`` (groups,) of their groups, under a light and ``gains`` (groups, 3).

    A misfit is the mean over channels of the difference to the photo (n, 3), times ``slope`` (n, 3)."""
    for i in range(len(group)):
        light, g = _lit(bases, i, strength), group[i]
        misfit = 0.0
        for c in range(3):
            # slope turns a difference of linear light into one of sRGB values, as the eye weighs it.
            misfit += abs(slope[i, c] * (photo[i, c] - gains[g, c] * light * albedo[i, c]))
        sums[g] += misfit / 3


@kernel
def add_equations(
    group: NDArray[Any],
    albedo: NDArray[Any],
    photo: NDArray[Any],
    slope: NDArray[Any],
    bases: NDArray[Any],
    strength: NDArray[Any],
    gains: NDArray[Any],
    spread: NDArray[Any],
    loose: float,
    gram: NDArray[Any],
    target: NDArray[Any],
) -> None:
    """Add the normal equations of the light's strengths: the lower half of ``gram`` (4, 4), and ``target`` (4,).

    Each exposed sample is fitted to the photo with weight ``slope`` over its group's ``spread`` (groups,). Residuals
    beyond ``loose`` spreads have less weight (Cauchy weights)."""
    for i in range(len(group)):
        light, g = _lit(bases, i, strength), group[i]
        for c in range(3):
            # The model is photo = exposed * (bases . strength), linear in the strengths; its row of the design is
            # exposed * bases.
            exposed = gains[g, c] * albedo[i, c]
            # Cauchy: weight 1 / (1 + off^2), off being the residual at the last strengths, in ``loose`` spreads.
            off = slope[i, c] * (photo[i, c] - exposed * light) / (loose * spread[g])
            weight = (slope[i, c] / spread[g]) ** 2 / (1 + off * off)
            for j in range(4):
                target[j] += weight * exposed * bases[i, j] * photo[i, c]
                for k in range(j + 1):
                    gram[j, k] += weight * exposed * exposed * bases[i, j] * bases[i, k]
