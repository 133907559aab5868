"""Small text on pictures: white on a dark plate in a corner, readable over anything, drawn once and laid on many."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from f3sr.errors import printable
from f3sr.film.video import Picture

Corner = Literal["top left", "top right", "bottom left", "bottom right"]

HEIGHT_SHARE = 1 / 26
"""Height of the letters over that of the picture."""
SMALLEST = 11
"""Height of letters [px] that can still be read."""
PLATE = 0.62
"""Opacity of the black plate: over white, white letters keep a contrast of 4.5."""
PAPER, INK = (255, 255, 255), (27, 29, 32)
CUT = "…"
"""Sign that a text was cut."""


def captioned(rgb: Picture, text: str, corner: Corner = "bottom left") -> Picture:
    """The picture (h, w, 3) with a line of text in a corner; too long a line is cut."""
    return Caption.of(text, rgb.shape[:2], corner).on(rgb)


def slowed(frames: Iterable[Picture], slow: Fraction) -> Iterator[Picture]:
    """Frames of a film in slow motion, each with the speed it is shown at; unchanged at the true speed."""
    caption: Caption | None = None
    for frame in frames:
        if slow != 1:
            caption = caption or Caption.of(speed_words(slow), frame.shape[:2], "top left")
            frame = caption.on(frame)
        yield frame


def speed_words(slow: Fraction) -> str:
    """The speed of a film that is ``slow`` times slower than life, as "1/4 speed"."""
    speed = 1 / slow
    return f"{speed} speed" if speed.numerator == 1 and speed != 1 else f"{float(speed):g}x speed"


@dataclass(frozen=True, eq=False)
class Caption:
    """A line of text, drawn for pictures of one size."""

    top: int
    left: int
    light: NDArray[np.uint16]
    """(h, w, 3): what is added to the picture, in 1/255."""
    kept: NDArray[np.uint16]
    """(h, w, 1): how much of the picture stays, in 1/255."""

    @classmethod
    def of(cls, text: str, size: tuple[int, int], corner: Corner) -> Caption:
        """A line for pictures of ``size`` (height, width) [px]; too long a line is cut."""
        height, width = size
        letters = font(max(SMALLEST, round(min(height, width) * HEIGHT_SHARE)))
        pad = max(3, round(letters.size / 3))
        line = shortened(plain(text), lambda t: letters.getlength(t) <= width - 4 * pad)
        up, down = letters.getmetrics()
        plate = Image.new("L", (min(width, round(letters.getlength(line)) + 2 * pad), min(height, up + down + pad)), 0)
        draw: Any = ImageDraw.Draw(plate)
        draw.rounded_rectangle((0, 0, plate.width - 1, plate.height - 1), radius=pad, fill=255)
        text_only = Image.new("L", plate.size, 0)
        ImageDraw.Draw(text_only).text((pad, pad // 2), line, fill=255, font=letters)
        ink, dark = (np.asarray(image, np.float32)[..., None] / 255 for image in (text_only, plate))
        top = pad if "top" in corner else height - plate.height - pad
        left = pad if "left" in corner else width - plate.width - pad
        light = np.broadcast_to(np.rint(255 * ink), (*ink.shape[:2], 3)).astype(np.uint16)
        kept = np.rint(255 * (1 - ink) * (1 - PLATE * dark)).astype(np.uint16)
        return cls(max(0, top), max(0, left), light, kept)

    def on(self, rgb: Picture) -> Picture:
        """A copy of a picture (h, w, 3) with the line on it."""
        out = rgb.copy()
        area = out[self.top : self.top + len(self.light), self.left : self.left + self.light.shape[1]]
        high, wide = area.shape[:2]  # less than the plate on pictures that are hardly any
        # Integers: 127 rounds, and the same bytes come out on every machine.
        area[:] = self.light[:high, :wide] + (area * self.kept[:high, :wide] + 127) // 255
        return out


@cache
def font(size: int) -> ImageFont.FreeTypeFont:
    """PIL's own font, in every installation."""
    letters = ImageFont.load_default(size)
    assert isinstance(letters, ImageFont.FreeTypeFont)
    return letters


def plain(text: str) -> str:
    """What the font can draw: its box for what it cannot."""
    return printable(" ".join(text.split()))


def shortened(text: str, fits: Callable[[str], bool]) -> str:
    """The longest start that fits, with a sign that there was more."""
    if fits(text):
        return text
    low, high = 0, min(len(text), 500)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if fits(text[:middle].rstrip() + CUT) else (low, middle - 1)
    return text[:low].rstrip() + CUT


def wrapped(text: str, letters: ImageFont.FreeTypeFont, width: int, lines: int) -> list[str]:
    """The text wrapped to at most so many lines of at most so many pixels. Long words and the last line are cut."""
    found: list[str] = []
    words = plain(text).split(" ")
    while words and len(found) < lines:
        count = 1
        while count < len(words) and letters.getlength(" ".join(words[: count + 1])) <= width:
            count += 1
        rest = len(found) + 1 == lines and count < len(words)
        line = " ".join(words if rest else words[:count])
        found.append(shortened(line, lambda t: letters.getlength(t) <= width))
        words = words[count:]
    return found
