"""The command from a photo to a scene and its report."""

from __future__ import annotations

import sys
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from f3sr.cli.arguments import Known, MaybeFile, MaybeMetres, MaybeMillimetres, MaybeOut, MaybePixels, Name
from f3sr.cli.reconstruct_command import reconstruct
from f3sr.cli.segment_command import Boxes, segment
from f3sr.errors import F3srError

PhotoOrFolder = Annotated[Positional[Path], arg(metavar="PHOTO")]
AFTER = "The scene is being made now; the terminal shows the steps. Its report opens when it is ready."
SCENE, INPUT = "_scene", "_input"
"""Ends of the names of the folders beside a photo: the package, and the masks it is made from."""


def photo(
    photo: PhotoOrFolder,
    /,
    out: MaybeOut = None,
    box: Boxes = (),
    segmenter: Name = None,
    geometry: Name = None,
    assets: Name = None,
    background: Name = None,
    focal: MaybePixels = None,
    focal_35mm: MaybeMillimetres = None,
    camera_height: MaybeMetres = None,
    known: Known = "",
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
        box: A box around what is seen of an object, and its label, instead of the page. Repeatable.
        segmenter: Back end that cuts objects out; ``f3sr doctor`` lists its names. Without it: grabcut.
        geometry: Back end that estimates geometry; ``f3sr doctor`` lists its names.
        assets: Back end that generates meshes; ``f3sr doctor`` lists its names.
        background: Back end that completes the photo behind the objects; ``f3sr doctor`` lists its names.
        focal: Focal length [px] of the upright photo. Without it: what EXIF and the picture tell.
        focal_35mm: The same in 35 mm equivalent [mm], by the photo's diagonal.
        camera_height: Height of the camera above what the objects stand on [m].
        known: Known lengths [m] of objects by id or label, as "mug=0.12,3=0.3": the longest side of the tightest box
            around the object.
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
        _outlined(photo, folder, box, segmenter, open=open, json=json)
    reconstruct(
        folder,
        out=package,
        geometry=geometry,
        assets=assets,
        background=background,
        focal=focal,
        focal_35mm=focal_35mm,
        camera_height=camera_height,
        known=known,
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
    photo: Path, folder: Path, boxes: tuple[str, ...], segmenter: str | None, *, open: bool, json: bool
) -> None:
    """Write the prompted-image folder of a photo, from boxes that are given or by hand in the page."""
    from f3sr import mask_page
    from f3sr.cli import console
    from f3sr.segmentation.segmenters import DEFAULT_SEGMENTER, SEGMENTERS

    if boxes:
        with redirect_stdout(sys.stderr) if json else nullcontext():
            return segment(photo, folder, box=boxes, segmenter=segmenter)
    backend = SEGMENTERS.find(segmenter or DEFAULT_SEGMENTER)
    tell = console.say_aside if json else console.say
    if mask_page.serve(photo, folder, backend, open_browser=open, after=AFTER, tell=tell) is None:
        raise F3srError(mask_page.NOTHING_SAVED)
