"""The command from a photo to a scene and its report."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from f3sr.backends.protocols import Prompt
from f3sr.cli.arguments import MaybeFile, MaybeOut, Name, default_shown
from f3sr.cli.reconstruct_command import reconstruct
from f3sr.errors import F3srError, InputError

PhotoOrFolder = Annotated[Positional[Path], arg(metavar="PHOTO")]
Boxes = Annotated[tuple[str, ...], arg(metavar="[BOX ...]", help_behavior_hint=default_shown)]
BOX = "NAME=left,top,right,bottom or left,top,right,bottom in pixels"
FARTHEST = 1e6
"""Largest coordinate of a box [px]: no photo is as wide."""
AFTER = "The scene is being made now; the terminal shows the steps. Its report opens when it is ready."
SCENE, INPUT = "_scene", "_input"
"""Ends of the names of the folders beside a photo: the package, and the masks it is made from."""


def photo(
    photo: PhotoOrFolder,
    /,
    out: MaybeOut = None,
    box: Boxes = (),
    segmentation: Name = None,
    geometry: Name = None,
    assets: Name = None,
    background: Name = None,
    config: MaybeFile = None,
    overwrite: bool = False,
    open: bool = True,
    json: bool = False,
) -> None:
    """Outline the objects of a photo in a page, reconstruct them, and open the report.

    Args:
        photo: A PNG or JPEG file, or a prompted-image folder, which needs no page.
        out: Where the package goes. Without it, PHOTO_scene beside the photo. The masks go to PHOTO_input beside the
            package. A second run begins with what was drawn.
        box: Boxes of objects instead of the page, as "red mug=40,50,100,120": left, top, right, bottom in pixels.
        segmentation: Back end that makes masks; ``f3sr doctor`` lists its names.
        geometry: Back end that estimates geometry; ``f3sr doctor`` lists its names.
        assets: Back end that generates meshes; ``f3sr doctor`` lists its names.
        background: Back end that completes the photo behind the objects; ``f3sr doctor`` lists its names.
        config: TOML file of settings; those it does not name stay as ``f3sr config`` prints them.
        overwrite: Also replace a package that holds rollouts.
        open: Open page and report in a browser.
        json: Print one JSON object instead of text.
    """
    from f3sr.cli import console
    from f3sr.scene_package.package import PAGE
    from f3sr.scene_package.package_folder import prepare_output
    from f3sr.web.browser import shown_in_browser

    given = photo.is_dir()
    package = out or _beside(photo, SCENE)
    folder = photo if given else _beside(package, INPUT)
    package = prepare_output(package, inputs=folder, overwrite=overwrite)
    if not given:
        _outlined(photo, folder, box, segmentation, open=open, json=json)
    reconstruct(
        folder,
        out=package,
        geometry=geometry,
        assets=assets,
        background=background,
        config=config,
        overwrite=overwrite,
        json=json,
    )
    if open and not shown_in_browser((package / PAGE).as_uri()) and not json:
        console.say("no browser was found; open the report yourself")


def _beside(place: Path, ending: str) -> Path:
    """A folder beside a photo or a folder, named after it."""
    whole = Path(place).absolute()
    name = whole.name if whole.is_dir() or ending == INPUT else whole.stem
    return whole.with_name(name.removesuffix(INPUT).removesuffix(SCENE) + ending)


def _outlined(
    photo: Path, folder: Path, boxes: tuple[str, ...], segmentation: str | None, *, open: bool, json: bool
) -> None:
    """Write the prompted-image folder of a photo, from boxes that are given or by hand in the page."""
    from f3sr import mask_page
    from f3sr.cli import console
    from f3sr.mask_page.interim import DEFAULT_SEGMENTER, SEGMENTERS

    segmenter = SEGMENTERS.find(segmentation or DEFAULT_SEGMENTER)
    if boxes:
        mask_page.outline_boxes(photo, folder, segmenter, [box_of(text) for text in boxes])
        return
    tell = _to_stderr if json else console.say
    if mask_page.serve(photo, folder, segmenter, open_browser=open, after=AFTER, tell=tell) is None:
        raise F3srError("nothing was saved in the page; nothing was written")


def box_of(text: str) -> Prompt:
    """The prompt of a box as an option gives it. Raises InputError."""
    label, _, numbers = text.rpartition("=")
    try:
        left, top, right, bottom = (float(number) for number in numbers.split(","))
    except ValueError:
        raise InputError("--box", found=text, accepted=BOX) from None
    if not (0 <= left < right <= FARTHEST and 0 <= top < bottom <= FARTHEST):  # NaN is not
        raise InputError("--box", found=text, accepted=f"{BOX}, left < right, top < bottom")
    return Prompt(label=label.strip(), box=(left, top, right, bottom))


def _to_stderr(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
