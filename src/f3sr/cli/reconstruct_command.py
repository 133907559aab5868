"""The command from a prompted-image folder to a scene package."""

from __future__ import annotations

from f3sr import options
from f3sr.cli.arguments import (
    Axes,
    DeviceName,
    Folder,
    Formats,
    Ignore,
    Known,
    MaybeFile,
    MaybeMetres,
    MaybeMillimetres,
    MaybePixels,
    MaybeShare,
    Name,
    NormalAxes,
    Out,
    PrecisionName,
    Skip,
    names_in,
)
from f3sr.errors import require_known


def reconstruct(
    folder: Folder,
    /,
    out: Out,
    skip: Skip = "",
    ignore: Ignore = "",
    asset_frame: Axes = "auto",
    geometry_noise: MaybeShare = None,
    geometry: Name = None,
    normals: Name = None,
    normals_axes: NormalAxes = "",
    assets: Name = None,
    scene_graph: Name = None,
    labels: Name = None,
    background: Name = None,
    focal: MaybePixels = None,
    focal_35mm: MaybeMillimetres = None,
    camera_height: MaybeMetres = None,
    known: Known = "",
    mask_overlap: MaybeShare = None,
    device: DeviceName = "auto",
    precision: PrecisionName = "auto",
    allow_downloads: bool = False,
    config: MaybeFile = None,
    edits: MaybeFile = None,
    export: Formats = "",
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Turn a prompted-image folder into a scene package.

    Args:
        folder: Must hold image.png|jpg and masks/*.png. May hold assets/, geometry.npz (or depth.png|npy, best with
            intrinsics.json), ground.png, scene_graph.json, background.png, materials.json. What it lacks is made from
            the photo.
        out: Where the package goes; an older f3sr package there is replaced.
        geometry_noise: Standard deviation of the geometry's depths, as a share of the distance, 0.0001 to 0.5. Without
            it: measured for a sensor's depth, 0.01 for an estimate.
        geometry: Back end that estimates geometry where the folder has none; ``f3sr doctor`` lists its names. One with
            a model takes NAME:MODEL, a local file or folder, or a name on the hub.
        normals: Back end that estimates surface normals, as omnidata:FILE, where the geometry has none: they tell the
            tilt of the camera. ``f3sr doctor`` lists its names.
        normals_axes: Axes of these normals, where the photo does not tell them: right or left, down or up, forwards or
            backwards, as rdf.
        assets: Back end that generates meshes where the folder has none; ``f3sr doctor`` lists its names.
        scene_graph: Back end that proposes relations where the folder has none; ``f3sr doctor`` lists its names. Or a
            vision model, as openai:NAME.
        labels: Back end that names objects whose masks have no label, or a vision model, as openai:NAME.
        background: Back end that completes the photo behind the objects; ``f3sr doctor`` lists its names. Or a model
            that edits pictures, as openai:NAME. Without it: background.png if there, else patchmatch.
        focal: Focal length [px] of the upright photo, where geometry is made from the photo, as for the next three.
        focal_35mm: The same in 35 mm equivalent [mm], by the photo's diagonal.
        camera_height: Height of the camera above what the objects stand on [m].
        known: Known lengths [m] of objects by id or label, as "mug=0.12,3=0.3": the longest side of the tightest box
            around the object.
        mask_overlap: Share of the smaller of two masks that may lie in both, up to 0.5; the smaller one keeps it.
            Without it: 0.05.
        device: Where models of back ends run; auto is the first of cuda, mps and cpu that is there.
        precision: Their numbers; auto is float32 on a CPU, what a model usually runs in elsewhere.
        allow_downloads: Fetch weights of such models from the hub where they are not on this machine.
        config: TOML file of settings; those it does not name stay as ``f3sr config`` prints them.
        edits: edits.json, as an edited package holds it: what was changed by hand is changed again.
        export: Formats to write the package in too, as for ``f3sr export``, into OUT_export.
        overwrite: Also replace a package that holds rollouts, and an older export.
        json: Print one JSON object instead of text.
    """
    from f3sr.backends.model_choice import ModelChoice
    from f3sr.cli.reconstruction_run import make_package
    from f3sr.cli.run_request import requested
    from f3sr.runtime import atomic_folder

    require_known("--skip", names_in(skip), options.SKIPPABLE)
    atomic_folder.recover(out)
    if formats := names_in(export):
        from f3sr import scene_export

        scene_export.exporters_of(formats, option="--export")
        scene_export.prepare_export(scene_export.beside(out), overwrite=overwrite)
    request = requested(
        choice=ModelChoice(device=device, precision=precision, allow_downloads=allow_downloads, axes=normals_axes),
        geometry=geometry,
        normals=normals,
        assets=assets,
        scene_graph=scene_graph,
        labels=labels,
        background=background,
        focal=focal,
        focal_35mm=focal_35mm,
        camera_height=camera_height,
        known=known,
        config=config,
        edits=edits,
    )
    make_package(
        folder,
        out,
        request,
        skip=names_in(skip),
        formats=formats,
        overwrite=overwrite,
        json=json,
        ignore=names_in(ignore),
        asset_frame=asset_frame,
        geometry_noise=geometry_noise,
        mask_overlap=mask_overlap,
    )
