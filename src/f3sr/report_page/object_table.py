"""The table of objects: where each went and why, how well it is seen, how good its proxy is, what carries it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import rotation_angle, transform
from f3sr.io.images import resized
from f3sr.metrics.measures import ObjectMeasures
from f3sr.physics.mujoco_model import body_of
from f3sr.report_page.formatting import counted, length, name_of, number, quantity, ratio, share, told
from f3sr.report_page.page_data import PageData, by_id
from f3sr.scene import Motion, SceneObject
from f3sr.stages.decompose import Decomposed
from f3sr.web.figures import img
from f3sr.web.markup import Child, Markup, el, join

THUMBNAIL = 96
"""Longest side [px]."""
MARGIN = 0.1
"""Of a thumbnail around its mask, as a share of the mask's longer side."""
OUTSIDE = 0.25
"""Brightness of a thumbnail's pixels that are not the object's."""
NO_SHIFT, NO_TURN, NO_SCALE = 1e-4, np.radians(0.1), 1e-3
"""Shifts [m], turns [rad] and changes of scale that are not worth a word."""
LOST = 0.05
"""A fall of the visible IoU that is marked."""


def objects(m: PageData) -> Markup:
    titles = ("Object", "Moved", "IoU visible", "Proxy", "Mass", "Rests on")
    before, after = by_id(m.direct_details), by_id(m.details)
    decomposed = (x for x in m.result.outcomes if isinstance(x, Decomposed))
    inflation = {id: fit.inflation for x in decomposed for id, fit in x.fits.items()}
    return el(
        "table",
        el("thead", el("tr", (el("th", t, scope="col") for t in titles))),
        el("tbody", (_row(o, m, titles, before, after, inflation.get(o.id)) for o in m.scene)),
        class_="cards objects",
    )


def _row(
    o: SceneObject,
    m: PageData,
    titles: tuple[str, ...],
    before: Mapping[int, ObjectMeasures],
    after: Mapping[int, ObjectMeasures],
    inflation: float | None,
) -> Markup:
    cells = (
        _moved(moves(m, o.id)),
        _iou(before.get(o.id), after.get(o.id)),
        _proxy(o, after.get(o.id), inflation),
        _mass(o),
        _supports(o, m),
    )
    name = el("span", el("b", o.id), " ", el("bdi", o.label), el("small", el("bdi", o.mask_name)), class_="name")
    head = el("th", el("div", img(thumbnail(o, m), "", class_="thumb"), name, class_="who"), scope="row")
    return el("tr", head, (el("td", el("div", c), data_title=t) for t, c in zip(titles[1:], cells, strict=True)))


def thumbnail(o: SceneObject, m: PageData) -> NDArray[np.uint8]:
    """The photo around the object's mask, the rest dimmed."""
    rows, columns = np.flatnonzero(o.mask.any(1)), np.flatnonzero(o.mask.any(0))
    if not len(rows):
        return np.full((THUMBNAIL, THUMBNAIL, 3), 200, np.uint8)
    pad = round(MARGIN * max(np.ptp(rows), np.ptp(columns))) + 1
    top, left = max(0, rows[0] - pad), max(0, columns[0] - pad)
    crop = slice(top, rows[-1] + pad + 1), slice(left, columns[-1] + pad + 1)
    rgb, mask = m.scene.photo.rgb[crop], o.mask[crop]
    picture = np.where(mask[..., None], rgb, OUTSIDE * rgb + (1 - OUTSIDE) * 128).astype(np.uint8)
    scale = THUMBNAIL / max(picture.shape[:2])
    return resized(picture, max(1, round(scale * picture.shape[1])), max(1, round(scale * picture.shape[0])))


@dataclass(frozen=True, kw_only=True)
class Move:
    """What one stage did to an object: shift of its middle [m], turn [rad], factor of its size, and why."""

    stage: str
    shift: float
    turn: float
    scale: float
    reasons: tuple[str, ...]


def moves(m: PageData, id: int) -> list[Move]:
    """The stages that moved an object, in order. Levelling moves all as one and is no move."""
    found: list[Move] = []
    for (_, a), (stage, b) in pairwise(m.result.scenes.items()):
        before, after = a[id], b[id]
        notes = after.motion[len(before.motion) :]
        if notes:
            middle = before.mesh.bounds.mean(0)
            way = transform(after.T_world_asset, middle) - transform(before.T_world_asset, middle)
            R = after.T_world_object[:3, :3] @ before.T_world_object[:3, :3].T
            found.append(
                Move(
                    stage=stage,
                    shift=float(np.linalg.norm(way)),
                    turn=rotation_angle(R),
                    scale=after.scale / before.scale,
                    reasons=tuple(dict.fromkeys(x.reason for x in notes if _matters(x))),
                )
            )
    return found


def _matters(x: Motion) -> bool:
    return float(np.linalg.norm(x.translation)) > NO_SHIFT or x.rotation > NO_TURN or abs(x.scale - 1) > NO_SCALE


def _moved(found: Sequence[Move]) -> Child:
    """A line per stage: how far, and why."""
    lines = [
        (el("dt", x.stage), el("dd", _how_far(x), " ", el("span", told("; ".join(x.reasons)), class_="quiet")))
        for x in found
    ]
    return el("dl", lines, class_="moves") if lines else el("span", "not moved", class_="quiet")


def _how_far(x: Move) -> str:
    """``42 mm, 31°, ×1.040``: only what is worth a word."""
    parts = (
        length(x.shift) if x.shift > NO_SHIFT else None,
        f"{number(float(np.degrees(x.turn)), digits=2)}°" if x.turn > NO_TURN else None,
        f"×{x.scale:.3f}" if abs(x.scale - 1) > NO_SCALE else None,
    )
    return ", ".join(p for p in parts if p) or f"under {number(1000 * NO_SHIFT)} mm"


def _iou(before: ObjectMeasures | None, after: ObjectMeasures | None) -> Child:
    if after is None:
        return el("span", "not measured", class_="quiet")
    was = join(ratio(before.IoU_visible), " → ") if before else None
    lost = before is not None and after.IoU_visible < before.IoU_visible - LOST
    mark = el("div", "▼ worse", class_="worse") if lost else None
    return join(el("span", was, el("b", ratio(after.IoU_visible)), class_="pair"), mark)


def _proxy(o: SceneObject, measured: ObjectMeasures | None, inflation: float | None) -> Child:
    lines: list[Child] = [counted(len(o.parts), "part")]
    if inflation is not None:
        lines.append(join("volume ×", quantity(inflation, digits=3)))
    if measured:
        lines.append(f"{share(measured.proxy_out)} outside")
        lines.append(f"{share(measured.proxy_far)} off")
    return el("ul", (el("li", x) for x in lines), class_="proxy")


def _mass(o: SceneObject) -> Child:
    fixed = el("div", "fixed", class_="tag") if o.mobility == "fixed" else None
    return join(el("span", quantity(body_of(o).mass, "kg", digits=3), class_="pair"), fixed)


def _supports(o: SceneObject, m: PageData) -> Child:
    if not o.supports:
        return el("span", "nothing known", class_="quiet")
    shares = sorted(o.supports, key=lambda s: -s.share)
    return el(
        "ul",
        (
            el("li", el("bdi", name_of(s.id, m.scene)), f" {100 * s.share:.0f} %" if len(shares) > 1 else None)
            for s in shares
        ),
        class_="lines",
    )
