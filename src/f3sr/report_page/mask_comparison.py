"""Masks against renders, without and with alignment: the whole scene, then every object alone, the worst first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.report_page.formatting import counted, name_of, ratio, share
from f3sr.report_page.mask_panels import MaskPanels, mask_panels
from f3sr.report_page.page_data import PageData
from f3sr.scene import Scene, SceneObject
from f3sr.vision.occlusion import nearer_objects
from f3sr.web.figures import figure, img
from f3sr.web.markup import Child, Markup, el, join

SHOWN_AT_ONCE = 12
"""Objects whose panels are not folded away; the rest opens at a click, and in print."""
PANEL_SIDE = (120, 320)
"""Smallest and largest side of a panel [px]."""
SAME = 0.005
"""Differences of IoU up to this are not told."""
LEAST_HIDDEN = 0.01
"""Share of an object from which on it is said that it is hidden."""


@dataclass(frozen=True, eq=False)
class Card:
    """An object with its panels: of the input, of ours, and what alignment alone had reached, where it was done."""

    o: SceneObject
    panels: MaskPanels

    @property
    def ours(self) -> float:
        return self.panels.ious[1]


def masks(m: PageData) -> Markup:
    found = sorted(cards(m), key=lambda c: (c.ours, c.o.id))
    first, rest = found[:SHOWN_AT_ONCE], found[SHOWN_AT_ONCE:]
    folded = el("details", el("summary", f"{counted(len(rest), 'more object')}, fitting better"), _grid(rest, m))
    return join(
        legend(),
        el("h3", "The whole scene"),
        el("div", _whole(m), class_="row"),
        el("h3", "Every object alone, the worst first"),
        el(
            "p",
            "Its whole render against its mask, without and with alignment. ",
            el("span", class_="hatch"),
            " Hatched lies behind masks of nearer objects; nothing is compared there. ",
            "The number is the IoU elsewhere, 1 is perfect.",
            class_="fine",
        ),
        _grid(first, m),
        folded if rest else None,
    )


def legend() -> Markup:
    """What the colours of whole scenes mean."""
    return el(
        "p",
        "Masks against visible renders over the greyed photo: ",
        el("span", "red", class_="key mask"),
        " photo mask only, ",
        el("span", "green", class_="key render"),
        " render only, ",
        el("span", "blue", class_="key both"),
        " both, dark blue another object's mask; white lines part objects.",
        class_="fine",
    )


def cards(m: PageData) -> list[Card]:
    """Every object compared with its mask: in the input, in ours, and after the stage align."""
    states = [m.direct, m.scene, *([m.result.scenes["align"]] if "align" in m.result.scenes else [])]
    nearer = nearer_objects(m.scene)
    longest = int(np.clip(np.sqrt(m.sizes.panels / 2 / len(m.scene.objects)), *PANEL_SIDE))
    return [Card(o, mask_panels(o.id, states, nearer[o.id], longest=longest, drawn=(0, 1))) for o in m.scene]


def _whole(m: PageData) -> list[Markup]:
    how = "with alignment" if "align" in m.result.scenes else "not aligned either"
    return [
        figure(m.overlay(m.direct, "Masks and the input"), join(el("b", "Input"), ": as it came, without alignment")),
        figure(m.overlay(m.scene, "Masks and ours"), join(el("b", "Ours"), f": {how}, as in the package")),
    ]


def _grid(found: Sequence[Card], m: PageData) -> Markup:
    return el("div", (_card(c, m.scene) for c in found), class_="panels")


def _card(c: Card, scene: Scene) -> Markup:
    name = name_of(c.o.id, scene)
    figures = (
        figure(img(picture, f"{name}, {title.lower()}: IoU {value:.3f}"), join(title, " ", el("b", ratio(value))))
        for title, picture, value in zip(("Input", "Ours"), c.panels.pictures, c.panels.ious[:2], strict=True)
    )
    return el("article", el("h4", el("bdi", name)), el("div", figures, class_="pictures"), _note(c), class_="panel")


def _note(c: Card) -> Child:
    parts: list[Child] = []
    if c.ours < c.panels.ious[0] - SAME:
        parts.append(el("span", "▼ worse", class_="worse"))
    if len(c.panels.ious) > 2 and abs(c.panels.ious[2] - c.ours) > SAME:
        parts.append(join("after align ", ratio(c.panels.ious[2])))
    if c.panels.hidden[1] >= LEAST_HIDDEN:
        parts.append(f"{share(c.panels.hidden[1])} hidden")
    if not parts:
        return None
    return el("p", (join("; " if k else None, part) for k, part in enumerate(parts)), class_="fine")
