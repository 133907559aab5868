"""A folder of input files: paths that stay inside, digests of what was read, decisions taken while reading."""

from __future__ import annotations

import hashlib
import os
import unicodedata
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import BaseModel, ValidationError

from f3sr.errors import InputError, printable, reason
from f3sr.files import strict_json
from f3sr.files.limited_file import MAX_FILE_BYTES, MAX_JSON_BYTES, opened
from f3sr.report import Decision

INPUT_FOLDER = "a folder with image.png|jpg and masks/*.png"
"""What is accepted where a prompted-image folder is asked for."""
MAX_PATH = 500
"""Longest path in a document, in characters: what messages can show and file systems hold."""

M = TypeVar("M", bound=BaseModel)


class InputFolder:
    """Opens files of one folder by relative path and remembers what it read.

    ``digests`` has the sha256 of every file read, by its path relative to ``root``; ``decisions`` are for the user.
    Raises InputError for a root that is no readable folder."""

    def __init__(self, root: Path, *, accepted: str = INPUT_FOLDER) -> None:
        try:
            if not root.is_dir():
                raise InputError(root, found="a file" if root.exists() else "nothing there", accepted=accepted)
            next(root.iterdir(), None)
        except (OSError, ValueError) as error:
            raise InputError(root, found=reason(error), accepted=accepted) from error
        self.root = root
        self.decisions: list[Decision] = []
        self.digests: dict[str, str] = {}

    def path(self, relative: str, *, base: str = "") -> Path:
        """A path of the folder, below ``base``. Raises InputError for one that leaves the folder, also through a
        link."""
        path = self.root / base / relative
        if len(relative) > MAX_PATH:
            found, accepted = f"a path of {len(relative)} characters", f"at most {MAX_PATH}"
            raise InputError(self.root / base, found=found, accepted=accepted)
        try:
            inside = not Path(relative).is_absolute() and path.resolve().is_relative_to(self.root.resolve())
        except (OSError, ValueError, RuntimeError) as error:  # NUL bytes, lone surrogates, loops of links
            raise InputError(
                self.root / base, found=f"the path {relative!r} that leads nowhere", accepted="a path inside it"
            ) from error
        if not inside:
            raise InputError(
                self.root / base, found=f"the path {relative!r} that leaves the folder", accepted="paths inside it"
            )
        return path

    def file(self, relative: str, *, base: str = "", most: int = MAX_FILE_BYTES) -> Path:
        """A readable file of the folder of at most ``most`` bytes, its sha256 noted. Raises InputError."""
        path = self.path(relative, base=base)
        with opened(path, most=most) as file:
            digest = hashlib.file_digest(cast(Any, file), "sha256").hexdigest()
        self.digests[path.relative_to(self.root).as_posix()] = digest
        return path

    def has(self, relative: str) -> bool:
        """Whether something of that name is there, be it a broken link."""
        return os.path.lexists(self.root / relative)

    def names(self, relative: str = "") -> list[str]:
        """The names in a folder, sorted, without hidden ones; empty when there is no such folder.

        Names become labels and files of the package, so each must be printable and unambiguous on every system.
        """
        place = self.path(relative)
        try:
            names = sorted(p.name for p in place.iterdir() if not p.name.startswith("."))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise InputError(place, found=reason(error), accepted="a readable folder") from error
        seen: dict[str, str] = {}
        for name in names:
            if not name.isprintable() or "\\" in name:
                raise InputError(place, found=f"the name {name!r}", accepted="printable names without backslash")
            key = unicodedata.normalize("NFC", name).casefold()
            if key in seen:
                found = f"{seen[key]} and {name}"
                raise InputError(place, found=found, accepted="names that differ by more than upper and lower case")
            seen[key] = name
        return names

    def document(self, relative: str, model: type[M]) -> M:
        """A JSON file, validated by ``model``. Raises InputError with the first thing that is wrong."""
        path = self.file(relative, most=MAX_JSON_BYTES)
        value = strict_json.read(path)
        try:
            return model.model_validate(value)
        except ValidationError as error:
            found, accepted = strict_json.problem(error, ", ".join(model.model_fields))
            raise InputError(path, found=found, accepted=accepted) from error

    def decide(self, choice: str, reason: str, about: int | None = None, *, fallback: bool = False) -> None:
        """Note a decision, ``about`` an object's id or the whole folder, with what terminals cannot print left out."""
        self.decisions.append(
            Decision(choice=printable(choice), reason=printable(reason), about=about, fallback=fallback)
        )
