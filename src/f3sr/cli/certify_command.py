"""The command that has other people's engines and validators judge a package."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from tyro.conf import UseAppendAction, arg

from f3sr.cli.arguments import Formats, MaybeOut, PackageFolder, names_in
from f3sr.errors import F3srError, InputError

if TYPE_CHECKING:
    from f3sr.certificate.certificate_document import EngineRow

Programs = Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="CLIENT=PATH")]
Seconds = Annotated[float, arg(metavar="S")]


def certify(
    package: PackageFolder,
    /,
    engines: Formats = "",
    python: Programs = (),
    out: MaybeOut = None,
    deadline: Seconds = 600.0,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Release a package in other engines and have validators check it; exit code 1 where something fails.

    Writes certificate.json and certificate.html: drift, rotation, penetration, mass and inertia of every object in
    every engine, and what validators found. What is not installed is listed with the command that brings it.

    Args:
        package: What ``f3sr reconstruct`` wrote.
        engines: Engines and validators, comma separated without spaces, all by default: mujoco, mujoco-warp, mjx,
            newton, pybullet, drake, sapien; simready, usd, mjcf-doctor, gltf.
        python: The Python of a client's own environment, as drake=/path/to/python; may be repeated. Without it, the
            Python that runs f3sr. For gltf, node.
        out: A new folder for the certificate. Without it, PACKAGE_certificate.
        deadline: Wall time of each client [s]; then it is ended, and the certificate says so.
        overwrite: Also replace an older certificate.
        json: Print one JSON object instead of text.
    """
    from f3sr.certificate.certificate_document import as_plain
    from f3sr.certificate.certification import beside, prepare_certificate
    from f3sr.certificate.certification import certify as certified
    from f3sr.cli import console
    from f3sr.runtime.atomic_folder import recover
    from f3sr.scene_package.package import read_package

    recover(*(place for place in (package, out) if place))
    place = prepare_certificate(out or beside(package), overwrite=overwrite)
    content = read_package(package)
    with console.steps_shown(quiet=json) as progress:
        made = certified(
            content,
            place,
            clients=names_in(engines),
            programs=dict(map(_program, python)),
            deadline=deadline,
            overwrite=overwrite,
            progress=progress,
        )
    if json:
        console.print_json({"folder": str(place), **as_plain(made)})
    else:
        rows = [(row.client.name, row.state, _told(row) or row.reason) for row in made.engines]
        rows += [
            (row.client.name, row.state, row.reason or f"{row.checked} files, {len(row.findings)} findings")
            for row in made.validators
        ]
        console.print_table(rows, header=("client", "state", "found"))
        console.say(f"certificate: {place}, {made.verdict}")
    if made.problems:
        raise F3srError(f"not certified: {'; '.join(made.problems)}")


def _told(row: EngineRow) -> str:
    """Of an engine that answered."""
    roll = f", {row.count('rolls')} roll" if row.count("rolls") else ""
    return f"{row.count('rests')} of {len(row.objects)} rest{roll}" if row.objects else ""


def _program(text: str) -> tuple[str, str]:
    """The client and the interpreter in ``drake=/path/to/python``."""
    name, given, program = text.partition("=")
    if not given or not program:
        raise InputError("--python", found=text, accepted="CLIENT=PATH, as drake=/path/to/python")
    return name, program
