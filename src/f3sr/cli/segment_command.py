"""The command that makes a prompted-image folder of a photo: from boxes and strokes, from masks, or on a page."""

from __future__ import annotations

import json as json_
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from f3sr.cli.arguments import DeviceName, MaybeFile, Name, PrecisionName, default_shown
from f3sr.errors import F3srError, InputError

if TYPE_CHECKING:
    from f3sr.backends.model_choice import ModelChoice
    from f3sr.backends.protocols import Prompt, Stroke
    from f3sr.scene import Photo
    from f3sr.segmentation.input_folder_writer import OutlinedObject
    from f3sr.segmentation.named_objects import NamedObjects
    from f3sr.segmentation.selection import Selection

PhotoFile = Annotated[Positional[Path], arg(metavar="PHOTO")]
FolderOut = Annotated[Path, arg(aliases=["-o"], metavar="FOLDER")]
MaybeFolder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint=default_shown)]
Boxes = Annotated[
    UseAppendAction[tuple[str, ...]], arg(metavar="X0,Y0,X1,Y1[:LABEL]", help_behavior_hint=default_shown)
]
Strokes = Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="K:X,Y;X,Y...", help_behavior_hint=default_shown)]
GroundStrokes = Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="X,Y;X,Y...", help_behavior_hint=default_shown)]

MaybeWords = Annotated[
    tuple[str, str] | None, arg(metavar="DETECTOR[+SEGMENTER] WORDS", help_behavior_hint=default_shown)
]

BOX = "X0,Y0,X1,Y1 or X0,Y0,X1,Y1:LABEL in pixels"
STROKE = "X,Y or X,Y;X,Y and so on, in pixels"


def segment(
    photo: PhotoFile,
    /,
    out: FolderOut,
    box: Boxes = (),
    inside: Strokes = (),
    outside: Strokes = (),
    ground_stroke: GroundStrokes = (),
    prompts: MaybeFile = None,
    label_map: MaybeFile = None,
    cutouts: MaybeFolder = None,
    coco: MaybeFile = None,
    segment: MaybeWords = None,
    segmenter: Name = None,
    ground_segmenter: Name = None,
    device: DeviceName = "auto",
    precision: PrecisionName = "auto",
    allow_downloads: bool = False,
    json: bool = False,
) -> None:
    """Outline objects in a photo and write a prompted-image folder for ``f3sr reconstruct``.

    Args:
        photo: A PNG or JPEG. Without boxes, strokes, prompts or masks, a page to draw on opens in the browser.
        out: A new folder, or one that this command wrote.
        box: A box around what is seen of an object, and its label. Boxes count from 0; each is an object. Repeatable.
        inside: A stroke on object K, or a click. A K without a box is an object too. Repeatable.
        outside: A stroke on what is not object K. Repeatable.
        ground_stroke: A stroke on what the objects stand on. Without it, what is seen around them tells. Repeatable.
        prompts: prompts.json of an earlier run, to go on from; boxes count on from its objects.
        label_map: A PNG whose grey values or palette numbers are the objects; 0 is none.
        cutouts: A folder of photo-sized PNGs, each with one object that is not transparent.
        coco: A JSON file of COCO's format with run-length codes or polygons.
        segment: A detector and what it shall find, as sam3 "red mug, plate". Every instance is an object. A detector
            of boxes only needs a segmenter, as grounding-dino+sam2; without it: grabcut.
        segmenter: Back end that cuts objects out; ``f3sr doctor`` lists its names. Without it: grabcut.
        ground_segmenter: Back end that outlines what the objects stand on. Without it, colours around them tell.
        device: Where models of back ends run; auto is the first of cuda, mps and cpu that is there.
        precision: Their numbers; auto is float32 on a CPU, what a model usually runs in elsewhere.
        allow_downloads: Fetch weights of such models from the hub where they are not on this machine.
        json: Print one JSON object instead of text.
    """
    from f3sr.backends.model_choice import ModelChoice
    from f3sr.cli import console
    from f3sr.scene_package.package_folder import placed
    from f3sr.segmentation.input_folder_writer import (
        OutlinedObject,
        read_photo,
        require_writable,
        write_input_folder,
    )
    from f3sr.segmentation.named_objects import with_ground
    from f3sr.segmentation.segmenters import DEFAULT_SEGMENTER, GROUND_SEGMENTERS, SEGMENTERS
    from f3sr.segmentation.selection import outlined, told_apart

    drawn = bool(box or inside or outside or prompts)
    masks = {"--label-map": label_map, "--cutouts": cutouts, "--coco": coco}
    ways = {**masks, "--segment": segment, "boxes and strokes": drawn or None}
    if len(given := [name for name, value in ways.items() if value is not None]) > 1:
        raise InputError("segment", found=" and ".join(given), accepted="one way to tell the objects")
    if segmenter and (have := masks.keys() & set(given)):
        raise InputError("--segmenter", found=f"{have.pop()}, which has masks", accepted="boxes, strokes or a page")
    _require_use(segment, segmenter, ground_segmenter, ground_stroke, page=not given and not ground_stroke)
    choice = ModelChoice(device=device, precision=precision, allow_downloads=allow_downloads)
    backend = SEGMENTERS.find(segmenter or DEFAULT_SEGMENTER, choice)
    surface = GROUND_SEGMENTERS.find(ground_segmenter, choice) if ground_segmenter else None
    if not given and not ground_stroke:
        from f3sr import mask_page

        tell = console.say_aside if json else console.say
        if (saved := mask_page.serve(photo, out, backend, tell=tell)) is None:
            raise F3srError(mask_page.NOTHING_SAVED)
        print(json_.dumps({"folder": str(saved)}) if json else f"folder:   {saved}")
        return
    picture, folder = read_photo(photo), require_writable(placed(out))
    selection, told = _selection(prompts, box, inside, outside, ground_stroke), ()
    named = _named(picture, segment, selection, choice) if segment else None
    if named:
        selection, told = named.selection, named.told
    if named or drawn:
        outlines = named.outlines if named else outlined(picture, selection, backend)
        found = {k: OutlinedObject(label=p.label, mask=outlines.masks[k]) for k, p in enumerate(selection.prompts)}
    else:
        imported = _imported(picture, photo, label_map, cutouts, coco)
        outlines = told_apart(picture, [o.mask for o in imported.values()], selection)
        apart = zip(imported.items(), outlines.masks, strict=True)
        found = {id: OutlinedObject(label=o.label, mask=mask) for (id, o), mask in apart}
    if surface:
        outlines = with_ground(picture, outlines, surface)
        by = f"ground by {surface.told}"
        selection, told = replace(selection, made_by="; ".join(filter(None, (selection.made_by, by)))), (*told, by)
    written = write_input_folder(folder, photo=photo, objects=found, ground=outlines.ground, selection=selection)
    if json:
        pixels = {id: int(o.mask.sum()) for id, o in found.items()}
        console.print_json({"folder": str(written), "pixels": pixels} | ({"told": told} if told else {}))
        return
    for line in told:
        console.say(line)
    rows = [(str(id), o.label, f"{int(o.mask.sum()):,}") for id, o in found.items()]
    console.print_table([*rows, ("", "ground", f"{int(outlines.ground.sum()):,}")], header=("id", "label", "pixels"))
    console.say(f"folder:   {written}")


def _require_use(
    words: tuple[str, str] | None,
    segmenter: str | None,
    ground_segmenter: str | None,
    ground_stroke: tuple[str, ...],
    *,
    page: bool,
) -> None:
    """Raises InputError for options that exclude each other."""
    if words and segmenter:
        raise InputError("--segmenter", found="also --segment", accepted="--segment DETECTOR+SEGMENTER WORDS")
    if ground_segmenter and ground_stroke:
        raise InputError("--ground-segmenter", found="also --ground-stroke", accepted="one of the two")
    if ground_segmenter and page:
        raise InputError("--ground-segmenter", found="no object", accepted="boxes, strokes, masks or words beside it")


def _named(photo: Photo, words: tuple[str, str], given: Selection, choice: ModelChoice) -> NamedObjects:
    """The objects that words name; strokes on the ground stay."""
    from f3sr.segmentation.named_objects import back_ends_of, named_objects, phrases_of
    from f3sr.segmentation.segmenters import DEFAULT_SEGMENTER, DETECTORS, SEGMENTERS

    spec, text = words
    phrases = phrases_of(text)
    detector, segmenter = back_ends_of(spec, SEGMENTERS)
    return named_objects(
        photo,
        phrases,
        DETECTORS.find(detector, choice),
        SEGMENTERS.find(segmenter, choice) if segmenter else None,
        SEGMENTERS.find(DEFAULT_SEGMENTER),
        ground=given.ground,
    )


def _imported(
    picture: Photo, photo: Path, label_map: Path | None, cutouts: Path | None, coco: Path | None
) -> dict[int, OutlinedObject]:
    """The objects of masks that another program made."""
    from f3sr.segmentation.coco_masks import read_coco
    from f3sr.segmentation.label_masks import read_cutouts, read_label_map

    if label_map:
        return read_label_map(label_map, picture)
    if cutouts:
        return read_cutouts(cutouts, picture)
    if coco:
        return read_coco(coco, picture, name=photo.name)
    raise InputError("--ground-stroke", found="no object", accepted="boxes, strokes or masks of objects beside it")


def _selection(
    prompts: Path | None,
    boxes: tuple[str, ...],
    inside: tuple[str, ...],
    outside: tuple[str, ...],
    ground: tuple[str, ...],
) -> Selection:
    """What the options of the command point at, beside the prompts of an earlier run."""
    from f3sr.backends.protocols import Prompt
    from f3sr.segmentation.selection import Selection
    from f3sr.segmentation.selection_json import read_selection

    given = read_selection(prompts) if prompts else Selection(prompts=())
    found = [*given.prompts, *map(_prompt, boxes)]
    strokes = [(_numbered("--inside", text), True) for text in inside]
    strokes += [(_numbered("--outside", text), False) for text in outside]
    last = max((number for (number, _), on in strokes if on), default=-1)
    if last > len(found):
        raise InputError("--inside", found=f"object {last}", accepted=f"0 to {len(found)}")
    found += [Prompt()] * (last + 1 - len(found))
    for (number, stroke), on in strokes:
        if number >= len(found):
            few = (
                f"K below {len(found)}, as objects count from 0"
                if found
                else "an object of --box, --inside or --prompts"
            )
            raise InputError("--outside", found=f"object {number}", accepted=few)
        p = found[number]
        found[number] = replace(p, inside=(*p.inside, stroke)) if on else replace(p, outside=(*p.outside, stroke))
    below = tuple(_stroke("--ground-stroke", text) for text in ground)
    return Selection(prompts=tuple(found), ground=replace(given.ground, inside=(*given.ground.inside, *below)))


def _prompt(text: str) -> Prompt:
    from f3sr.backends.protocols import Prompt

    numbers, _, label = text.partition(":")
    sides = _numbers("--box", text, numbers, BOX)
    if len(sides) != 4:
        raise InputError("--box", found=text, accepted=BOX)
    return Prompt(label=label.strip(), box=(sides[0], sides[1], sides[2], sides[3]))


def _numbered(option: str, text: str) -> tuple[int, Stroke]:
    number, colon, stroke = text.partition(":")
    if not colon or not number.strip().isdecimal() or len(number) > 6:
        raise InputError(option, found=text, accepted=f"K:{STROKE}; K counts the boxes from 0")
    return int(number), _stroke(option, stroke)


def _stroke(option: str, text: str) -> Stroke:
    points = [_numbers(option, text, part, STROKE) for part in text.split(";") if part.strip()]
    if not points or any(len(point) != 2 for point in points):
        raise InputError(option, found=text, accepted=STROKE)
    return tuple((point[0], point[1]) for point in points)


def _numbers(option: str, whole: str, text: str, accepted: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(option, found=whole, accepted=accepted) from None
