"""The measures of direct composition and of the result: what each means and which way is better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from f3sr.metrics.measures import IMAGE_MEASURES, Measures
from f3sr.report_page.formatting import number
from f3sr.report_page.page_data import PageData
from f3sr.stages.evaluate import Evaluation

Better = Literal["higher", "lower"]
Change = Literal["better", "worse", "same"]


@dataclass(frozen=True, kw_only=True)
class Score:
    """A field of ``Measures`` and how it is shown."""

    field: str
    title: str
    meaning: str
    better: Better | None
    unit: str = ""
    digits: int = 4
    """Significant ones."""
    noise: float = 0.0
    """Differences up to this are no difference."""


MAIN = (
    Score(
        field="mIoU",
        title="mIoU",
        better="higher",
        meaning="Mean IoU of full silhouettes and masks: 1 is perfect, occlusion in the photo lowers it.",
    ),
    Score(
        field="PSNR",
        title="PSNR",
        better="higher",
        unit="dB",
        meaning="Unlit texture colours against the photo inside the masks: 20 dB is good, light and shadow lower it.",
    ),
    Score(
        field="R_pen",
        title="R_pen",
        better="lower",
        meaning="Penetration: total length of surface crossings over the scene's diagonal; 0 is none.",
    ),
    Score(
        field="K_max_J",
        title="K_max",
        better="lower",
        unit="J",
        digits=3,
        noise=1e-6,
        meaning="Largest kinetic energy in the first second after release: objects that jump.",
    ),
    Score(
        field="D_max_cm",
        title="D_max",
        better="lower",
        unit="cm",
        digits=3,
        noise=1e-3,
        meaning="Largest travel of any object in 5 s of undamped physics: objects that do not stay.",
    ),
)
OTHERS = (
    Score(
        field="mIoU_visible",
        title="mIoU visible",
        better="higher",
        meaning="mIoU of the pixels that are visible in the whole scene.",
    ),
    Score(
        field="N_cross", title="N_cross", better="lower", meaning="Pairs of crossing triangles, from which R_pen comes."
    ),
    Score(
        field="gap_pct",
        title="worst gap",
        better="lower",
        unit="%",
        digits=3,
        meaning="Distance from the worst floating object to the nearest surface, as a share of its size.",
    ),
    Score(
        field="below_pct",
        title="below ground",
        better="lower",
        unit="%",
        digits=3,
        noise=1e-3,
        meaning="Deepest point below z = 0, as a share of the object's size.",
    ),
    Score(
        field="inside", title="points inside", better="lower", meaning="Vertices of one object inside another's solid."
    ),
    Score(
        field="proxy_out_pct",
        title="mesh outside proxy",
        better="lower",
        unit="%",
        digits=3,
        noise=1e-3,
        meaning="Largest distance of a mesh outside its collision parts, as a share of its size; the worst object.",
    ),
    Score(
        field="proxy_far_pct",
        title="proxy off mesh",
        better="lower",
        unit="%",
        digits=3,
        meaning="Mean distance of collision parts from their mesh, as a share of its size; the worst object.",
    ),
    Score(field="n", title="objects", better=None, meaning="Masks that have an object."),
    Score(field="fixed", title="fixed", better=None, meaning="Objects that physics does not move."),
    Score(field="excluded", title="excluded", better=None, meaning="Masks without an object; each counts 0 in mIoU."),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class ScoreRow:
    """A measure's values; None where there is none. ``fitted``: as a fitted camera sees the scene."""

    score: Score
    direct: float | None
    ours: float
    direct_fitted: float | None
    ours_fitted: float | None

    @property
    def change(self) -> Change | None:
        """What reads the same is the same."""
        score, a, b = self.score, self.direct, self.ours
        if a is None or score.better is None:
            return None
        if abs(a - b) <= score.noise or number(a, digits=score.digits) == number(b, digits=score.digits):
            return "same"
        return "better" if (b > a) == (score.better == "higher") else "worse"

    @property
    def arrow(self) -> str:
        return "▲" if self.direct is not None and self.ours > self.direct else "▼"


def scores(page: PageData) -> tuple[list[ScoreRow], ...]:
    """The main measures and the others; nothing without an evaluation."""
    evaluation = page.result.evaluation
    return tuple([_row(s, evaluation) for s in group] for group in (MAIN, OTHERS)) if evaluation else ()


def _row(score: Score, evaluation: Evaluation) -> ScoreRow:
    seen = score.field in IMAGE_MEASURES
    direct, ours = evaluation.direct_fitted, evaluation.result_fitted
    return ScoreRow(
        score=score,
        direct=_value(evaluation.direct, score),
        ours=float(getattr(evaluation.result, score.field)),
        direct_fitted=_value(direct.measures if direct and seen else None, score),
        ours_fitted=_value(ours.measures if ours and seen else None, score),
    )


def _value(measures: Measures | None, score: Score) -> float | None:
    return None if measures is None else float(getattr(measures, score.field))
