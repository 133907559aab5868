"""What a user may choose: back ends, formats and engines, and which of them work on this machine."""

from __future__ import annotations

import re
import shlex
import shutil
from importlib import metadata
from typing import Any

from f3sr.backends.registry import Found, Kind
from f3sr.background.completers import BACKGROUND_COMPLETERS, DEFAULT_COMPLETER
from f3sr.certificate.clients_table import CLIENTS, Client
from f3sr.exporters.protocol import EXPORTERS
from f3sr.lifting.generators import ASSET_GENERATORS
from f3sr.metrology.estimators import GEOMETRY_ESTIMATORS
from f3sr.segmentation.segmenters import SEGMENTERS

KINDS: dict[str, tuple[Kind[Any], tuple[str, ...]]] = {
    "segmenters": (SEGMENTERS, ()),
    "geometry": (GEOMETRY_ESTIMATORS, ()),
    "assets": (ASSET_GENERATORS, ()),
    "background": (BACKGROUND_COMPLETERS, (DEFAULT_COMPLETER,)),
    "formats": (EXPORTERS, ()),
}
"""Kinds of back ends with the names that go without saying."""


FOR = {
    "usd": "Isaac Sim, Omniverse",
    "urdf": "PyBullet, ROS",
    "sdf": "Gazebo, Drake",
    "mjcf": "MuJoCo, a file an object",
    "robosuite": "robosuite's objects",
    "glb": "any viewer",
}
"""Formats and who reads them."""


def choices() -> dict[str, list[dict[str, Any]]]:
    """By kind: name, whether its needs are ``met`` here, and what was ``found``."""
    found = {
        name: [_told(offer) for offer in kind.examined() if offer.name not in known]
        for name, (kind, known) in KINDS.items()
    }
    return found | {"engines": [_engine(client) for client in CLIENTS.values()]}


def _told(offer: Found) -> dict[str, Any]:
    missing = [f"{need.what}: {need.found}" for need in offer.needs if not need.met]
    problems = [offer.problem] if offer.problem else missing
    return {"name": offer.name, "met": not problems, "found": "; ".join(problems) or FOR.get(offer.name, "")}


def _engine(client: Client) -> dict[str, Any]:
    """Other environments may have more: ``f3sr certify --python`` asks those."""
    there = shutil.which("node") is not None if client.runs_in_node else _is_installed(client.install)
    return {"name": client.name, "met": there, "found": client.title if there else f"not here: {client.install}"}


def _is_installed(command: str) -> bool:
    """Whether the first package that an install command names is there."""
    package = re.split(r"[\[=<>~!]", shlex.split(command)[2])[0]
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        return False
    return True
