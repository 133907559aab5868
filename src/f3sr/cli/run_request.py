"""What the options of a run ask for, checked as far as they can be before its folder is read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from f3sr.errors import InputError
from f3sr.runtime.kept_imports import kept_imports

if TYPE_CHECKING:
    from f3sr.backends.model_choice import ModelChoice
    from f3sr.backends.protocols import BackgroundCompleter
    from f3sr.backends.registry import Backend, Kind
    from f3sr.edits.edit_list import Edit
    from f3sr.io.inputs import Fillers
    from f3sr.io.photo_hints import PhotoHints
    from f3sr.pipeline import Config

P = TypeVar("P")


@dataclass(frozen=True, eq=False, kw_only=True)
class RunRequest:
    """Settings, back ends, and what the user knows of the photo."""

    config: Config
    fillers: Fillers
    background: Backend[BackgroundCompleter] | None
    hints: PhotoHints
    edits: Sequence[Edit] | None

    def require_ready(self) -> None:
        """Raise InputError where a back end lacks a package, weights, a command or a key."""
        f = self.fillers
        for backend in (f.geometry, f.normals, f.assets, f.scene_graph, f.labels, self.background):
            if backend is not None:
                backend.require_ready()


def requested(
    *,
    choice: ModelChoice,
    geometry: str | None = None,
    normals: str | None = None,
    assets: str | None = None,
    scene_graph: str | None = None,
    labels: str | None = None,
    background: str | None = None,
    focal: float | None = None,
    focal_35mm: float | None = None,
    camera_height: float | None = None,
    known: str = "",
    config: Path | None = None,
    edits: Path | None = None,
) -> RunRequest:
    """Options as the command line gives them. Raises InputError, BackendError."""
    with kept_imports():
        from f3sr import pipeline, settings
        from f3sr.backends.kinds import LABELERS, SCENE_GRAPHERS
        from f3sr.background.completers import BACKGROUND_COMPLETERS, DEFAULT_COMPLETER
        from f3sr.edits.edit_list import read_edits
        from f3sr.io.inputs import Fillers
        from f3sr.io.photo_hints import PhotoHints, known_of
        from f3sr.lifting.generators import ASSET_GENERATORS
        from f3sr.metrology.estimators import GEOMETRY_ESTIMATORS, NORMAL_ESTIMATORS
    wanted = read_edits(edits) if edits else None
    chosen = settings.read(config, pipeline.Config()) if config else pipeline.Config()
    if choice.axes and normals is None:
        raise InputError("--normals-axes", found=choice.axes, accepted="together with --normals")
    return RunRequest(
        config=chosen,
        fillers=Fillers(
            geometry=_backend(GEOMETRY_ESTIMATORS, geometry, choice),
            normals=_backend(NORMAL_ESTIMATORS, normals, choice),
            assets=_backend(ASSET_GENERATORS, assets, choice),
            scene_graph=_backend(SCENE_GRAPHERS, scene_graph, choice),
            labels=_backend(LABELERS, labels, choice),
        ),
        background=_backend(BACKGROUND_COMPLETERS, background, choice) if background != DEFAULT_COMPLETER else None,
        hints=PhotoHints(focal=focal, focal_35mm=focal_35mm, camera_height=camera_height, known=known_of(known)),
        edits=wanted,
    )


def _backend(kind: Kind[P], name: str | None, choice: ModelChoice) -> Backend[P] | None:
    """The back end of a name, or of a model's spec as ``openai:NAME``, where a model can do that."""
    if name is None:
        return None
    if name.partition(":")[0] not in ("openai", "anthropic"):
        return kind.find(name, choice)
    from f3sr.agents import image_edit, photo_reader

    makers: dict[str, Callable[[str], Any]] = {
        "scene_graph": photo_reader.scene_grapher,
        "labels": photo_reader.labeler,
        "background": image_edit.image_edit,
    }
    if kind.name not in makers:
        raise InputError(f"--{kind.name}", found=name, accepted=f"a back end: {', '.join(kind.names()) or 'none yet'}")
    return makers[kind.name](name)
