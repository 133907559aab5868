"""The command that makes a prompted-image folder of what another program left."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from f3sr.cli.arguments import MaybeFile, MaybePixels, default_shown
from f3sr.cli.segment_command import FolderOut, MaybeFolder
from f3sr.errors import InputError, require_known

if TYPE_CHECKING:
    from f3sr.importing.import_source import MaskReader

SceneFolder = Annotated[Positional[Path], arg(metavar="DIR")]
Program = Annotated[str | None, arg(name="from", metavar="NAME", help_behavior_hint=default_shown)]
CameraAxes = Annotated[str, arg(metavar="AXES")]


def import_scene(
    folder: SceneFolder,
    /,
    out: FolderOut,
    program: Program = None,
    photo: MaybeFile = None,
    masks: MaybeFolder = None,
    label_map: MaybeFile = None,
    cutouts: MaybeFolder = None,
    coco: MaybeFile = None,
    in_order: bool = False,
    focal: MaybePixels = None,
    asset_frame: CameraAxes = "auto",
    json: bool = False,
) -> None:
    """Turn what another program left into a prompted-image folder for ``f3sr reconstruct``.

    Args:
        folder: A folder of SAM 3D Objects, ComfyUI, fal, TRELLIS, EmbodiedGen or Fysiverse-3D, or a GLB with a node
            per object.
        out: A new folder, or one that this command wrote. Masks are drawn from the poses where there are none.
        program: fysiverse, sam3d, comfyui, fal, trellis, embodiedgen or glb. Without it, what is there tells.
        photo: The photo, where the folder has no image.png or image.jpg.
        masks: A folder of black and white PNGs, one per object; they overrule the program's own. Numbers or labels in
            file names tell which mesh belongs to which mask.
        label_map: Instead: a PNG whose grey values or palette numbers are the objects; 0 is none.
        cutouts: Instead: a folder of photo-sized PNGs, each with one object that is not transparent.
        coco: Instead: a JSON file of COCO's format with run-length codes or polygons.
        in_order: The n-th mesh by name belongs to the n-th mask by number.
        focal: Focal length [px] of the upright photo, where the program keeps none.
        asset_frame: Axes of a GLB that is posed in the photo's camera: opencv, opengl, pytorch3d. Without it, it is in
            a world with +Y up.
        json: Print one JSON object instead of text.
    """
    from f3sr.cli import console
    from f3sr.importing.import_source import ImportSource
    from f3sr.importing.scene_import import import_output
    from f3sr.io.photo_hints import PhotoHints
    from f3sr.options import ASSET_FRAMES

    require_known("--asset-frame", [asset_frame], ASSET_FRAMES)
    source = ImportSource(
        path=folder,
        photo_file=photo,
        mask_reader=_mask_reader(masks, label_map, cutouts, coco),
        in_order=in_order,
        hints=PhotoHints(focal=focal),
        asset_frame=asset_frame,
    )
    written = import_output(source, out, program)
    unseen = [item.label or str(item.id) for item in written.left_out]
    if json:
        told = {"source": written.source, "masks": written.masks, "poses": written.poses}
        remarks = list(written.remarks)
        counts = {"folder": str(written.folder), "objects": written.objects, "left_out": unseen}
        console.print_json({**counts, **told, "remarks": remarks})
        return
    console.say(f"source:   {written.source}")
    console.say(f"objects:  {written.objects}, masks {written.masks}, poses {written.poses}")
    for item in written.left_out:
        console.say(f"left out: {item.label or item.id}; {item.reason}")
    for remark in written.remarks:
        console.say(f"remark:   {remark}")
    console.say(f"folder:   {written.folder}")


def _mask_reader(
    masks: Path | None, label_map: Path | None, cutouts: Path | None, coco: Path | None
) -> MaskReader | None:
    """The reader of the masks that an option names, if one does. Raises InputError for more than one."""
    from f3sr.importing.import_source import masks_of_folder
    from f3sr.segmentation.coco_masks import read_coco
    from f3sr.segmentation.label_masks import read_cutouts, read_label_map

    given = {"--masks": masks, "--label-map": label_map, "--cutouts": cutouts, "--coco": coco}
    if len(names := [name for name, value in given.items() if value is not None]) > 1:
        raise InputError("import", found=" and ".join(names), accepted="one way to tell the masks")
    if masks:
        return masks_of_folder(masks)
    if label_map:
        return lambda photo: read_label_map(label_map, photo.photo)
    if cutouts:
        return lambda photo: read_cutouts(cutouts, photo.photo)
    if coco:
        return lambda photo: read_coco(coco, photo.photo, name=photo.file.name)
    return None
