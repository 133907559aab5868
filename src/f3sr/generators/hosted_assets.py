"""Hosted services as generators: the meshes of each, posed in the photo (docs: hosted)."""

from __future__ import annotations

from f3sr.generators.posed_assets import PosedMaker
from f3sr.hosted.mesh_producers import ProducerMaker
from f3sr.hosted.services import SERVICES

_MAKERS = {s.name.replace("-", "_"): PosedMaker(ProducerMaker(s)) for s in SERVICES}


def __getattr__(name: str) -> PosedMaker:
    """The maker of a service, its name with underscores."""
    if name not in _MAKERS:
        raise AttributeError(f"module {__name__} has no {name}")
    return _MAKERS[name]
