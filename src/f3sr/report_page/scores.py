"""The measures, with direct composition beside: what each means and which way is better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from f3sr.metrics.measures import IMAGE_MEASURES, Measures
from f3sr.report_page.formatting import number, quantity, told
from f3sr.report_page.page_data import PageData
from f3sr.stages.evaluate import Evaluation, FittedCameraMeasures
from f3sr.web.markup import Child, Markup, el, join


@dataclass(frozen=True, kw_only=True)
class Score:
    """One row: a field of ``Measures`` and how it is shown."""

    field: str
    title: str
    meaning: str
    better: Literal["higher", "lower"] | None
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
        meaning="How well full silhouettes meet their masks, 1 is perfect; what is hidden in the photo scores less.",
    ),
    Score(
        field="PSNR",
        title="PSNR",
        better="higher",
        unit="dB",
        meaning="How well unlit texture colours meet the photo inside the masks; 20 dB is good, light and shade cost.",
    ),
    Score(
        field="R_pen",
        title="R_pen",
        better="lower",
        meaning="How much surfaces pierce each other: length of crossings over the scene's diagonal; 0 is free.",
    ),
    Score(
        field="K_max_J",
        title="K_max",
        better="lower",
        unit="J",
        digits=3,
        noise=1e-6,
        meaning="Largest kinetic energy in the first second after release: what would jump.",
    ),
    Score(
        field="D_max_cm",
        title="D_max",
        better="lower",
        unit="cm",
        digits=3,
        noise=1e-3,
        meaning="Largest travel of any object in 5 s of undamped physics: what would not stay.",
    ),
)
OTHERS = (
    Score(
        field="mIoU_visible",
        title="mIoU visible",
        better="higher",
        meaning="The same as mIoU with only the pixels that are seen in the whole scene.",
    ),
    Score(field="N_cross", title="N_cross", better="lower", meaning="Pairs of triangles behind R_pen."),
    Score(
        field="gap_pct",
        title="worst gap",
        better="lower",
        unit="%",
        digits=3,
        meaning="Distance of the worst floating object to anything, of its size.",
    ),
    Score(
        field="below_pct",
        title="under ground",
        better="lower",
        unit="%",
        digits=3,
        noise=1e-3,
        meaning="Deepest point under z = 0, of the object's size.",
    ),
    Score(field="inside", title="points inside", better="lower", meaning="Vertices of one object in another's solid."),
    Score(
        field="proxy_out_pct",
        title="mesh outside proxy",
        better="lower",
        unit="%",
        digits=3,
        noise=1e-3,
        meaning="How far a mesh sticks out of its collision parts, of its size; the worst object.",
    ),
    Score(
        field="proxy_far_pct",
        title="proxy off mesh",
        better="lower",
        unit="%",
        digits=3,
        meaning="Mean distance of collision parts from their mesh, of its size; the worst object.",
    ),
    Score(field="n", title="objects", better=None, meaning="Masks with an object."),
    Score(field="fixed", title="fixed", better=None, meaning="Objects that physics does not move."),
    Score(field="excluded", title="excluded", better=None, meaning="Masks without an object; each counts 0 in mIoU."),
)


def scores(m: PageData) -> Markup:
    if m.result.evaluation is None:
        return el("p", "Not measured: the stage evaluate was skipped.", class_="fine")
    evaluation = m.result.evaluation
    return join(
        el(
            "p",
            "Direct composition is the input as it came, levelled, its lowest point on the ground. ",
            "Both are measured alike, undamped, from the state in the package.",
            class_="fine",
        ),
        el("table", _head(), _rows(MAIN, evaluation), _rows(OTHERS, evaluation, class_="minor"), class_="scores"),
        _cameras(evaluation),
    )


def _cameras(evaluation: Evaluation) -> Child:
    """What the numbers called fitted are."""
    decisions = evaluation.report.decisions
    if not decisions:
        return None
    words = (
        "Fitted: the same scene seen by a camera of its own, fitted to its masks inside bounds and then held. "
        "That is the report's protocol for scenes that are not aligned; only what is measured in the picture changes."
    )
    found = (el("li", told(d.choice), " ", el("span", told(d.reason), class_="quiet")) for d in decisions)
    return join(el("p", words, class_="fine"), el("ul", found, class_="decisions"))


def _head() -> Markup:
    titles = (("Measure", None), ("Direct", "num"), ("Ours", "num"), ("Change", None))
    return el("thead", el("tr", (el("th", title, class_=kind, scope="col") for title, kind in titles)))


def _rows(rows: tuple[Score, ...], evaluation: Evaluation, **attributes: str) -> Markup:
    return el("tbody", (_row(row, evaluation) for row in rows), **attributes)


def _row(score: Score, evaluation: Evaluation) -> Markup:
    before, after = _value(evaluation.direct, score), float(getattr(evaluation.result, score.field))
    return el(
        "tr",
        el("th", el("b", score.title), " ", el("span", score.meaning, class_="meaning"), scope="row"),
        el("td", _shown(before, score), _fitted(evaluation.direct_fitted, score), class_="num"),
        el("td", _shown(after, score), _fitted(evaluation.result_fitted, score), class_="num ours"),
        el("td", change(before, after, score)),
    )


def _value(measures: Measures | None, score: Score) -> float | None:
    return None if measures is None else float(getattr(measures, score.field))


def _shown(value: float | None, score: Score) -> Markup:
    return quantity(value, score.unit, digits=score.digits)


def _fitted(fitted: FittedCameraMeasures | None, score: Score) -> Child:
    """The same as a fitted camera sees it, where that makes a difference."""
    if fitted is None or score.field not in IMAGE_MEASURES:
        return None
    return el("span", "fitted ", _shown(_value(fitted.measures, score), score), class_="fitted")


def change(before: float | None, after: float, score: Score) -> Child:
    """Better or worse as a sign and a word, not as a colour alone; what reads the same is the same."""
    if before is None or score.better is None:
        return None
    if abs(before - after) <= score.noise or number(before, digits=score.digits) == number(after, digits=score.digits):
        return el("span", "= same", class_="same")
    gained = (after > before) == (score.better == "higher")
    sign = "▲" if after > before else "▼"
    word = "better" if gained else "worse"
    return el("span", f"{sign} {word}", class_=word)
