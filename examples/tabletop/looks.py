"""How the example's objects look: colour and reflectance as functions of the point on the surface.

A ``Look`` maps points (n, 3) of the object's frame to (n, 4): linear red, green, blue and the mirror
reflectance at normal incidence. Labels are drawn with PIL's own font; wood and speckle come from seeded
value noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFilter, ImageFont
from scipy.ndimage import map_coordinates

from f3sr.core.transforms import Array

Look = Callable[[Array], Array]

DULL, SATIN, GLAZED, STEEL = 0.0, 0.025, 0.05, 0.55
"""Mirror reflectances at normal incidence."""


def to_linear(srgb: ArrayLike) -> Array:
    c = np.asarray(srgb, float)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: ArrayLike) -> Array:
    c = np.clip(np.asarray(linear, float), 0, 1)
    return np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055)


def color(code: str) -> Array:
    """Linear colour (3,) of a hex code."""
    return to_linear([int(code[i : i + 2], 16) / 255 for i in (1, 3, 5)])


_LATTICE = np.random.default_rng(7).random((64, 64, 64)).astype(np.float32)


def noise(points: Array, size: ArrayLike) -> Array:
    """Smooth value noise (n,) in [0, 1] whose grains measure ``size`` [m], one number or one per axis."""
    where = points / np.asarray(size, float) + 1000.5
    return map_coordinates(_LATTICE, where.T, order=1, mode="grid-wrap")


def mix(a: Array, b: Array, weight: Array) -> Array:
    """Blend colours, weight (n,) of ``b``."""
    return a + (b - a) * weight[:, None]


def step(x: Array, edge: float, width: float) -> Array:
    """0 below the edge and 1 above, over ``width``."""
    return np.clip((x - edge) / width + 0.5, 0, 1)


def finish(rgb: Array, reflectance: ArrayLike) -> Array:
    n = max(len(rgb), np.size(reflectance))
    return np.column_stack([np.broadcast_to(rgb, (n, 3)), np.broadcast_to(reflectance, (n,))])


def lookup(image: Array, u: Array, v: Array) -> Array:
    """Bilinear colours (n, 3) of a linear image (h, w, 3); u runs right, v runs up, both in [0, 1]."""
    h, w = image.shape[:2]
    x, y = np.clip(u * w - 0.5, 0, w - 1.001), np.clip((1 - v) * h - 0.5, 0, h - 1.001)
    i, j = x.astype(int), y.astype(int)
    a, b = (x - i)[:, None], (y - j)[:, None]
    return (image[j, i] * (1 - a) + image[j, i + 1] * a) * (1 - b) + (
        image[j + 1, i] * (1 - a) + image[j + 1, i + 1] * a
    ) * b


class Sheet:
    """A printed sheet: a PIL drawing with a few helpers in units of the sheet's height."""

    def __init__(self, aspect: float, paper: str, *, height: int = 512) -> None:
        self.h, self.w = height, round(height * aspect)
        self.image = Image.new("RGB", (self.w, self.h), paper)
        self.draw = ImageDraw.Draw(self.image)

    def text(self, at: tuple[float, float], words: str, size: float, ink: str, *, bold: float = 0.0) -> Sheet:
        """Centred text; ``at`` as fractions of width and height."""
        font = ImageFont.load_default(size * self.h)
        place = (at[0] * self.w, at[1] * self.h)
        self.draw.text(place, words, ink, font, anchor="mm", stroke_width=round(bold * self.h))
        return self

    def rect(self, a: tuple[float, float], b: tuple[float, float], ink: str) -> Sheet:
        self.draw.rectangle([a[0] * self.w, a[1] * self.h, b[0] * self.w, b[1] * self.h], ink)
        return self

    def disc(self, at: tuple[float, float], radius: float, ink: str) -> Sheet:
        self.draw.circle((at[0] * self.w, at[1] * self.h), radius * self.h, ink)
        return self

    def bars(self, a: tuple[float, float], b: tuple[float, float], seed: int) -> Sheet:
        """A bar code."""
        self.rect(a, b, "#f6f4ee")
        edges = np.sort(np.random.default_rng(seed).uniform(a[0] + 0.01, b[0] - 0.01, 40))
        for left, right in zip(edges[::2], edges[1::2], strict=True):
            self.rect((left, a[1] + 0.03), (right, b[1] - 0.03), "#1b1b1b")
        return self

    def linear(self) -> Array:
        soft = self.image.filter(ImageFilter.GaussianBlur(self.h / 900))
        return to_linear(np.asarray(soft, float) / 255)


def around(points: Array) -> Array:
    """Angle about z as a fraction of a turn in [0, 1); 0.5 at +x."""
    return (np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5) % 1.0


def six_faces(size: Sequence[float], faces: Sequence[Array], reflectance: float) -> Look:
    """A box on z = 0 with images for +x, -x, +y, -y, +z, -z, each seen from outside."""
    half = np.asarray(size) / 2

    def look(points: Array) -> Array:
        p = (points - [0, 0, half[2]]) / half
        axis = np.abs(p).argmax(1)
        face = 2 * axis + (p[np.arange(len(p)), axis] < 0)
        x, y, z = p.T
        right = np.choose(face, [y, -y, -x, x, x, x])
        up = np.choose(face, [z, z, z, z, y, -y])
        rgb = np.empty((len(p), 3))
        for k in np.unique(face):
            on = face == k
            rgb[on] = lookup(faces[k], right[on] / 2 + 0.5, up[on] / 2 + 0.5)
        return finish(rgb, reflectance)

    return look


def wood(light: str, dark: str, *, along: int, ring: float, reflectance: float = DULL) -> Look:
    """Grain along one axis (0, 1 or 2): rings of ``ring`` [m], streaks and pores."""
    stretch = np.full(3, 1.0)
    stretch[along] = 12.0

    def look(points: Array) -> Array:
        bend = noise(points, 4 * ring * stretch)
        across = np.delete(points, along, axis=1)
        rings = (np.hypot(across[:, 0] + 3.1 * ring, across[:, 1] - 7.3 * ring) / ring + 2.5 * bend) % 1.0
        streak = noise(points, 0.25 * ring * stretch)
        pores = step(noise(points, 0.09 * ring * stretch), 0.8, 0.2)
        weight = 0.55 * rings**2 + 0.3 * streak + 0.25 * pores
        return finish(mix(color(light), color(dark), np.clip(weight, 0, 1)), reflectance)

    return look


def biscuit_box(size: tuple[float, float, float]) -> Look:
    x, y, z = size
    top = Sheet(x / y, "#f2c230", height=900)
    top.rect((0, 0), (1, 0.16), "#1f4e79").rect((0, 0.16), (1, 0.185), "#ffffff").rect((0, 0.84), (1, 1), "#1f4e79")
    top.text((0.5, 0.08), "OLD  MILL  BAKERY", 0.085, "#ffffff").text((0.36, 0.37), "Oat", 0.26, "#1f4e79", bold=0.012)
    top.text((0.42, 0.63), "Biscuits", 0.2, "#1f4e79", bold=0.008)
    for at in ((0.74, 0.34), (0.88, 0.52), (0.77, 0.67)):
        top.disc(at, 0.135, "#8a5a25").disc(at, 0.125, "#c98d46")
        for k in range(9):
            top.disc(
                (at[0] + 0.055 * np.cos(2.4 * k) * k / 9, at[1] + 0.085 * np.sin(2.4 * k) * k / 9),
                0.011,
                "#8a5a25",
            )
    top.text((0.5, 0.92), "with honey    250 g", 0.075, "#f2c230")
    long = Sheet(x / z, "#1f4e79", height=400)
    long.rect((0, 0), (1, 0.09), "#f2c230").rect((0, 0.91), (1, 1), "#f2c230")
    long.text((0.36, 0.5), "Oat Biscuits", 0.44, "#f2c230", bold=0.012).bars((0.76, 0.22), (0.94, 0.8), 1)
    short = Sheet(y / z, "#f2c230", height=400).rect((0.06, 0.12), (0.94, 0.88), "#f7efd9")
    for k in range(6):
        short.rect((0.12, 0.24 + 0.1 * k), (0.55 + 0.28 * ((k * 7) % 3) / 2, 0.275 + 0.1 * k), "#6b6b6b")
    pages = [s.linear() for s in (short, short, long, long, top, top)]
    return six_faces(size, pages, SATIN)


def letter_block(side: float) -> Look:
    inks = ["#c0392b", "#2471a3", "#239b56", "#c0392b", "#2471a3", "#239b56"]
    faces: list[Array] = []
    for letter, ink in zip("R3AFS7", inks, strict=True):
        sheet = Sheet(1, "#000000").rect((0.09, 0.09), (0.91, 0.91), ink).rect((0.13, 0.13), (0.87, 0.87), "#000000")
        sheet.text((0.5, 0.5), letter, 0.66, ink, bold=0.012)
        faces.append(to_linear(np.asarray(sheet.image, float) / 255))
    grain, paint = wood("#ecd0a0", "#c79a5c", along=0, ring=0.011), six_faces([side] * 3, faces, DULL)

    def look(points: Array) -> Array:
        ink, bare = paint(points), grain(points)
        covered = ink[:, :3].max(1) > 0.02
        return np.where(covered[:, None], ink * [1, 1, 1, 0] + [0, 0, 0, SATIN], bare)

    return look


def tomato_tin(radius: float, height: float) -> Look:
    label = Sheet(2 * np.pi * radius / height, "#b3211c", height=700)
    label.rect((0, 0.0), (1, 0.05), "#e8c15a").rect((0, 0.95), (1, 1), "#e8c15a").rect((0, 0.6), (1, 0.82), "#f7f0dd")
    for k in range(2):
        x = 0.25 + 0.5 * k
        label.text((x, 0.18), "San Pietro", 0.12, "#f3dc9a").text((x, 0.71), "chopped  400 g", 0.105, "#3c6e2f")
        label.text((x, 0.42), "TOMATOES", 0.2, "#ffffff", bold=0.012)
        label.disc((x + 0.25, 0.42), 0.23, "#f7f0dd").disc((x + 0.25, 0.43), 0.19, "#d8321f")
        label.disc((x + 0.232, 0.37), 0.045, "#f07a5c").rect((x + 0.235, 0.215), (x + 0.265, 0.25), "#3c6e2f")
    label.bars((0.0, 0.62), (0.06, 0.8), 5)
    paper = label.linear()

    def look(points: Array) -> Array:
        r, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
        printed = (r > 0.93 * radius) & (z > 0.045 * height) & (z < 0.955 * height)
        rgb = lookup(paper, around(points), np.clip((z / height - 0.045) / 0.91, 0, 1))
        steel = color("#b9bab8") * (0.85 + 0.2 * noise(points, 0.0011))[:, None]
        return finish(np.where(printed[:, None], rgb, steel), np.where(printed, SATIN, STEEL))

    return look


def striped_bowl(height: float) -> Look:
    def look(points: Array) -> Array:
        r, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2] / height
        glaze = mix(color("#1d5a73"), color("#2c7f95"), noise(points, 0.006))
        cream = mix(color("#efe6d2"), color("#e2d5ba"), noise(points, 0.004))
        inside = r < 0.0001 + np.interp(
            z, [0.1, 0.15, 0.21, 0.45, 0.74, 1.0], [0.033, 0.042, 0.051, 0.068, 0.078, 0.0825]
        )
        band = step(z, 0.62, 0.012) - step(z, 0.70, 0.012) + step(z, 0.76, 0.012) - step(z, 0.79, 0.012)
        rgb = mix(glaze, cream, np.clip(band, 0, 1))
        rgb = np.where((inside & (z > 0.1))[:, None], cream, rgb)
        rgb = mix(rgb, np.broadcast_to(color("#6d4a2c"), rgb.shape), 0.85 * step(z, 0.975, 0.02))
        return finish(np.where((z < 0.035)[:, None], color("#c9a783"), rgb), GLAZED)

    return look


def dotted_mug(radius: float, height: float) -> Look:
    def look(points: Array) -> Array:
        r, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
        white = mix(color("#f3efe6"), color("#e9e3d6"), noise(points, 0.005))
        row = np.floor(z / 0.0165)
        u = (around(points) * 15 + 0.5 * (row % 2)) % 1.0 - 0.5
        away = np.hypot(u * 2 * np.pi * radius / 15, z - (row + 0.5) * 0.0165)
        outside = (r > radius - 0.0015) & (r < radius + 0.0012) & (row > 0) & (z < height - 0.012)
        spot = (1 - step(away, 0.0042, 0.0006)) * outside
        spots = np.array([color(c) for c in ("#d1495b", "#30638e", "#edae49")])[(row % 3).astype(int)]
        rim = step(z, height - 0.004, 0.0008)
        ear = step(r, radius + 0.0012, 0.001)
        rgb = mix(mix(white, spots, spot), np.broadcast_to(color("#30638e"), white.shape), np.maximum(rim, ear))
        return finish(rgb, GLAZED)

    return look


def oil_bottle(radius: float, height: float) -> Look:
    label = Sheet(2.0, "#f4ecd6", height=600).rect((0, 0), (1, 0.05), "#7a8f3c").rect((0, 0.95), (1, 1), "#7a8f3c")
    label.text((0.5, 0.3), "OLIO", 0.27, "#3f4d1c", bold=0.012).text((0.5, 0.57), "d'oliva", 0.19, "#7a8f3c")
    label.text((0.5, 0.82), "750 ml", 0.11, "#3f4d1c")
    for k in range(5):
        label.disc((0.2 + 0.15 * k, 0.7), 0.025, "#3f4d1c")
    paper = label.linear()

    def look(points: Array) -> Array:
        z, u = points[:, 2] / height, around(points)
        glass = mix(color("#24381a"), color("#33491f"), step(z, 0.35, 0.5))
        on = (z > 0.17) & (z < 0.5) & (u > 0.25) & (u < 0.75)
        rgb = lookup(paper, (u - 0.25) * 2, (z - 0.17) / 0.33)
        cap = z > 0.862
        ribs = 0.8 + 0.3 * (np.sin(u * 2 * np.pi * 40) > 0)
        rgb = np.where(on[:, None], rgb, glass)
        rgb = np.where(cap[:, None], color("#8c6d2f") * ribs[:, None], rgb)
        return finish(rgb, np.where(on, SATIN, np.where(cap, 0.12, 0.07)))

    return look


def citrus_skin(skin: str, shade: str, half_length: float, tip: str) -> Look:
    """Pores on a warm skin, another colour at the stem (+x)."""

    def look(points: Array) -> Array:
        rgb = mix(
            color(skin),
            color(shade),
            0.55 * noise(points, 0.014) + 0.35 * step(noise(points, 0.0013), 0.62, 0.3),
        )
        stem = 1 - step(half_length - points[:, 0], 0.0002, 0.0002)
        return finish(mix(rgb, np.broadcast_to(color(tip), rgb.shape), stem), 0.035)

    return look


def cloth_book(size: tuple[float, float, float], *, title: str, board: float = 0.002) -> Look:
    x, y, z = size
    cover = (
        Sheet(y / x, "#7d2e46", height=800)
        .rect((0.06, 0.05), (0.94, 0.95), "#d9b56a")
        .rect((0.068, 0.06), (0.932, 0.94), "#7d2e46")
    )
    cover.text((0.5, 0.77), title, 0.115, "#e6c67c", bold=0.003).text((0.5, 0.88), "a short course", 0.05, "#e6c67c")
    for k in range(6):
        cover.disc((0.5, 0.42), 0.21 - 0.036 * k, "#e6c67c" if k % 2 == 0 else "#7d2e46")
    print_ = cover.linear()

    def look(points: Array) -> Array:
        px, py, pz = points.T
        rgb = lookup(print_, np.clip(0.5 + py / y, 0, 1), np.clip(0.5 - px / x, 0, 1))
        cloth = color("#7d2e46")
        rgb = np.where((pz > z - 0.0004)[:, None], rgb, cloth)
        rgb = rgb * (0.88 + 0.24 * noise(points, 0.0009))[:, None]
        sheets = color("#e9dfc6") * (0.72 + 0.3 * noise(points, [1.0, 1.0, 0.00035]))[:, None]
        inner = (pz > board * 0.98) & (pz < z - board * 0.98) & (px > -x / 2 + board)
        return finish(np.where(inner[:, None], sheets, rgb), DULL)

    return look


def table_top() -> Look:
    """Oak boards along x, 140 mm wide."""
    board = 0.14

    def look(points: Array) -> Array:
        row = np.floor(points[:, 1] / board)
        p = points + np.stack([row * 5.37, row * 0.911, row * 2.3], -1)
        bend = noise(p, [0.6, 0.05, 1.0])
        rings = (p[:, 1] / 0.017 + 3.0 * bend + 0.8 * noise(p, [0.2, 0.02, 1.0])) % 1.0
        streak, pores = noise(p, [0.08, 0.0022, 1.0]), step(noise(p, [0.03, 0.0008, 1.0]), 0.72, 0.3)
        tone = 0.22 * ((row * 0.618) % 1.0)
        weight = np.clip(0.34 * rings**1.6 + 0.3 * streak + 0.2 * pores + tone, 0, 1)
        rgb = mix(color("#cfa77a"), color("#8a5f3a"), weight)
        seam = np.abs(points[:, 1] / board - np.round(points[:, 1] / board)) * board
        return finish(rgb * (0.35 + 0.65 * step(seam, 0.0009, 0.0008))[:, None], DULL)

    return look


def plain_wall() -> Look:
    """A plastered wall: a soft gradient and a painted lower part."""

    def look(points: Array) -> Array:
        tone = mix(color("#9fb0b4"), color("#c8cfcc"), np.clip(0.5 + 0.35 * points[:, 0] + 0.5 * points[:, 2], 0, 1))
        rgb = tone * (0.95 + 0.1 * noise(points, 0.12))[:, None]
        return finish(rgb, DULL)

    return look
