"""What a user may choose: back ends, formats and engines, and which of them work on this machine."""

from __future__ import annotations

from typing import Any

from f3sr.backends.registry import Kind
from f3sr.background.completers import BACKGROUND_COMPLETERS, DEFAULT_COMPLETER
from f3sr.certificate.clients_table import CLIENTS
from f3sr.exporters.protocol import EXPORTERS
from f3sr.lifting.generators import ASSET_GENERATORS
from f3sr.metrology.estimators import GEOMETRY_ESTIMATORS

KINDS: dict[str, tuple[Kind[Any], tuple[str, ...]]] = {
    "geometry": (GEOMETRY_ESTIMATORS, ()),
    "assets": (ASSET_GENERATORS, ()),
    "background": (BACKGROUND_COMPLETERS, (DEFAULT_COMPLETER,)),
    "formats": (EXPORTERS, ()),
}
"""Kinds of back ends with the names that go without saying."""


def choices() -> dict[str, list[dict[str, Any]]]:
    """By kind: name, whether its needs are ``met`` here, and what was ``found``."""
    found = {
        name: [_told(one) for one in kind.examined() if one.name not in known] for name, (kind, known) in KINDS.items()
    }
    return found | {"engines": [{"name": name, "met": True, "found": ""} for name in CLIENTS]}


def _told(offer: Any) -> dict[str, Any]:
    missing = [f"{need.what}: {need.found}" for need in offer.needs if not need.met]
    problems = [offer.problem] if offer.problem else missing
    return {"name": offer.name, "met": not problems, "found": "; ".join(problems)}
