"""f3sr: one photo with object masks in, a 3-D scene that a physics engine can run out.

Names are loaded on first use, so that ``import f3sr`` stays light.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "read_inputs": "f3sr.inputs",
    "InputError": "f3sr.errors",
    "Config": "f3sr.pipeline",
    "reconstruct": "f3sr.pipeline",
    "read_package": "f3sr.package",
    "write_package": "f3sr.package",
    "evaluate": "f3sr.stages.evaluate",
    "Camera": "f3sr.frames",
    "Mesh": "f3sr.mesh",
    "Scene": "f3sr.scene",
    "SceneObject": "f3sr.scene",
}

__all__ = ["__version__", *sorted(_PUBLIC)]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'f3sr' has no attribute {name!r}; it has {', '.join(sorted(_PUBLIC))}")
    return getattr(importlib.import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
