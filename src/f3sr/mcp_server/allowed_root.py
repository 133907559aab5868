"""The one folder that agents may read and write in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from f3sr.errors import InputError, cut


@dataclass(frozen=True)
class AllowedRoot:
    """A folder, resolved; every path of an agent is relative to it and stays in it, links followed."""

    folder: Path

    @classmethod
    def of(cls, folder: Path) -> AllowedRoot:
        """Raises InputError for what is no folder."""
        if not folder.is_dir():
            raise InputError(folder, found="no folder", accepted="an existing folder for --root")
        return cls(folder.resolve())

    def inside(self, path: str) -> Path:
        """The full path of what an agent names. Raises InputError where it leads out of the folder, or is none."""
        accepted = "a relative path inside the root folder, with forward slashes"
        if not path or "\0" in path or len(path) > 1000 or Path(path).is_absolute():
            raise InputError("path", found=cut(repr(path[:100])), accepted=accepted)
        try:
            full = (self.folder / path).resolve()
        except (OSError, RuntimeError):  # a name too long, links in a circle
            raise InputError("path", found=cut(repr(path[:100])), accepted=accepted) from None
        if full == self.folder or not full.is_relative_to(self.folder):
            raise InputError("path", found=cut(repr(path[:100])), accepted=accepted)
        return full

    def shown(self, path: Path) -> str:
        """A path as agents name it."""
        return path.resolve().relative_to(self.folder).as_posix()
