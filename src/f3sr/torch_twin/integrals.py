"""The integrals over silhouettes and their derivatives, those of many objects at once.

The mathematics is that of ``raster`` and ``contour``. Pixels whose centres a triangle covers form the hard mask S. By
rows, S is a set of runs, so that the sum of a field w over it needs no pixel but those where runs end, with C(r, c) =
sum of w(r, c') over c' < c:

    sum over S of w = sum over the ends of runs of C - sum over their starts of C.

The outline crosses the lines through pixel centres where projected edges do, the farthest out in every pair of
neighbours of which one is inside. With d = 1 where the inside comes first and -1 elsewhere, b the way from the border
of the two pixels to the crossing, n the outward normal and ds = |n_x| on rows, |n_y| on columns, the integrals are

    F_k = sum over S of w_k + sum over crossings of ds^2 d b w_k,
    dF_k/dtheta_p = sum over crossings of ds w_k J_p     (Reynolds' transport theorem),
    H_pq = sum over crossings of ds stiffness J_p J_q.

Parameters move points X in camera axes by M_p (X, 1), affine fields (3, 4). So J_p = n . dpi/dX . M_p (X, 1) is the
product M_p : G of two matrices, of which G = (n . dpi/dX) (X, 1)^T knows nothing of parameters: it is G that is summed.

Lists of objects of all sizes lie one after the other, ``item`` telling whose a row is. What threads add to in any order
are whole numbers and maxima; floating-point sums run over one object's rows in their order, so that a device gives the
same bytes again (tested on a CPU). Sums of an object alone and among others differ by rounding. All is float64: in
float32 edges crack, which moved a gradient by two percent on one real mesh of eight.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch  # pyright: ignore[reportMissingImports]

from f3sr.contour import Integrals
from f3sr.torch_twin.batch import Batch, Question, Stock, Tensor
from f3sr.torch_twin.mask import hard_mask, projected, runs
from f3sr.torch_twin.outline import outline_of, terms_of

LARGEST_BATCH = 2_000_000
"""Triangles in one batch, with a sixteenth of its pixels: about 1 GB (450 bytes each, measured on a CPU)."""


class TorchIntegrals:
    """Answers searches of objects' fits on one device, all their questions at once.

    Meshes and fields are sent to the device when first asked about and stay until this is dropped.
    """

    def __init__(self, device: str) -> None:
        self._stock = Stock.empty(device)

    def __call__(self, questions: Sequence[Question]) -> list[Integrals]:
        """As ``silhouette_fit.one_by_one``."""
        with torch.inference_mode():
            self._stock = self._stock.with_fits(fit for fit, _ in questions)
            return [found for group in _groups(questions) for found in _integrals(Batch.of(self._stock, group))]


def name_of(device: str) -> str:
    """A device in words."""
    found = torch.cuda.get_device_name(device) if device == "cuda" else "the CPU"
    return f"{found} through torch {torch.__version__}"


def _groups(questions: Sequence[Question]) -> Iterator[list[Question]]:
    """The questions, as many at a time as a device may hold."""
    group, size = list[Question](), 0
    for question in questions:
        surface, camera = question[0].surface, question[0].camera
        cost = len(surface.faces) + camera.width * camera.height // 16
        if group and size + cost > LARGEST_BATCH:
            yield group
            group, size = [], 0
        group.append(question)
        size += cost
    if group:
        yield group


def _integrals(batch: Batch) -> list[Integrals]:
    """One per question."""
    points = projected(batch)
    mask = hard_mask(points, batch)
    count = len(batch.which)
    value = _padded(*runs(mask, batch), count).sum(1)
    moment, square = 0, 0
    for upright in (False, True):
        terms = terms_of(outline_of(points, mask, batch, upright=upright), points, batch)
        w, G, h = (_padded(terms.item, rows, count) for rows in (terms.w, terms.G, terms.h))
        value = value + _padded(terms.item, terms.value, count).sum(1)
        moment = moment + w.mT @ G
        square = square + (h * G).mT @ G
    gradient = moment @ batch.velocities.mT
    curvature = batch.velocities @ square @ batch.velocities.mT
    found = (t.cpu().numpy() for t in (value, gradient, curvature))
    return [Integrals(value=F, gradient=dF, curvature=H) for F, dF, H in zip(*found, strict=True)]


def _padded(item: Tensor, rows: Tensor, count: int) -> Tensor:
    """Rows (n, k) of sorted items as (count, longest, k), filled up with zeros."""
    counts = torch.bincount(item, minlength=count)
    place = torch.arange(len(item), device=item.device) - (torch.cumsum(counts, 0) - counts)[item]
    out = torch.zeros((count, int(counts.max()), rows.shape[1]), dtype=rows.dtype, device=rows.device)
    out[item, place] = rows
    return out
