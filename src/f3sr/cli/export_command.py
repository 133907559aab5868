"""The command from a scene package to the formats of other programs."""

from __future__ import annotations

from f3sr.cli.arguments import Formats, MaybeOut, PackageFolder, names_in


def export(
    package: PackageFolder,
    /,
    format: Formats = "mjcf,sdf,urdf",
    out: MaybeOut = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Write a scene package in the formats of other programs; nothing is computed again.

    Args:
        package: What ``f3sr reconstruct`` wrote.
        format: Formats, comma separated without spaces: mjcf, robosuite, sdf, urdf, glb, and usd with the extra
            ``usd``. ``f3sr doctor`` lists those of other packages too.
        out: A new folder for them: it gets a folder per format, and export.json. Without it, PACKAGE_export.
        overwrite: Also replace an older export.
        json: Print one JSON object instead of text.
    """
    from f3sr.cli import console
    from f3sr.runtime.atomic_folder import recover
    from f3sr.scene_export import beside, export_package, exporters_of, prepare_export
    from f3sr.scene_package.package import read_package

    recover(*(place for place in (package, out) if place))
    formats = names_in(format)
    exporters_of(formats, option="--format")
    place = prepare_export(out or beside(package), overwrite=overwrite)
    content = read_package(package)
    with console.steps_shown(quiet=json) as progress:
        written = export_package(content, place, formats, overwrite=overwrite, progress=progress)
    if json:
        console.print_json({"folder": str(written), "formats": sorted(set(formats))})
    else:
        console.say(f"export:   {written}")
