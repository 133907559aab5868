"""A static page of a dataset: a thumbnail and the main measures of every scene, and the reason of every failure.

The page is a folder: ``index.html`` and small pictures beside it, which browsers load as they come into view. It opens
from disk without a server.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from f3sr.dataset.layout import PACKAGE_FOLDER, Dataset, scene_of
from f3sr.dataset.row_selection import selected
from f3sr.dataset.storage import LocalStorage
from f3sr.dataset.summary import grouped, told
from f3sr.errors import OutputError
from f3sr.runtime import atomic_folder
from f3sr.web.document import WEB, document

HERE = Path(__file__).parent
PAGE, PICTURES = "index.html", "pictures"
SOURCES = ("pictures/overlay_after.png", "photo.png")
"""Files of a package that a thumbnail is made of: the first that is there."""
WIDTH, HEIGHT = 320, 240
"""Largest thumbnail [pixels]."""
SHOWN = ("n", "mIoU_visible", "K_max_J", "D_max_cm", "gap_pct", "proxy_far_pct", "cpu_s", "goals_met")
"""Measures of a scene on the page; the page sorts by them."""
Goal = tuple[str, str, str]
"""Goal, state and reason."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneCard:
    """A scene on the page."""

    name: str
    status: str
    reason: str
    """Of a failure, with paths relative to ``source``."""
    source: str
    labels: str
    """Of its objects."""
    picture: str
    """Relative path; empty where there is none."""
    report: str
    """Relative path of report.html; empty where there is none."""
    values: Sequence[tuple[str, float, str]]
    """Name, value and text of the measures that are known."""
    goals: Sequence[Goal]


def write_sheet(dataset: Dataset, out: Path, where: Sequence[str] = ()) -> Path:
    """Write the page of the scenes that meet every condition to a folder; returns the path of its page.

    An older page there is replaced. Raises OutputError if the folder holds anything else.
    """
    out = out.absolute()
    rows = selected(dataset, where).to_pylist()
    goals, labels = _goals(dataset), _labels(dataset)
    with atomic_folder.claimed(out, _require_sheet) as claim:
        cards: list[SceneCard] = []
        for row in rows:
            picture = _thumbnail(dataset, row)
            if picture:
                claim.write(f"{PICTURES}/{row['key']}.jpg", picture)
            cards.append(
                _card(dataset, row, goals.get(row["name"], []), labels.get(row["name"], []), bool(picture), out)
            )
        claim.write(PAGE, _page(cards, where, dataset))
        claim.replace()
    return out / PAGE


def _page(cards: Sequence[SceneCard], where: Sequence[str], dataset: Dataset) -> bytes:
    values = {
        "cards": cards,
        "columns": SHOWN,
        "where": " and ".join(where),
        "title": Path(dataset.storage.place).name,
        "overlays": any(card.picture for card in cards),
        "reasons": grouped(card.reason for card in cards if card.reason),
        "counts": {state: sum(c.status == state for c in cards) for state in sorted({c.status for c in cards})},
    }
    styles, scripts = (WEB / "page.css", HERE / "sheet.css"), (HERE / "sheet.js",)
    return document(HERE / "templates" / "sheet.html", values, styles=styles, scripts=scripts, pictures=True)


def _card(
    dataset: Dataset, row: dict[str, Any], goals: list[Goal], labels: list[str], pictured: bool, out: Path
) -> SceneCard:
    return SceneCard(
        name=row["name"],
        status=row["status"],
        reason=told(row),
        source=row["source"] or "",
        labels=", ".join(labels),
        picture=f"{PICTURES}/{row['key']}.jpg" if pictured else "",
        report=_report(dataset, row, out),
        values=[(name, float(row[name]), _shown(name, row)) for name in SHOWN if row[name] is not None],
        goals=goals,
    )


def _shown(name: str, row: dict[str, Any]) -> str:
    if name == "goals_met":
        return f"{row[name]} of {row['goals']}" if row["goals"] else "no goals"
    return f"{row[name]:.4g}"


def _report(dataset: Dataset, row: dict[str, Any], out: Path) -> str:
    """The way from the page to a package's report, where both are local."""
    if not row["package"] or not isinstance(dataset.base, LocalStorage):
        return ""
    report = dataset.base.folder / scene_of(row["key"]) / PACKAGE_FOLDER / "report.html"
    return Path(os.path.relpath(report, out)).as_posix() if report.exists() else ""


def _goals(dataset: Dataset) -> dict[str, list[Goal]]:
    """Goals with state and reason, by the name of their scene."""
    found: dict[str, list[Goal]] = {}
    for row in selected(dataset, (), "goal").select(["name", "goal", "state", "goal_reason"]).to_pylist():
        found.setdefault(row["name"], []).append((row["goal"] or "", row["state"] or "", row["goal_reason"] or ""))
    return found


def _labels(dataset: Dataset) -> dict[str, list[str]]:
    """Labels of objects, by the name of their scene."""
    found: dict[str, list[str]] = {}
    for row in selected(dataset, (), "object").select(["name", "label"]).to_pylist():
        found.setdefault(row["name"], []).append(row["label"] or "")
    return found


def _thumbnail(dataset: Dataset, row: dict[str, Any]) -> bytes:
    """A small JPEG of a scene; nothing where it has no picture that can be read."""
    if not row["package"]:
        return b""
    with dataset.package(row["key"]) as package:
        return next(filter(None, (_shrunk(package / name) for name in SOURCES)), b"")


def _shrunk(file: Path) -> bytes:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(file) as picture:
            small = picture.convert("RGB")
            small.thumbnail((WIDTH, HEIGHT))
    except (OSError, ValueError, UnidentifiedImageError, Image.DecompressionBombError):
        return b""
    data = io.BytesIO()
    small.save(data, "JPEG", quality=80)
    return data.getvalue()


def _require_sheet(out: Path) -> None:
    names = {p.name for p in _entries(out)}
    if strangers := sorted(names - {PAGE, PICTURES}):
        raise OutputError(f"{out}: holds {strangers[0]}, which is no page of a dataset; give another folder")


def _entries(out: Path) -> Iterator[Path]:
    if out.is_dir():
        yield from out.iterdir()
    elif out.exists():
        raise OutputError(f"{out}: is a file; give a folder")
