"""What lies on the device: surfaces and fields of fits, sent there once, and the batch of questions about them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray

from f3sr.frames import Array
from f3sr.silhouette_fit import ObjectFit

Tensor: TypeAlias = Any
"""A torch tensor: pyright sees torch only where it is installed."""

Question = tuple[ObjectFit, Array]

WEIGHTS = slice(0, 3)
"""Columns of a pixel: valid, mismatch and stiffness,"""
SUMS = slice(3, 6)
"""and the sums over the pixels before it in its row of valid, valid x and mismatch."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Lists:
    """Lists of rows (n, k), one after the other: list i is ``rows[starts[i] : starts[i] + counts[i]]``."""

    rows: Tensor
    starts: Tensor
    counts: Tensor

    def plus(self, several: Sequence[NDArray[Any]]) -> Lists:
        """These and some lists more."""
        sent = [torch.tensor(rows, dtype=self.rows.dtype, device=self.rows.device) for rows in several]
        counts = torch.tensor([len(rows) for rows in several], device=self.rows.device)
        return Lists(
            rows=torch.cat([self.rows, *sent]),
            starts=torch.cat([self.starts, len(self.rows) + torch.cumsum(counts, 0) - counts]),
            counts=torch.cat([self.counts, counts]),
        )

    def taken(self, which: Tensor) -> tuple[Tensor, Tensor]:
        """The lists of these indices (b,), one after the other: whose (n,) in 0..b - 1 each row is, and the rows."""
        item, place = spread(self.counts[which])
        return item, self.rows[self.starts[which][item] + place]


@dataclass(frozen=True, eq=False, kw_only=True)
class Stock:
    """Surfaces and fields of some fits: all that no parameter changes."""

    index: dict[ObjectFit, int]
    vertices: Lists
    """(n, 3) in the world [m]."""
    faces: Lists
    """(m, 3) into a surface's own vertices."""
    edges: Lists
    """(e, 2) likewise."""
    pixels: Lists
    """(h (w + 1), 6) by row and column: WEIGHTS and SUMS; the last of a row lies beyond the image."""

    @classmethod
    def empty(cls, device: str) -> Stock:
        def none(columns: int, dtype: Any) -> Lists:
            whole = torch.zeros(0, dtype=torch.int64, device=device)
            return Lists(rows=torch.zeros((0, columns), dtype=dtype, device=device), starts=whole, counts=whole)

        return cls(
            index={},
            vertices=none(3, torch.float64),
            faces=none(3, torch.int64),
            edges=none(2, torch.int64),
            pixels=none(6, torch.float64),
        )

    def with_fits(self, fits: Iterable[ObjectFit]) -> Stock:
        """This and what it does not hold yet."""
        new = [fit for fit in dict.fromkeys(fits) if fit not in self.index]
        if not new:
            return self
        return Stock(
            index=self.index | {fit: len(self.index) + k for k, fit in enumerate(new)},
            vertices=self.vertices.plus([fit.surface.vertices for fit in new]),
            faces=self.faces.plus([fit.surface.faces for fit in new]),
            edges=self.edges.plus([fit.surface.edges for fit in new]),
            pixels=self.pixels.plus([_pixel_rows(fit) for fit in new]),
        )


def _pixel_rows(fit: ObjectFit) -> Array:
    """(h (w + 1), 6): the fields of a fit and their sums along rows."""
    fields, (h, w) = fit.target.fields, fit.target.mask.shape
    valid, mismatch = fields.valid.astype(float), fields.mismatch.astype(float)
    summed = np.stack([valid, valid * (np.arange(w) + 0.5), mismatch], axis=-1)
    rows = np.zeros((h, w + 1, 6))
    rows[:, :w, WEIGHTS] = np.stack([valid, mismatch, fields.stiffness], axis=-1)
    rows[:, 1:, SUMS] = np.cumsum(summed, axis=1)
    return rows.reshape(-1, 6)


@dataclass(frozen=True, eq=False, kw_only=True)
class Batch:
    """b questions: which fits of the stock, and where their parameters put them."""

    stock: Stock
    which: Tensor
    """(b,) indices of fits."""
    motion: Tensor
    """(b, 3, 4): points of the world to camera axes, as the parameters move them."""
    velocities: Tensor
    """(b, p, 12): the fields M_p."""
    K: Tensor
    """(b, 3, 3) [px]."""
    size: Tensor
    """(b, 2): width and height [px]."""
    canvas: tuple[int, int]
    """Rows and columns that hold every image, with a column beyond."""

    @classmethod
    def of(cls, stock: Stock, questions: Sequence[Question]) -> Batch:
        cameras = [fit.camera for fit, _ in questions]

        def sent(values: Iterable[Any], dtype: Any) -> Tensor:
            return torch.tensor(np.array(list(values)), dtype=dtype, device=stock.vertices.rows.device)

        return cls(
            stock=stock,
            which=sent((stock.index[fit] for fit, _ in questions), torch.int64),
            motion=sent((_motion(fit, u) for fit, u in questions), torch.float64),
            velocities=sent((fit.freedom.velocities(u, fit.camera) for fit, u in questions), torch.float64).flatten(2),
            K=sent((c.K for c in cameras), torch.float64),
            size=sent(((c.width, c.height) for c in cameras), torch.int64),
            canvas=(max(c.height for c in cameras), max(c.width for c in cameras) + 1),
        )


def _motion(fit: ObjectFit, u: Array) -> Array:
    T, s = fit.freedom.similarity(u)
    motion = (fit.camera.T_camera_world @ T)[:3]
    return np.column_stack([s * motion[:, :3], motion[:, 3]])


def spread(counts: Tensor) -> tuple[Tensor, Tensor]:
    """For lists of these lengths (b,), one after the other: whose each row is, and its place there."""
    item = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)
    return item, torch.arange(len(item), device=counts.device) - (torch.cumsum(counts, 0) - counts)[item]


def unravelled(place: Tensor, canvas: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
    """Item, row and column of a place in the flat mask."""
    height, width = canvas
    return place // (height * width), place // width % height, place % width


def pixels_at(batch: Batch, item: Tensor, row: Tensor, column: Tensor) -> Tensor:
    """The fields (n, 6) at pixels."""
    start = batch.stock.pixels.starts[batch.which][item]
    return batch.stock.pixels.rows[start + row * (batch.size[item, 0] + 1) + column]
