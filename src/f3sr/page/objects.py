"""The table of objects: where each went and why, how well it is seen, how good its proxy is, what carries it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from f3sr.measures import ObjectMeasures
from f3sr.page.images import img
from f3sr.page.markup import Child, Markup, el, join
from f3sr.page.material import Material, by_id
from f3sr.page.words import length, name_of, number, quantity, share
from f3sr.physics import body_of
from f3sr.pictures import resized
from f3sr.scene import Motion, SceneObject

THUMBNAIL = 96
"""Longest side [px]."""
MARGIN = 0.1
"""Of a thumbnail around its mask, as a share of the mask's longer side."""
OUTSIDE = 0.25
"""Brightness of a thumbnail's pixels that are not the object's."""
NO_TURN, NO_SCALE = np.radians(0.05), 5e-4
"""Turns [rad] and changes of scale that are not worth a word."""
INFLATION = "proxy volume / mesh volume"


def objects(m: Material) -> Markup:
    titles = ("Object", "Moved", "IoU visible", "Proxy", "Mass", "Rests on")
    before, after = by_id(m.direct_details), by_id(m.details)
    inflation = {
        x.about: x.after for r in m.result.reports for x in r.measures if x.name == INFLATION and x.about is not None
    }
    return el(
        "table",
        el("thead", el("tr", (el("th", t, scope="col") for t in titles))),
        el("tbody", (_row(o, m, titles, before, after, inflation.get(o.id)) for o in m.scene)),
        class_="cards",
    )


def _row(
    o: SceneObject,
    m: Material,
    titles: tuple[str, ...],
    before: Mapping[int, ObjectMeasures],
    after: Mapping[int, ObjectMeasures],
    inflation: float | None,
) -> Markup:
    cells = (
        _moved(o),
        _iou(before.get(o.id), after.get(o.id)),
        _proxy(o, after.get(o.id), inflation),
        join(quantity(body_of(o).mass, "kg", digits=3), el("div", "fixed", class_="tag") if o.mobility == "fixed" else None),
        _supports(o, m),
    )
    name = el("span", el("b", o.id), " ", el("bdi", o.label), el("small", el("bdi", o.mask_name)), class_="name")
    head = el("th", el("div", img(thumbnail(o, m), "", class_="thumb"), name, class_="who"), scope="row")
    return el("tr", head, (el("td", c, data_title=t) for t, c in zip(titles[1:], cells, strict=True)), id=f"object-{o.id}")


def thumbnail(o: SceneObject, m: Material) -> NDArray[np.uint8]:
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


def _moved(o: SceneObject) -> Child:
    if not o.motion:
        return el("span", "not moved", class_="quiet")
    return el("ul", (el("li", _motion(x)) for x in o.motion), class_="moves")


def _motion(x: Motion) -> Markup:
    """``align 42 mm, 31°, ×1.04`` and why."""
    how = [length(float(np.linalg.norm(x.translation)))]
    if x.rotation > NO_TURN:
        how.append(f"{number(float(np.degrees(x.rotation)), digits=2)}°")
    if abs(x.scale - 1) > NO_SCALE:
        how.append(f"×{x.scale:.3f}")
    return join(el("b", x.stage), f" {', '.join(how)} ", el("span", x.reason, class_="quiet"))


def _iou(before: ObjectMeasures | None, after: ObjectMeasures | None) -> Child:
    if after is None:
        return el("span", "not measured", class_="quiet")
    was = join(quantity(before.IoU_visible, digits=3), " → ") if before else None
    return join(was, el("b", quantity(after.IoU_visible, digits=3)))


def _proxy(o: SceneObject, measured: ObjectMeasures | None, inflation: float | None) -> Child:
    lines: list[Child] = [f"{len(o.parts)} part{'s' if len(o.parts) != 1 else ''}"]
    if inflation is not None:
        lines.append(join("volume ×", quantity(inflation, digits=3)))
    if measured:
        lines.append(f"{share(measured.proxy_out)} outside")
        lines.append(f"{share(measured.proxy_far)} off")
    return el("ul", (el("li", x) for x in lines), class_="lines")


def _supports(o: SceneObject, m: Material) -> Child:
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
