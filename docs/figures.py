"""Makes the two figures of the README from a package: photo, input and result, in the photo's view and from the side.

    f3sr demo -o OUT
    python docs/figures.py OUT

The input is direct composition: the generated meshes in their given poses, levelled. Renders are unlit, over the photo
completed behind its objects, so that nothing of the photo hides an error. Only the bundled example may be published.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import PIL.Image
from PIL import ImageDraw, ImageFont

from f3sr.scene import Scene
from f3sr.scene_package.package import Package, read_package
from f3sr.vision.pictures import Backdrop, Image, composite, resized, side_cameras, side_view

PICTURES = Path(__file__).parent / "pictures"
WIDTH, GAP, CAPTION = 1500, 10, 34
"""Of a figure, between its panels, and of the line above each panel [px]."""
QUALITY = 82
"""Of the JPEG files, some 100 kB each."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path)
    package = read_package(parser.parse_args().package)
    save(photo_view(package), "photo_view")
    save(from_the_side(package), "side_view")


def photo_view(package: Package) -> Image:
    photo = Backdrop.of(package.scene)
    background = PIL.Image.open(package.folder / "background.png").convert("RGB")
    empty = Backdrop(rgb=resized(np.asarray(background), *photo.rgb.shape[1::-1]), wanted=photo.wanted)
    before, after = (composite(scene, empty) for scene in both(package))
    return row({"photo": photo.rgb, "input": before, "result": after})


def from_the_side(package: Package) -> Image:
    before, after = both(package)
    cameras = side_cameras(before, after, 960, 400)
    views = [side_view(scene, camera) for scene, camera in zip((before, after), cameras, strict=True)]
    return row({"input, from the side": views[0], "result, from the side": views[1]})


def both(package: Package) -> tuple[Scene, Scene]:
    """Direct composition and the result."""
    assert package.direct is not None, "a package of f3sr reconstruct"
    return package.direct, package.scene


def row(panels: dict[str, Image]) -> Image:
    """Panels of one size next to each other, each below its name."""
    each = (WIDTH - GAP * (len(panels) - 1)) // len(panels)
    first = next(iter(panels.values()))
    height = round(each * first.shape[0] / first.shape[1])
    canvas = PIL.Image.new("RGB", (WIDTH, height + CAPTION), "white")
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(22)
    for k, (name, picture) in enumerate(panels.items()):
        draw.text((k * (each + GAP), 2), name, fill="black", font=font)
        canvas.paste(PIL.Image.fromarray(resized(picture, each, height)), (k * (each + GAP), CAPTION))
    return np.asarray(canvas)


def save(picture: Image, name: str) -> None:
    PIL.Image.fromarray(picture).save(PICTURES / f"{name}.jpg", quality=QUALITY, optimize=True)


if __name__ == "__main__":
    main()
