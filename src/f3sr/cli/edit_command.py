"""The command that applies a list of edits to a scene package."""

from __future__ import annotations

from f3sr.cli.arguments import MaybeFile, Out, PackageFolder
from f3sr.errors import InputError


def edit(
    package: PackageFolder,
    /,
    out: Out,
    edits: MaybeFile = None,
    config: MaybeFile = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Apply a list of edits to a package: every one is brought to rest, and the scene is measured again.

    Args:
        package: What ``f3sr reconstruct`` or ``f3sr edit`` wrote. One that was edited goes on with its list;
            PACKAGE/unedited is the package before it.
        out: Where the edited package goes; it may be PACKAGE itself.
        edits: edits.json, as docs/editing.md describes it. Without it, the package's own list is applied anew.
        config: TOML file of settings, as for ``reconstruct``.
        overwrite: Also replace a package that holds rollouts.
        json: Print one JSON object instead of text.
    """
    from f3sr import pipeline, settings
    from f3sr.cli import console
    from f3sr.edits import EditSession, read_edits, write_edited
    from f3sr.edits.unedited import kept_edits
    from f3sr.runtime import kernels
    from f3sr.runtime.atomic_folder import recover
    from f3sr.scene_package.package_folder import PAGE, prepare_output, require_package

    recover(package, out)
    require_package(package)
    given = read_edits(edits) if edits else ()
    if not given and not kept_edits(package):
        raise InputError("--edits", found="none, and none in the package", accepted="a list of at least one edit")
    chosen = settings.read(config, pipeline.Config()) if config else pipeline.Config()
    prepare_output(out, overwrite=overwrite, edits=True)
    with console.steps_shown(quiet=json) as progress, kernels.compiling() as compilers:
        compilers.begin(progress)
        session = EditSession.open(package, config=chosen, progress=progress)
        for one in given:
            session.add(one, progress=progress)
        written = write_edited(session, out, overwrite=overwrite, progress=progress)
    before, now = session.outcomes[0].measures.as_dict(), session.outcome.measures.as_dict()
    columns = {"before": before, "edited": now}
    if json:
        told = [
            {"number": o.number, "kind": o.edit.kind, "id": o.edit.id, "done": o.done, "seconds": o.seconds}
            | {"decisions": [f"{d.choice}; {d.reason}" for d in o.decisions if d.fallback]}
            for o in session.outcomes
            if o.edit is not None
        ]
        console.print_json({"package": str(written), "edits": told, **columns})
        return
    console.say_fallbacks([session.report])
    console.print_measures(columns)
    console.say(f"package:  {written}")
    console.say(f"report:   {written / PAGE}")
