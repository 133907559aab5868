"""The command line. Exit codes: 0 done, 2 bad input, 1 anything else."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional, arg

from f3sr.errors import F3srError, InputError

Folder = Positional[Path]
Out = Annotated[Path, arg(aliases=["-o"])]


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    commands: dict[str, Callable[..., Any]] = {"reconstruct": reconstruct, "evaluate": evaluate, "demo": demo}
    try:
        tyro.extras.subcommand_cli_from_dict(
            commands,
            prog="f3sr",
            description="From one photo with object masks to a 3-D scene that a physics engine can run.",
            args=argv,
        )
    except InputError as error:
        return _fail(2, str(error))
    except F3srError as error:
        return _fail(1, str(error))
    except OSError as error:
        return _fail(1, f"{error.filename or 'system'}: {error.strerror or error}")
    except KeyboardInterrupt:
        return _fail(1, "interrupted; nothing was written")
    return 0


def reconstruct(
    folder: Folder,
    /,
    out: Out,
    skip: str = "",
    ignore: str = "",
    asset_frame: str = "auto",
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Turn a prompted-image folder into a scene package.

    Args:
        folder: Holds image.png|jpg, masks/*.png, geometry.npz (or depth and intrinsics.json), assets/, ground.png.
        out: Where the package goes; an older f3sr package there is replaced.
        skip: Stages to leave out, comma separated: level, align, align-camera, align-objects, relate, decompose,
            separate, settle, refine, evaluate.
        ignore: Parts of the input to treat as absent, comma separated: assets, geometry, ground, scene_graph.
        asset_frame: Axes of posed GLBs that come without poses.json: auto, opencv, opengl or pytorch3d.
        overwrite: Also replace a package that holds rollouts.
        json: Print one JSON object instead of text.
    """
    from pydantic import JsonValue

    from f3sr import inputs, kernels, package, pictures, pipeline
    from f3sr.cache import Store
    from f3sr.page import report_page

    say = _quiet if json else _say
    package.prepare_output(out, inputs=folder, overwrite=overwrite)
    given = inputs.read(folder, ignore=_names(ignore), asset_frame=asset_frame)
    kernels.warm_up(say)
    store = Store(kernels.cache_root() / "stages")
    result = pipeline.reconstruct(given, skip=_names(skip), store=store, progress=say)
    written = package.write_package(
        result.scene,
        out,
        direct=result.direct,
        metrics=result.evaluation.result.as_dict() if result.evaluation else {},
        provenance={
            "inputs": dict[str, JsonValue](given.digests),
            "config": result.config_digest,
            "skipped": list[JsonValue](sorted(_names(skip))),
        },
        reports=result.reports,
        seconds=result.seconds,
        pictures=pictures.pictures_of(result.direct, result.scene),
        page=report_page(result),
        overwrite=overwrite,
    )
    if json:
        print(_json({"package": str(written), "seconds": result.seconds, **_table(result.evaluation)}))
        return
    for report in result.reports:
        for decision in report.fallbacks:
            about = f" (object {decision.about})" if decision.about is not None else ""
            say(f"fallback in {report.stage}{about}: {decision.choice}; {decision.reason}")
    _print_table(_table(result.evaluation))
    say(f"package:  {written}")
    say(f"report:   {written / package.PAGE}")


def evaluate(package: Folder, /, true_scale: float = 1.0, json: bool = False) -> None:
    """Measure a scene package, with direct composition (the levelled input as it came) beside it.

    Args:
        package: A folder that ``f3sr reconstruct`` wrote.
        true_scale: Factor from the scene's lengths to true metres, where it is known; physics depends on it.
        json: Print one JSON object instead of a table.
    """
    from f3sr import kernels
    from f3sr.package import read_package
    from f3sr.stages.evaluate import evaluate as measure_both

    if not 1e-3 <= true_scale <= 1e3:
        raise InputError("--true-scale", found=str(true_scale), accepted="a positive number from 0.001 to 1000")
    content = read_package(package)
    kernels.warm_up(_quiet if json else _say)
    table = _table(measure_both(content.scene, content.direct, true_scale=true_scale))
    if json:
        print(_json(table))
    else:
        _print_table(table)


def demo(out: Out = Path("out/demo"), overwrite: bool = False) -> None:
    """Reconstruct the bundled example.

    Args:
        out: Where the package goes.
        overwrite: Also replace a package that holds rollouts.
    """
    from f3sr import example

    reconstruct(example.folder(), out=out, overwrite=overwrite)


# --- words and tables ---------------------------------------------------------------------------------------------


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _table(evaluation: Any) -> dict[str, dict[str, float]]:
    """The measures of direct composition, where known, and of the result, by column name."""
    columns = {"direct composition": evaluation.direct, "f3sr": evaluation.result} if evaluation else {}
    return {name: measures.as_dict() for name, measures in columns.items() if measures}


def _print_table(table: dict[str, dict[str, float]]) -> None:
    if not table:
        return
    from rich.console import Console
    from rich.table import Table

    view = Table(box=None, padding=(0, 2, 0, 0))
    view.add_column("")
    for row in table:
        view.add_column(row, justify="right")
    for name in next(iter(table.values())):
        view.add_row(name, *(f"{row[name]:.4g}" for row in table.values()))
    Console(highlight=False).print(view)


def _say(text: str) -> None:
    print(text, flush=True)


def _quiet(text: str) -> None:
    del text


def _json(value: object) -> str:
    return json.dumps(value, allow_nan=False)


def _fail(code: int, message: str) -> int:
    print(f"f3sr: {message}", file=sys.stderr)
    return code


def run() -> None:
    """Console script. Names that a terminal's encoding lacks are escaped, not fatal."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    sys.exit(main())
