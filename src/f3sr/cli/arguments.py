"""Arguments that several commands have: what help calls them, and which default it shows."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from f3sr import options
from f3sr.backends.model_choice import Device, Precision


def default_shown(value: str) -> str:
    """The default at the end of an option's help; none where leaving it out means nothing but that."""
    return "" if value in ("None", "", "''") else f"(default: {value})"


Folder = Annotated[Positional[Path], arg(metavar="FOLDER")]
PackageFolder = Annotated[Positional[Path], arg(metavar="PACKAGE")]
RolloutFolder = Annotated[Positional[Path], arg(metavar="ROLLOUT")]
Goals = Annotated[Positional[tuple[str, ...]], arg(metavar="[GOAL ...]", help_behavior_hint=default_shown)]
Out = Annotated[Path, arg(aliases=["-o"], metavar="OUT")]
MaybeOut = Annotated[Path | None, arg(aliases=["-o"], metavar="OUT", help_behavior_hint=default_shown)]
MaybePackage = Annotated[Path | None, arg(metavar="PACKAGE", help_behavior_hint=default_shown)]
MaybeFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint=default_shown)]
MaybeShare = Annotated[float | None, arg(metavar="SHARE", help_behavior_hint=default_shown)]
Name = Annotated[str | None, arg(metavar="NAME", help_behavior_hint=default_shown)]
Model = Annotated[str | None, arg(metavar="MODEL", help_behavior_hint=default_shown)]
DeviceName = Annotated[Device, arg(help_behavior_hint=default_shown)]
PrecisionName = Annotated[Precision, arg(help_behavior_hint=default_shown)]
AgentChoice = Literal["roles", "direct"]
Skip = Annotated[
    str,
    arg(
        metavar="STAGES",
        help_behavior_hint=default_shown,
        help="Stages to leave out, any but assemble, comma separated without spaces: "
        f"{','.join(options.SKIPPABLE)}. Without align, align-objects, separate or settle, refine is left out too; "
        "without settle, close and coarsen too.",
    ),
]
Ignore = Annotated[
    str,
    arg(
        metavar="PARTS",
        help_behavior_hint=default_shown,
        help="Parts to treat as absent, of an input folder only, comma separated without spaces: "
        f"{','.join(options.PARTS)}.",
    ),
]
NormalAxes = Annotated[str, arg(metavar="AXES", help_behavior_hint=default_shown)]
Formats = Annotated[str, arg(metavar="FORMATS", help_behavior_hint=default_shown)]
Axes = Annotated[
    str,
    arg(
        metavar="AXES",
        help="How assets of an input folder are read: "
        f"{', '.join(options.ASSET_FRAMES)}. "
        "Or by axes of their own, as +x-y-z, or by a convention of poses.json, as wxyz/row/+x-z+y/pytorch3d.",
    ),
]
MaybePixels = Annotated[float | None, arg(metavar="PX", help_behavior_hint=default_shown)]
MaybeMillimetres = Annotated[float | None, arg(metavar="MM", help_behavior_hint=default_shown)]
MaybeMetres = Annotated[float | None, arg(metavar="M", help_behavior_hint=default_shown)]
Known = Annotated[str, arg(metavar="NAME=METRES", help_behavior_hint=default_shown)]
Slow = Annotated[float, arg(metavar="FACTOR")]
Samples = Annotated[int, arg(metavar="N", help_behavior_hint=lambda v: "" if v == "0" else f"(default: {v})")]


def names_in(text: str) -> list[str]:
    """The names in a text, comma separated."""
    return [name.strip() for name in text.split(",") if name.strip()]
