"""f3sr: one photo with object masks in, a 3-D scene that a physics engine can run out.

Names are loaded on first use, so that ``import f3sr`` stays light.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "ASSET_GENERATORS": "f3sr.lifting.generators",
    "BACKGROUND_COMPLETERS": "f3sr.background.completers",
    "Backend": "f3sr.backends.registry",
    "DETECTORS": "f3sr.segmentation.segmenters",
    "EXPORTERS": "f3sr.exporters.protocol",
    "ExportedObject": "f3sr.exporters.exported_scene",
    "ExportedScene": "f3sr.exporters.exported_scene",
    "EditSession": "f3sr.edits.edit_session",
    "Exporter": "f3sr.exporters.protocol",
    "Fillers": "f3sr.io.inputs",
    "GEOMETRY_ESTIMATORS": "f3sr.metrology.estimators",
    "GROUND": "f3sr.scene",
    "GROUND_SEGMENTERS": "f3sr.segmentation.segmenters",
    "LANGUAGES": "f3sr.play.languages",
    "SCENE_GRAPHERS": "f3sr.backends.kinds",
    "SEGMENTERS": "f3sr.segmentation.segmenters",
    "Camera": "f3sr.core.camera",
    "Config": "f3sr.pipeline_config",
    "F3srError": "f3sr.errors",
    "FilmConfig": "f3sr.film.studio",
    "InputError": "f3sr.errors",
    "Inputs": "f3sr.io.inputs",
    "NORMAL_ESTIMATORS": "f3sr.metrology.estimators",
    "Mesh": "f3sr.core.mesh",
    "OutputError": "f3sr.errors",
    "Package": "f3sr.scene_package.package",
    "PlanError": "f3sr.goals.checks",
    "Played": "f3sr.play.goal_loop",
    "Refusal": "f3sr.goals.refusal",
    "Reconstruction": "f3sr.pipeline",
    "Scene": "f3sr.scene",
    "SceneObject": "f3sr.scene",
    "Store": "f3sr.runtime.result_store",
    "Studio": "f3sr.film.studio",
    "certify": "f3sr.certificate.certification",
    "deliver": "f3sr.delivery",
    "evaluate": "f3sr.stages.evaluate",
    "example": "f3sr.example",
    "export_package": "f3sr.scene_export",
    "film_played": "f3sr.film.studio",
    "load": "f3sr.scene_package.package",
    "read_edits": "f3sr.edits.edit_list",
    "read_inputs": "f3sr.photo_inputs",
    "read_package": "f3sr.scene_package.package",
    "reconstruct": "f3sr.pipeline",
    "replay_plan": "f3sr.play.goal_loop",
    "sample_scenes": "f3sr.scene_samples",
    "simulate_goal": "f3sr.play.goal_loop",
    "success_rate": "f3sr.play.sample_rollouts",
    "write_edited": "f3sr.edits.edited_files",
    "write_film": "f3sr.play.rollout_folder",
    "write_package": "f3sr.scene_package.package",
    "write_played": "f3sr.play.rollout_folder",
}

__all__ = ["__version__", *sorted(_PUBLIC)]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'f3sr' has no attribute {name!r}; it has {', '.join(sorted(_PUBLIC))}")
    module = importlib.import_module(_PUBLIC[name])
    return module if module.__name__ == f"f3sr.{name}" else getattr(module, name)


def __dir__() -> list[str]:
    return sorted(__all__)
