"""A folder of input files: paths that stay inside, digests of what was read, decisions taken while reading."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from f3sr.errors import InputError
from f3sr.report import Decision

M = TypeVar("M", bound=BaseModel)


class InputFolder:
    """Opens files of one folder by relative path and remembers what it read."""

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            found = "a file" if root.exists() else "nothing there"
            raise InputError(root, found=found, accepted="a folder with image.png|jpg and masks/*.png")
        self.root = root
        self.decisions: list[Decision] = []
        self.digests: dict[str, str] = {}

    def path(self, relative: str, *, base: str = "") -> Path:
        """A path of the folder; one that leaves it is refused."""
        path = self.root / base / relative
        try:
            inside = not Path(relative).is_absolute() and path.resolve().is_relative_to(self.root.resolve())
        except (OSError, ValueError, RuntimeError) as error:  # NUL bytes, lone surrogates, loops of links
            raise InputError(self.root / base, found=f"the path {relative!r}", accepted="a usable path") from error
        if not inside:
            raise InputError(
                self.root / base, found=f"the path {relative!r} that leaves the folder", accepted="paths inside it"
            )
        return path

    def file(self, relative: str, *, base: str = "") -> Path:
        """A readable file of the folder, its sha256 noted."""
        path = self.path(relative, base=base)
        try:
            if path.exists() and not path.is_file():
                raise InputError(path, found="no regular file", accepted="a readable file")
            data = path.read_bytes()
        except OSError as error:
            raise InputError(path, found=error.strerror or "unreadable", accepted="a readable file") from error
        self.digests[path.relative_to(self.root).as_posix()] = hashlib.sha256(data).hexdigest()
        return path

    def has(self, relative: str) -> bool:
        return (self.root / relative).exists()

    def document(self, relative: str, model: type[M]) -> M:
        """A JSON file, validated."""
        path = self.file(relative)
        try:
            value = json.loads(path.read_text("utf-8"))
        except (ValueError, RecursionError) as error:
            raise InputError(path, found=f"no valid JSON ({error})", accepted="a JSON document") from error
        try:
            return model.model_validate(value)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(p) for p in first["loc"]) or "the document"
            accepted = f"an object with {', '.join(model.model_fields)}"
            raise InputError(path, found=f"{where}: {first['msg']}", accepted=accepted) from error

    def decide(self, choice: str, reason: str, about: int | None = None, *, fallback: bool = False) -> None:
        self.decisions.append(Decision(choice=choice, reason=reason, about=about, fallback=fallback))
