"""What a project's folder holds, as pages are told of it: its state, its rollouts, files to be shown or downloaded."""

from __future__ import annotations

import hashlib
import re
import stat
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, Any, cast

from f3sr.errors import F3srError, InputError
from f3sr.files import strict_json
from f3sr.goals.file_names import FILM, PLAN, STRIP, VERDICT
from f3sr.scene_package.package import SCENE
from f3sr.studio.workspace import Project

MAX_JSON = 20_000_000
"""Bytes of a verdict or a plan."""
ROOTS = ("package", "rollouts", "certificate")
"""Folders of a project whose files pages may show."""
PIECE = 1 << 18
"""Bytes of a file that are read at a time."""


@dataclass(frozen=True)
class ProjectFiles:
    """One project's files. What is damaged is told as absent: its stage says why when it is made again."""

    project: Project

    @property
    def masks(self) -> int:
        """How many objects are outlined."""
        with suppress(OSError):
            return sum(file.suffix == ".png" for file in (self.project.input / "masks").iterdir())
        return 0

    @property
    def version(self) -> str:
        """Changes with the scene."""
        try:
            status = (self.project.package / SCENE).stat()
        except OSError:
            return ""
        return f"{status.st_mtime_ns:x}-{status.st_size:x}"

    def summary(self) -> dict[str, Any]:
        """For the list of projects."""
        project = self.project
        if project.problem:
            return {"id": project.id, "name": project.id, "state": "damaged", "problem": project.problem}
        state = "scene" if self.version else "outlined" if self.masks else "photo"
        return {
            "id": project.id,
            "name": project.name,
            "created": project.created,
            "state": state,
            "picture": True,
            "rollouts": len(self._numbers()),
        }

    def state(self) -> dict[str, Any]:
        """For the project's page."""
        project = self.project
        return {
            "id": project.id,
            "name": project.name,
            "photo": project.photo is not None,
            "masks": self.masks,
            "outlined": self.masks > 0,
            "scene": bool(self.version),
            "version": self.version,
            "options": project.options,
            "outdated": bool(self.version) and project.outlines_changed.exists(),
            "remarks": list(project.remarks),
            "segmenter": project.segmenter,
            "exported": project.exported.is_dir(),
            "certified": project.certificate.is_dir(),
        }

    def rollouts(self) -> list[dict[str, Any]]:
        """What was played, the last first."""
        return [told for number in reversed(self._numbers()) if (told := self._rollout(number))]

    def strip(self, number: int) -> Path:
        """The key frames of a rollout. Raises InputError where it has none."""
        return self.inside(f"rollouts/{number}/{STRIP}")

    def film(self, number: int) -> Path:
        """The film of a rollout. Raises InputError where it has none."""
        return self.inside(f"rollouts/{number}/{FILM}")

    def inside(self, path: str) -> Path:
        """A file that pages may show. Raises InputError for any other path, and for links out of the project."""
        wanted = InputError("the file", found=path[:100], accepted=f"a file in {', '.join(ROOTS)}")
        if path.partition("/")[0] not in ROOTS or "\0" in path or len(path) > 500:
            raise wanted
        try:
            full = (self.project.folder / path).resolve()
            root = (self.project.folder / path.partition("/")[0]).resolve()
            if not full.is_relative_to(root) or root.parent != self.project.folder.resolve():
                raise wanted
            if not stat.S_ISREG(full.stat().st_mode):
                raise wanted
        except (OSError, ValueError, RuntimeError):
            raise wanted from None
        return full

    def zipped(self, name: str) -> tuple[str, Iterator[bytes]]:
        """A file's name, and the bytes of a ZIP file of the package with its rollouts, or of its export."""
        places = {
            "package": ({"": self.project.package, "rollouts": self.project.rollouts}, "scene"),
            "export": ({"": self.project.exported}, "export"),
        }
        if name not in places or not next(iter(places[name][0].values())).is_dir():
            raise InputError("the download", found=name[:40], accepted="a package or an export that is there")
        folders, ending = places[name]
        plain = re.sub(r"[^A-Za-z0-9_.-]+", "_", self.project.name).strip("._-") or "scene"
        return f"{plain}_{ending}.zip", _zip(folders)

    def _numbers(self) -> list[int]:
        with suppress(OSError):
            names = [entry.name for entry in self.project.rollouts.iterdir()]
            return sorted(int(n) for n in names if re.fullmatch(r"[1-9][0-9]{0,5}", n))
        return []

    def _rollout(self, number: int) -> dict[str, Any] | None:
        place = self.project.rollouts / str(number)
        try:
            plan = strict_json.read(place / PLAN, most=MAX_JSON, accepted="a plan")
            verdict = strict_json.read(place / VERDICT, most=MAX_JSON, accepted="a verdict")
            goal, met, said = str(plan["goal"]), verdict["met"] is True, str(verdict.get("said", ""))
        except (F3srError, OSError, KeyError, TypeError):
            return None
        told = {"number": number, "goal": goal, "met": met, "said": said, "film": (place / FILM).is_file()}
        return told | {"stale": plan.get("scene") != self._sha, "variation": self._variation(number)}

    @cached_property
    def _sha(self) -> str:
        """Of the package's scene.json: a plan belongs to one."""
        try:
            return hashlib.sha256((self.project.package / SCENE).read_bytes()).hexdigest()
        except OSError:
            return ""

    def _variation(self, number: int) -> dict[str, float] | None:
        """How a rollout's launch differs from that of the one it was made from."""
        try:
            tree = strict_json.read(self.project.rollouts / f"{number}.json", most=1000, accepted="a variation")
            return {"speed": float(tree["speed"]), "turn": float(tree["turn"])}
        except (F3srError, OSError, KeyError, TypeError, ValueError):
            return None


def _zip(folders: dict[str, Path]) -> Iterator[bytes]:
    """A ZIP file of folders by their name in it, piece by piece: no copy of a large package on a full disk."""
    pieces = _Pieces()
    with zipfile.ZipFile(cast(IO[bytes], pieces), "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        for inside, folder in folders.items():
            for file in sorted(folder.rglob("*")):
                if file.is_symlink() or not file.is_file():
                    continue
                with archive.open(Path(inside, file.relative_to(folder)).as_posix(), "w", force_zip64=True) as entry:
                    for piece in _read(file):
                        entry.write(piece)
                        yield from pieces.taken()
    yield from pieces.taken()


def _read(file: Path) -> Iterator[bytes]:
    with file.open("rb") as opened:
        while piece := opened.read(PIECE):
            yield piece


class _Pieces:
    """What a ZIP file writes, until it is taken: a stream that cannot go back."""

    def __init__(self) -> None:
        self._parts = list[bytes]()

    def write(self, data: Any) -> int:
        self._parts.append(bytes(data))
        return len(data)

    def flush(self) -> None:
        pass

    def taken(self) -> Iterator[bytes]:
        parts, self._parts = self._parts, []
        yield from parts
