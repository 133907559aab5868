"""Third parties' packages, installed as pip leaves them: modules beside a .dist-info with METADATA and entry points."""

from __future__ import annotations

import importlib
import textwrap
from collections.abc import Mapping
from pathlib import Path

import pytest


def install(
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    *,
    module: str,
    source: str,
    points: Mapping[str, Mapping[str, str]],
    name: str = "foreign",
    version: str = "1.0",
) -> None:
    """Write a package of one module and put its place on the path; ``points``: targets by name, by group."""
    place.mkdir(exist_ok=True)
    (place / f"{module}.py").write_text(textwrap.dedent(source))
    info = place / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = [line for group, of in points.items() for line in (f"[{group}]", *(f"{k} = {v}" for k, v in of.items()))]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    monkeypatch.syspath_prepend(str(place))
    importlib.invalidate_caches()
