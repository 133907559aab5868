"""Masks against renders, without and with alignment: every object alone, the worst first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.report_page.mask_panels import MaskPanels, mask_panels
from f3sr.report_page.page_data import PageData
from f3sr.vision.occlusion import comparable_region, occluders
from f3sr.vision.pictures import Image

SHOWN_AT_ONCE = 12
"""Objects whose panels are not folded away; the rest opens at a click, and in print."""
PANEL_SIDE = (120, 320)
"""Smallest and largest side of a panel [px]."""
SAME = 0.005
"""Differences of IoU up to this are not shown."""
LEAST_HIDDEN = 0.01
"""Share of an object from which on it is called hidden."""


@dataclass(frozen=True, eq=False)
class Card:
    """An object with its panels: of the input, of ours, and after the stage align, where it was done."""

    id: int
    panels: MaskPanels

    @property
    def ours(self) -> float:
        return self.panels.ious[1]

    @property
    def pictures(self) -> list[tuple[str, Image, float]]:
        """Title, picture and IoU."""
        return list(zip(("Input", "Ours"), self.panels.pictures, self.panels.ious[:2], strict=True))

    @property
    def worse(self) -> bool:
        return self.ours < self.panels.ious[0] - SAME

    @property
    def aligned(self) -> float | None:
        """The IoU after align, where ours differs."""
        reached = self.panels.ious[2:]
        return reached[0] if reached and abs(reached[0] - self.ours) > SAME else None

    @property
    def hidden(self) -> float | None:
        """The share of ours behind what is nearer, where it is worth a word."""
        return self.panels.hidden[1] if self.panels.hidden[1] >= LEAST_HIDDEN else None


@dataclass(frozen=True, eq=False, kw_only=True)
class FoldedCards:
    """The worst objects, and the rest, which is folded."""

    first: Sequence[Card]
    rest: Sequence[Card]


def folded(page: PageData) -> FoldedCards:
    found = sorted(cards(page), key=lambda c: (c.ours, c.id))
    return FoldedCards(first=found[:SHOWN_AT_ONCE], rest=found[SHOWN_AT_ONCE:])


def cards(page: PageData) -> list[Card]:
    """Every object compared with its mask: in the input, in ours, and after the stage align."""
    scenes = page.result.scenes
    states = [page.direct, page.scene, *([scenes["align"]] if "align" in scenes else [])]
    hiding = occluders(page.scene)
    longest = int(np.clip(np.sqrt(page.sizes.panels / 2 / len(page.scene.objects)), *PANEL_SIDE))
    hidden = {o.id: ~comparable_region(o, hiding[o.id], page.scene) for o in page.scene}
    return [Card(id, mask_panels(id, states, there, longest=longest, drawn=(0, 1))) for id, there in hidden.items()]
