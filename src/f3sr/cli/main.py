"""The command line. Exit codes: 0 done, 2 bad input, 3 a goal refused, 4 a goal not met, 1 anything else."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import tyro

import f3sr
from f3sr.cli import (
    agent_commands,
    batch_commands,
    certify_command,
    edit_command,
    export_command,
    goal_commands,
    import_command,
    photo_command,
    sample_command,
    segment_command,
    studio_command,
)
from f3sr.cli.arguments import Axes, Folder, Ignore, MaybeFile, Out, names_in
from f3sr.cli.reconstruct_command import reconstruct
from f3sr.cli.reconstruction_run import columns_of
from f3sr.errors import (
    F3srError,
    F3srWarning,
    InputError,
    MissedError,
    RefusedError,
    one_line,
    printable,
    unforeseen,
)
from f3sr.runtime import signals

DESCRIPTION = """From one photo with object masks to a 3-D scene that a physics engine can run, and goals played in it.
`f3sr COMMAND --help` explains a command, `f3sr --version` prints the version.

Exit codes: 0 done, 1 any other error, 2 bad input, 3 a goal was refused, 4 a goal was played and not met.

Environment: F3SR_CACHE_DIR is where results are stored, F3SR_CACHE_LIMIT_GB their largest size (default 5).
F3SR_TRACEBACK=1 shows where an unforeseen error arose. F3SR_WORKER_NAME is the command of a worker, as
F3SR_WORKER_SAM3D or F3SR_WORKER_GEOMETRY; `f3sr doctor` lists them and the keys of services. F3SR_STUDIO_PASSWORD is
the password of a studio that other machines reach."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    commands: dict[str, Callable[..., Any]] = {
        "studio": studio_command.studio,
        "photo": photo_command.photo,
        "segment": segment_command.segment,
        "import": import_command.import_scene,
        "reconstruct": reconstruct,
        "edit": edit_command.edit,
        "export": export_command.export,
        "certify": certify_command.certify,
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
        if arguments and (command := commands.get(arguments[0])):  # alone: tyro would look at all commands first
            tyro.cli(command, prog=f"f3sr {arguments[0]}", args=arguments[1:])
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
            given = read_inputs(folder, ignore=names_in(ignore), asset_frame=asset_frame)
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
    columns = columns_of(measured, name)
    if json:
        console.print_json(columns)
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
        console.print_json({"checks": [asdict(check) for check in checks]})
    else:
        console.print_table(
            [(c.state, c.group, c.name, c.found) for c in checks], header=("state", "group", "name", "found")
        )
    if failed := [check.name for check in checks if check.state == "failed"]:
        raise F3srError(f"does not work here: {', '.join(failed)}")


# --- words and tables ---------------------------------------------------------------------------------------------


def _is_input(folder: Path) -> bool:
    """Whether this is meant to be a prompted-image folder; packages have masks too."""
    return (folder / "masks").is_dir() and not (folder / "scene.json").exists()


def _refuse_for_packages(ignore: str, asset_frame: str) -> None:
    for option, given in (("--ignore", ignore), ("--asset-frame", "" if asset_frame == "auto" else asset_frame)):
        if given:
            raise InputError(option, found=given, accepted="only with a prompted-image folder, not with a package")


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
