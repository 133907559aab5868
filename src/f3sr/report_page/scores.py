"""The measures of direct composition and of the result: which way is better, and what changed."""

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
    """A field of ``Measures`` and how it is shown; the template says what it means."""

    field: str
    title: str
    better: Better | None = None
    unit: str = ""
    digits: int = 4
    """Significant ones."""
    noise: float = 0.0
    """Differences up to this are no difference."""


MAIN = (
    Score(field="mIoU", title="mIoU", better="higher"),
    Score(field="PSNR", title="PSNR", better="higher", unit="dB"),
    Score(field="R_pen", title="R_pen", better="lower"),
    Score(field="K_max_J", title="K_max", better="lower", unit="J", digits=3, noise=1e-6),
    Score(field="D_max_cm", title="D_max", better="lower", unit="cm", digits=3, noise=1e-3),
)
OTHERS = (
    Score(field="mIoU_visible", title="mIoU visible", better="higher"),
    Score(field="N_cross", title="N_cross", better="lower"),
    Score(field="gap_pct", title="worst gap", better="lower", unit="%", digits=3),
    Score(field="below_pct", title="below ground", better="lower", unit="%", digits=3, noise=1e-3),
    Score(field="inside", title="points inside", better="lower"),
    Score(field="proxy_out_pct", title="mesh outside proxy", better="lower", unit="%", digits=3, noise=1e-3),
    Score(field="proxy_far_pct", title="proxy off mesh", better="lower", unit="%", digits=3),
    Score(field="n", title="objects"),
    Score(field="fixed", title="fixed"),
    Score(field="excluded", title="excluded"),
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
    def sign(self) -> str:
        if self.change == "same":
            return "="
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
