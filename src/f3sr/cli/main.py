"""The command line. Exit codes: 0 done, 2 bad input, 3 a goal refused, 4 a goal not met, 1 anything else."""

from __future__ import annotations

import io
import json
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import tyro

import f3sr
from f3sr import options
from f3sr.cli import agent_commands, batch_commands, goal_commands, sample_command, segment_command
from f3sr.cli.arguments import Axes, Folder, Ignore, MaybeFile, MaybeShare, Name, Out, Skip
from f3sr.errors import (
    F3srError,
    F3srWarning,
    InputError,
    MissedError,
    RefusedError,
    one_line,
    printable,
    require_known,
    unforeseen,
)
from f3sr.runtime import signals

if TYPE_CHECKING:
    from f3sr.backends.registry import Backend, Kind

P = TypeVar("P")

DESCRIPTION = """From one photo with object masks to a 3-D scene that a physics engine can run, and goals played in it.
`f3sr COMMAND --help` explains a command, `f3sr --version` prints the version.

Exit codes: 0 done, 1 any other error, 2 bad input, 3 a goal was refused, 4 a goal was played and not met.

Environment: F3SR_CACHE_DIR is where results are stored, F3SR_CACHE_LIMIT_GB their largest size (default 5).
F3SR_TRACEBACK=1 shows where an unforeseen error arose."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    commands: dict[str, Callable[..., Any]] = {
        "segment": segment_command.segment,
        "reconstruct": reconstruct,
        "evaluate": evaluate,
        "simulate": goal_commands.simulate,
        "film": goal_commands.film,
        "goals": goal_commands.goals,
        "sample": sample_command.sample,
        "chat": agent_commands.chat,
        "materials": agent_commands.materials,
        "mcp": agent_commands.mcp,
        "batch": batch_commands.batch,
        "dataset": batch_commands.dataset,
        "demo": demo,
        "config": config,
        "doctor": doctor,
    }
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        if arguments == ["--version"]:
            print(f"f3sr {f3sr.__version__}")
            return 0
        if arguments[:1] == ["dataset"]:
            tyro.extras.subcommand_cli_from_dict(
                dict(batch_commands.DATASET_COMMANDS),
                prog="f3sr dataset",
                description=batch_commands.dataset.__doc__,
                args=arguments[1:],
            )
            return 0
        tyro.extras.subcommand_cli_from_dict(
            commands,
            prog="f3sr",
            description=DESCRIPTION,
            args=arguments,
        )
    except InputError as error:
        return _fail(2, str(error))
    except RefusedError as error:
        return _fail(3, str(error))
    except MissedError as error:
        return _fail(4, str(error))
    except F3srError as error:
        return _fail(1, str(error))
    except BrokenPipeError:
        return _fail(1, f"nobody reads the output; {signals.state()}")
    except OSError as error:
        return _fail(1, f"{error.filename or 'system'}: {error.strerror or error}")
    except KeyboardInterrupt:
        return _fail(1, f"interrupted; {signals.state()}")
    except Exception as error:  # the last line of defence: what nobody foresaw is one line too
        return _fail(1, unforeseen(error, signals.state()))
    return 0


def reconstruct(
    folder: Folder,
    /,
    out: Out,
    skip: Skip = "",
    ignore: Ignore = "",
    asset_frame: Axes = "auto",
    geometry_noise: MaybeShare = None,
    geometry: Name = None,
    assets: Name = None,
    scene_graph: Name = None,
    labels: Name = None,
    background: Name = None,
    config: MaybeFile = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Turn a prompted-image folder into a scene package.

    Args:
        folder: Must hold image.png|jpg, masks/*.png, assets/, geometry.npz (or depth.png|npy and intrinsics.json).
            May hold ground.png, scene_graph.json, background.png, materials.json.
        out: Where the package goes; an older f3sr package there is replaced.
        geometry_noise: Standard deviation of the geometry's depths, as a share of the distance, 0.0001 to 0.5. Without
            it: measured for a sensor's depth, 0.01 for an estimate.
        geometry: Back end that estimates geometry where the folder has none; ``f3sr doctor`` lists its names.
        assets: Back end that generates meshes where the folder has none; ``f3sr doctor`` lists its names.
        scene_graph: Back end that proposes relations where the folder has none; ``f3sr doctor`` lists its names. Or a
            vision model, as openai:NAME.
        labels: Back end that names objects whose masks have no label, or a vision model, as openai:NAME.
        background: Back end that completes the photo behind the objects; ``f3sr doctor`` lists its names. Or a model
            that edits pictures, as openai:NAME. Without it: background.png if there, else patchmatch.
        config: TOML file of settings; those it does not name stay as ``f3sr config`` prints them.
        overwrite: Also replace a package that holds rollouts.
        json: Print one JSON object instead of text.
    """
    from f3sr import pipeline, settings
    from f3sr.backends.kinds import LABELERS, SCENE_GRAPHERS
    from f3sr.background.completers import BACKGROUND_COMPLETERS, DEFAULT_COMPLETER
    from f3sr.cli import console
    from f3sr.delivery import deliver
    from f3sr.io.input_folder import INPUT_FOLDER
    from f3sr.io.inputs import Fillers
    from f3sr.lifting.generators import ASSET_GENERATORS
    from f3sr.metrology.estimators import GEOMETRY_ESTIMATORS
    from f3sr.photo_inputs import read_inputs
    from f3sr.runtime import atomic_folder, kernels
    from f3sr.runtime.progress import timed
    from f3sr.runtime.result_store import Store
    from f3sr.scene_package import package, package_folder

    require_known("--skip", _names(skip), options.SKIPPABLE)
    atomic_folder.recover(out)
    if package_folder.is_package(folder):
        raise InputError(folder, found=package_folder.PACKAGE, accepted=INPUT_FOLDER)
    chosen = settings.read(config, pipeline.Config()) if config else pipeline.Config()
    fillers = Fillers(
        geometry=_backend(GEOMETRY_ESTIMATORS, geometry),
        assets=_backend(ASSET_GENERATORS, assets),
        scene_graph=_backend(SCENE_GRAPHERS, scene_graph),
        labels=_backend(LABELERS, labels),
    )
    completer = _backend(BACKGROUND_COMPLETERS, background) if background != DEFAULT_COMPLETER else None
    with console.steps_shown(quiet=json) as progress, kernels.compiling() as compilers:
        with timed("read", progress):
            given = read_inputs(
                folder, ignore=_names(ignore), asset_frame=asset_frame, geometry_noise=geometry_noise, fillers=fillers
            )
        package.prepare_output(out, inputs=folder, overwrite=overwrite)
        compilers.begin(progress)
        result = pipeline.reconstruct(
            given, chosen, skip=_names(skip), background=completer, store=Store.default(), progress=progress
        )
        written = deliver(result, out, overwrite=overwrite, progress=progress)
    if json:
        print(_json({"package": str(written), "seconds": result.seconds, **_columns(result.evaluation)}))
        return
    for report in result.reports:
        for decision in report.fallbacks:
            about = f" (object {decision.about})" if decision.about is not None else ""
            console.say(f"fallback in {report.stage}{about}: {decision.choice}; {decision.reason}")
    console.print_measures(_columns(result.evaluation))
    console.say(f"package:  {written}")
    console.say(f"report:   {written / package.PAGE}")


def _backend(kind: Kind[P], name: str | None) -> Backend[P] | None:
    """The back end of a name, or of a model's spec as ``openai:NAME``, where a model can do that."""
    if name is None:
        return None
    if name.partition(":")[0] not in ("openai", "anthropic"):
        return kind.find(name)
    from f3sr.agents import image_edit, photo_reader

    makers: dict[str, Callable[[str], Any]] = {
        "scene_graph": photo_reader.scene_grapher,
        "labels": photo_reader.labeler,
        "background": image_edit.image_edit,
    }
    if kind.name not in makers:
        raise InputError(f"--{kind.name}", found=name, accepted=f"a back end: {', '.join(kind.names()) or 'none yet'}")
    return makers[kind.name](name)


def evaluate(
    folder: Folder,
    /,
    true_scale: float = 1.0,
    ignore: Ignore = "",
    asset_frame: Axes = "auto",
    config: MaybeFile = None,
    json: bool = False,
) -> None:
    """Measure a scene package and direct composition, or direct composition alone from a prompted-image folder.

    Args:
        folder: A package that ``f3sr reconstruct`` wrote, or the input of one. Direct composition is the levelled
            input, moved vertically until its lowest vertex touches the ground. It, and a package whose camera f3sr did
            not align, is also seen by a camera fitted to its masks.
        true_scale: Factor from the scene's lengths to true metres, 0.001 to 1000, if known; physics depends on it.
        config: TOML file of settings, as for ``reconstruct``; a package needs only those of [evaluate].
        json: Print one JSON object instead of a table.
    """
    from f3sr import pipeline, settings
    from f3sr.cli import console
    from f3sr.io.input_folder import INPUT_FOLDER
    from f3sr.photo_inputs import read_inputs
    from f3sr.runtime import atomic_folder, kernels
    from f3sr.runtime.progress import timed
    from f3sr.runtime.result_store import Store
    from f3sr.scene_package.package import read_package
    from f3sr.scene_package.package_folder import PACKAGE, require_package
    from f3sr.stages import evaluate as stage

    atomic_folder.recover(folder)
    if not 1e-3 <= true_scale <= 1e3:
        raise InputError("--true-scale", found=str(true_scale), accepted="a positive number from 0.001 to 1000")
    chosen = settings.read(config, pipeline.Config()) if config else pipeline.Config()
    with console.steps_shown(quiet=json) as progress, kernels.compiling() as compilers:
        if _is_input(folder):
            given = read_inputs(folder, ignore=_names(ignore), asset_frame=asset_frame)
            compilers.begin(progress)
            scene = pipeline.composed_directly(given, chosen, store=Store.default(), progress=progress)
            direct, foreign, name = None, True, stage.DIRECT
        else:
            require_package(folder, accepted=f"{PACKAGE}, or {INPUT_FOLDER}")
            _refuse_for_packages(ignore, asset_frame)
            content = read_package(folder)
            compilers.begin(progress)
            scene, direct, foreign, name = content.scene, content.direct, not content.camera_aligned, "f3sr"
        with timed("evaluate", progress):
            measured = stage.evaluate(scene, direct, chosen.evaluate, foreign=foreign, true_scale=true_scale)
    columns = _columns(measured, name)
    if json:
        print(_json(columns))
    else:
        console.print_measures(columns)


def demo(out: Out = Path("out/demo"), overwrite: bool = False) -> None:
    """Reconstruct the bundled example, and play and film a goal in it: throw the lemon into the mug.

    Args:
        out: Where the package goes.
        overwrite: Also replace a package that holds rollouts: a second run needs it.
    """
    from f3sr import example
    from f3sr.runtime import kernels

    with kernels.compiling(film=True):  # those of the film while the scene is reconstructed
        reconstruct(example.folder(), out=out, overwrite=overwrite)
        goal_commands.simulate(out, (example.GOAL,))


def config() -> None:
    """Print the default settings as TOML, each with its unit, range and meaning; for ``reconstruct --config``."""
    from f3sr import pipeline, settings

    print(f"# f3sr {f3sr.__version__} defaults\n\n{settings.describe(pipeline.Config())}", end="")


def doctor(json: bool = False) -> None:
    """Try out every part on this machine and say what works and what does not; exit code 1 where something fails.

    Args:
        json: Print one JSON object instead of text.
    """
    from dataclasses import asdict

    from f3sr.cli import console
    from f3sr.cli.doctor import examine

    checks = examine()
    if json:
        print(_json({"checks": [asdict(check) for check in checks]}))
    else:
        console.print_table(
            [(c.state, c.group, c.name, c.found) for c in checks], header=("state", "group", "name", "found")
        )
    if failed := [check.name for check in checks if check.state == "failed"]:
        raise F3srError(f"does not work here: {', '.join(failed)}")


# --- words and tables ---------------------------------------------------------------------------------------------


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _is_input(folder: Path) -> bool:
    """Whether this is meant to be a prompted-image folder; packages have masks too."""
    return (folder / "masks").is_dir() and not (folder / "scene.json").exists()


def _refuse_for_packages(ignore: str, asset_frame: str) -> None:
    for option, given in (("--ignore", ignore), ("--asset-frame", "" if asset_frame == "auto" else asset_frame)):
        if given:
            raise InputError(option, found=given, accepted="only with a prompted-image folder, not with a package")


def _columns(evaluation: Any, name: str = "f3sr") -> dict[str, dict[str, float]]:
    """The measures of direct composition, where known, and of the result, by title."""
    return {title: measures.as_dict() for title, measures in evaluation.rows(name).items()} if evaluation else {}


def _json(value: object) -> str:
    return json.dumps(value, allow_nan=False)


def _fail(code: int, message: str) -> int:
    print(f"f3sr: {one_line(message)}", file=sys.stderr)
    return code


def run() -> int:
    """The whole life of a process, to its exit code. Names that a terminal's encoding lacks are escaped, not fatal."""
    warnings.formatwarning = _as_line
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        code = main()
    except SystemExit as end:  # --help and wrong arguments
        code = end.code if isinstance(end.code, int) else 1
    return _flushed(code)


def _as_line(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> str:
    """f3sr's own warnings as one line, others as Python shows them."""
    own = issubclass(category, F3srWarning)
    return f"f3sr: {printable(str(message))}\n" if own else _with_place(message, category, *where, **more)


_with_place = warnings.formatwarning


def _flushed(code: int) -> int:
    """The exit code once all output is out; a closed pipe or a full disk behind it is told in one line."""
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())  # or Python tries, and complains, again
            code = code or _fail(1, f"the output could not be written ({error.strerror}); {signals.state()}")
    return code
