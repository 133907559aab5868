"""film.png: the key moments of a film in order, each with its time and what happens in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from f3sr.film.captions import INK, PAPER, captioned, font, wrapped
from f3sr.film.event_text import clock, told
from f3sr.film.moments import Moment
from f3sr.film.video import Picture
from f3sr.io.images import encode_png, resized

CELL = 480
"""Width of a picture [px]: three beside each other are still readable where a page is 900 wide."""
MARGIN, GAP = 24, 16
"""Around everything and between pictures [px]."""
TITLE, TEXT = 24, 19
"""Height of letters of the title and of words below pictures [px]."""
LINES = 3
"""Most lines of words below a picture."""
GOOD, BAD = (23, 105, 45), (173, 29, 20)
"""Colours of the verdict, dark enough to be read on white."""


@dataclass(frozen=True, kw_only=True)
class Title:
    """What is above the pictures."""

    goal: str
    met: bool


def strip(moments: Sequence[Moment], pictures: Sequence[Picture], title: Title) -> bytes:
    """A PNG of the moments' pictures (h, w, 3), one each, with a title above."""
    columns = len(moments) if len(moments) < 4 else 2 if len(moments) == 4 else 3
    height = round(CELL * pictures[0].shape[0] / pictures[0].shape[1])
    up, down = font(TEXT).getmetrics()
    words = [wrapped(told(m.what), font(TEXT), CELL, LINES) for m in moments]
    rows = [range(k, min(k + columns, len(moments))) for k in range(0, len(moments), columns)]
    tall = [height + 6 + (up + down) * max(len(words[k]) for k in row) + GAP for row in rows]
    top = MARGIN + TITLE + GAP
    sheet = Image.new("RGB", (2 * MARGIN + columns * CELL + (columns - 1) * GAP, top + sum(tall) + MARGIN - GAP), PAPER)
    draw = ImageDraw.Draw(sheet)
    _entitle(draw, title, sheet.width)
    for row, step in zip(rows, tall, strict=True):
        for column, k in enumerate(row):
            left = MARGIN + column * (CELL + GAP)
            small = captioned(resized(pictures[k], CELL, height), clock(moments[k].time))
            sheet.paste(Image.fromarray(small), (left, top))
            for n, line in enumerate(words[k]):
                draw.text((left, top + height + 6 + n * (up + down)), line, fill=INK, font=font(TEXT))
        top += step
    return encode_png(np.asarray(sheet))


def _entitle(draw: ImageDraw.ImageDraw, title: Title, width: int) -> None:
    letters = font(TITLE)
    verdict, color = ("goal met", GOOD) if title.met else ("goal not met", BAD)
    room = width - 2 * MARGIN - GAP - letters.getlength(verdict)
    line = wrapped(title.goal, letters, math.floor(room), 1)[0]
    draw.text((MARGIN, MARGIN - 4), line, fill=INK, font=letters)
    draw.text((width - MARGIN, MARGIN - 4), verdict, fill=color, font=letters, anchor="ra")
