"""A folder that its command replaces only as it was written: a note in it keeps the SHA-256 of every other file."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from f3sr.errors import InputError, OutputError
from f3sr.files import strict_json
from f3sr.runtime.atomic_folder import Claim, check, claimed


@dataclass(frozen=True, kw_only=True)
class FolderNote:
    """A JSON file that tells who wrote the folder around it, and what: ``files`` are digests by name."""

    name: str
    """As "import.json"."""
    writer: str
    """The command, as "f3sr import"."""

    @contextmanager
    def writing(self, out: Path) -> Generator[NotedFolder]:
        """The right to write the folder ``out``, a full path. Raises OutputError where ``check`` does."""
        with claimed(out, self._require_unchanged) as claim:
            yield NotedFolder(claim, self.name)

    def check(self, out: Path) -> Path:
        """``out``. Raises OutputError unless there is nothing, or what the command wrote, as it was written."""
        return check(out, self._require_unchanged)

    def _require_unchanged(self, out: Path) -> None:
        if not os.path.lexists(out) or (out.is_dir() and not any(out.iterdir())):
            return
        written = self._written(out / self.name) if out.is_dir() else None
        if written is None:
            accepted = f"a new or empty folder, or one whose {self.name} tells what {self.writer} wrote"
            raise OutputError(f"{out}: found {contents_of(out)}; accepted: {accepted}")
        there = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_symlink() or not p.is_dir()}
        if strangers := sorted(there - written.keys() - {self.name}):
            raise OutputError(f"{out}: holds {strangers[0]}, which {self.writer} did not write; move it away first")
        for name, digest in written.items():
            if name not in there or _digest(out / name) != digest:
                changed = f"{name} was changed or removed since {self.writer} wrote it"
                raise OutputError(f"{out}: {changed}; give another folder")

    def _written(self, note: Path) -> dict[str, str] | None:
        """SHA-256 of the files that a note tells of, by name; None where it is none of this version."""
        if note.is_symlink() or not note.is_file():
            return None
        try:
            tree = strict_json.read(note, accepted=f"what {self.writer} wrote")
        except InputError:
            return None
        files = tree.get("files") if isinstance(tree, dict) else None
        return {str(name): str(digest) for name, digest in files.items()} if isinstance(files, dict) else None


@dataclass(eq=False)
class NotedFolder:
    """Such a folder while it is written."""

    claim: Claim
    note: str
    files: dict[str, str] = field(default_factory=dict[str, str])
    """SHA-256 of what was written, by name."""

    def write(self, name: str, data: bytes) -> None:
        self.claim.write(name, data)
        self.files[name] = hashlib.sha256(data).hexdigest()

    def end(self, note: Callable[[dict[str, str]], bytes]) -> None:
        """Write the note, which is made of ``files``, and put the folder into its place."""
        self.claim.write(self.note, note(self.files))
        self.claim.replace()


def contents_of(place: Path) -> str:
    """What is there, in a few words."""
    if not place.is_dir():
        return "a file"
    names = sorted(p.name for p in place.iterdir())
    return f"a folder with {', '.join(names[:3])}{', ...' if len(names) > 3 else ''}"


def _digest(file: Path) -> str:
    if file.is_symlink() or not file.is_file():
        return ""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()
