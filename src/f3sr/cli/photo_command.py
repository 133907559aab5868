"""The command from a photo to a scene and its report."""

from __future__ import annotations

import sys
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from f3sr.cli.arguments import (
    DeviceName,
    Known,
    MaybeFile,
    MaybeMetres,
    MaybeMillimetres,
    MaybeOut,
    MaybePixels,
    Name,
    NormalAxes,
    PrecisionName,
)
from f3sr.cli.reconstruction_run import make_package
from f3sr.cli.segment_command import Boxes, MaybeWords
from f3sr.cli.segment_command import segment as segment_photo
from f3sr.errors import F3srError, InputError

if TYPE_CHECKING:
    from f3sr.backends.model_choice import ModelChoice

PhotoOrFolder = Annotated[Positional[Path], arg(metavar="PHOTO")]
AFTER = "The scene is being made now; the terminal shows the steps. Its report opens when it is ready."
SCENE, INPUT = "_scene", "_input"
"""Ends of the names of the folders beside a photo: the package, and the masks it is made from."""


def photo(
    photo: PhotoOrFolder,
    /,
    out: MaybeOut = None,
    box: Boxes = (),
    segment: MaybeWords = None,
    segmenter: Name = None,
    ground_segmenter: Name = None,
    geometry: Name = None,
    normals: Name = None,
    normals_axes: NormalAxes = "",
    assets: Name = None,
    background: Name = None,
    focal: MaybePixels = None,
    focal_35mm: MaybeMillimetres = None,
    camera_height: MaybeMetres = None,
    known: Known = "",
    device: DeviceName = "auto",
    precision: PrecisionName = "auto",
    allow_downloads: bool = False,
    config: MaybeFile = None,
    edits: MaybeFile = None,
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
        segment: A detector and what it shall find, as sam3 "red mug, plate", instead of the page. Every instance is an
            object. A detector of boxes only needs a segmenter, as grounding-dino+sam2; without it: grabcut.
        segmenter: Back end that cuts objects out; ``f3sr doctor`` lists its names. Without it: grabcut.
        ground_segmenter: Back end that outlines what the objects stand on. Without it, colours around them tell.
        geometry: Back end that estimates geometry; ``f3sr doctor`` lists its names.
        normals: Back end that estimates surface normals, as omnidata:FILE: they tell the tilt of the camera.
        normals_axes: Their axes, where the photo does not tell them: right or left, down or up, forwards or backwards,
            as rdf.
        assets: Back end that generates meshes; ``f3sr doctor`` lists its names.
        background: Back end that completes the photo behind the objects; ``f3sr doctor`` lists its names.
        focal: Focal length [px] of the upright photo. Without it: what EXIF and the picture tell.
        focal_35mm: The same in 35 mm equivalent [mm], by the photo's diagonal.
        camera_height: Height of the camera above what the objects stand on [m].
        known: Known lengths [m] of objects by id or label, as "mug=0.12,3=0.3": the longest side of the tightest box
            around the object.
        device: Where models of back ends run; auto is the first of cuda, mps and cpu that is there.
        precision: Their numbers; auto is float32 on a CPU, what a model usually runs in elsewhere.
        allow_downloads: Fetch weights of such models from the hub where they are not on this machine.
        config: TOML file of settings; those it does not name stay as ``f3sr config`` prints them.
        edits: edits.json, as an edited package holds it: what was changed by hand is changed again.
        overwrite: Also replace a package that holds rollouts.
        open: Open page and report in a browser.
        json: Print one JSON object instead of text.
    """
    from f3sr.backends.model_choice import ModelChoice
    from f3sr.cli import console
    from f3sr.cli.run_request import requested
    from f3sr.scene_package.package import PAGE
    from f3sr.scene_package.package_folder import prepare_output
    from f3sr.segmentation.input_folder_writer import read_photo
    from f3sr.web.browser import shown_in_browser

    given = photo.is_dir()
    package = out or _beside(photo, SCENE)
    folder = photo if given else _beside(package, INPUT)
    drawing = {"--segment": segment, "--ground-segmenter": ground_segmenter, "--box": box, "--segmenter": segmenter}
    if given and (option := next((name for name, value in drawing.items() if value), None)):
        raise InputError(option, found=f"the folder {photo.name}, which has masks", accepted="a photo")
    choice = ModelChoice(device=device, precision=precision, allow_downloads=allow_downloads, axes=normals_axes)
    request = requested(
        choice=choice,
        geometry=geometry,
        normals=normals,
        assets=assets,
        background=background,
        focal=focal,
        focal_35mm=focal_35mm,
        camera_height=camera_height,
        known=known,
        config=config,
        edits=edits,
    )
    package = prepare_output(package, inputs=folder, overwrite=overwrite, edits=edits is not None)
    if not given:
        request.require_ready()
        request.hints.known_focal(read_photo(photo))
        _outlined(photo, folder, box, segment, segmenter, ground_segmenter, choice, open=open, json=json)
    make_package(folder, package, request, overwrite=overwrite, json=json)
    if open and not shown_in_browser((package / PAGE).as_uri()) and not json:
        console.say("no browser was found; open the report yourself")


def _beside(place: Path, ending: str) -> Path:
    """A folder beside a photo or a folder, named after it."""
    whole = Path(place).absolute()
    name = whole.name if whole.is_dir() or ending == INPUT else whole.stem
    return whole.with_name(name.removesuffix(INPUT).removesuffix(SCENE) + ending)


def _outlined(
    photo: Path,
    folder: Path,
    boxes: tuple[str, ...],
    words: tuple[str, str] | None,
    segmenter: str | None,
    ground_segmenter: str | None,
    choice: ModelChoice,
    *,
    open: bool,
    json: bool,
) -> None:
    """Write the prompted-image folder of a photo, from boxes or words that are given or by hand in the page."""
    from f3sr import mask_page
    from f3sr.cli import console
    from f3sr.segmentation.segmenters import DEFAULT_SEGMENTER, SEGMENTERS

    if boxes or words or ground_segmenter:
        with redirect_stdout(sys.stderr) if json else nullcontext():
            return segment_photo(
                photo,
                folder,
                box=boxes,
                segment=words,
                segmenter=segmenter,
                ground_segmenter=ground_segmenter,
                device=choice.device,
                precision=choice.precision,
                allow_downloads=choice.allow_downloads,
            )
    backend = SEGMENTERS.find(segmenter or DEFAULT_SEGMENTER, choice)
    tell = console.say_aside if json else console.say
    if mask_page.serve(photo, folder, backend, open_browser=open, after=AFTER, tell=tell) is None:
        raise F3srError(mask_page.NOTHING_SAVED)
