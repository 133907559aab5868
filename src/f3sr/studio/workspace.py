"""The folder in which the studio keeps projects: each begins with a photo, a folder or a package.

Nothing outside the workspace is changed, and no name from outside becomes a path.
"""

from __future__ import annotations

import re
import secrets
import shutil
import time
import unicodedata
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr import example
from f3sr.errors import F3srError, InputError, OutputError, cut, reason
from f3sr.files import strict_json
from f3sr.io.input_folder import INPUT_FOLDER
from f3sr.runtime.atomic_file import write_whole
from f3sr.runtime.file_lock import is_taken
from f3sr.scene_package.package_folder import PACKAGE, is_package
from f3sr.segmentation.input_folder_writer import MASKS, MAX_PHOTO_BYTES, PNG, read_photo

PROJECTS, RECORD, LOCK = "projects", "project.json", "workspace.lock"
NEW, GONE = ".new-", ".gone-"
"""How folders begin that are being made or deleted: what a killed server leaves of them is taken away."""
ID = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
LONGEST_ID = 64
SLUG = 40
"""Characters of a name in an id."""
MOST_PROJECTS = 1000
MAX_RECORD = 100_000
"""Bytes of project.json."""
MAX_FILES, MAX_BYTES, MAX_DEPTH = 20_000, 20_000_000_000, 20
"""Files and folders of a folder that is copied, their bytes together, and how deep one lies in another."""
JPEG = b"\xff\xd8\xff"
EXAMPLE = "Example"

Origin = Literal["photo", "example", "input folder", "package", "import"]


class _ProjectRecord(BaseModel):
    """project.json."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    version: Literal[1] = 1
    name: Annotated[str, Field(min_length=1, max_length=200)]
    origin: Origin
    created: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    """Seconds since 1970."""
    photo: Literal["", "photo.png", "photo.jpg"] = ""
    options: dict[str, Any] = {}
    """Of the last run."""
    segmenter: Annotated[str, Field(max_length=200)] = ""
    """Back end that cuts objects out; empty for the default."""
    remarks: list[Annotated[str, Field(max_length=2000)]] = []
    """What was assumed when another program's folder was read."""


@dataclass(frozen=True)
class Project:
    """One project. ``problem`` says in a line why it cannot be read; it then has nothing but an id."""

    folder: Path
    name: str = ""
    created: float = 0.0
    photo: Path | None = None
    """The file that was uploaded; None where the project began with a folder."""
    options: dict[str, Any] = field(default_factory=dict[str, Any])
    remarks: tuple[str, ...] = ()
    segmenter: str = ""
    problem: str = ""

    @property
    def id(self) -> str:
        return self.folder.name

    @property
    def input(self) -> Path:
        return self.folder / "input"

    @property
    def package(self) -> Path:
        return self.folder / "package"

    @property
    def edits(self) -> Path:
        """The list of edits, as it grows: the package holds them too once it is written."""
        return self.folder / "edits.json"

    @property
    def outlines_changed(self) -> Path:
        """There while outlines were saved after the scene was made."""
        return self.folder / "outlines.changed"

    @property
    def rollouts(self) -> Path:
        """What was played. Not in the package: edits replace that, and films stay."""
        return self.folder / "rollouts"

    @property
    def jobs(self) -> Path:
        return self.folder / "jobs"

    @property
    def exported(self) -> Path:
        return self.folder / "export"

    @property
    def certificate(self) -> Path:
        return self.folder / "certificate"


class Workspace:
    """Projects of one folder. One server at a time has it."""

    def __init__(self, folder: Path) -> None:
        """Raises OutputError for a folder that cannot be made, or that another server has."""
        self.folder = Path(folder).absolute()
        try:
            (self.folder / PROJECTS).mkdir(parents=True, exist_ok=True)
            self._lock: IO[bytes] | None = (self.folder / LOCK).open("ab")
        except OSError as error:
            raise OutputError(f"{self.folder}: no workspace can be made there ({reason(error)})") from error
        if not is_taken(self._lock.fileno()):
            self._lock.close()
            raise OutputError(f"{self.folder}: another studio is open there; close it, or give --workspace")
        for left in (self.folder / PROJECTS).glob(".*"):
            if left.name.startswith((NEW, GONE)):
                shutil.rmtree(left, ignore_errors=True)

    def close(self) -> None:
        """Let another server have it."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def listed(self) -> list[Project]:
        """All projects, the newest first. One that cannot be read has its problem, and hides no other."""
        found = map(_read, filter(_is_project, (self.folder / PROJECTS).iterdir()))
        return sorted(found, key=lambda p: (-p.created, p.id))

    def project(self, id: str) -> Project:
        """A project by its id. Raises InputError where there is none, F3srError where it cannot be read."""
        return read_project(self._folder(id))

    def found(self, id: str) -> Project:
        """The same, also of one that cannot be read: it has its problem."""
        return _read(self._folder(id))

    def create_photo(self, name: str, data: bytes) -> Project:
        """A project that begins with a photo, of which ``data`` is the file. Raises InputError for what is no photo."""
        accepted = "a PNG or JPEG image"
        file = "photo.png" if data.startswith(PNG) else "photo.jpg" if data.startswith(JPEG) else ""
        if not file:
            raise InputError(cut(name), found="another kind of file" if data else "nothing", accepted=accepted)
        if len(data) > MAX_PHOTO_BYTES:
            raise InputError(cut(name), found=f"{len(data):,} bytes", accepted=f"at most {MAX_PHOTO_BYTES:,} bytes")
        with self._made(Path(name).stem, "photo", photo=file) as folder:
            (folder / file).write_bytes(data)
            try:
                read_photo(folder / file)
            except InputError as error:
                raise InputError(cut(name), found=error.found, accepted=error.accepted) from None
        return _read(self._at(folder))

    def create_example(self) -> Project:
        """A project of the bundled example."""
        return self._copied(EXAMPLE, "example", example.folder(), "input")

    def create_folder(self, source: Path) -> Project:
        """A project of a copy of an input folder or a package, or of what another program left (docs: importing).

        Raises InputError for anything else."""
        accepted = f"{INPUT_FOLDER}, {PACKAGE}, or what another program left"
        try:
            source = Path(source).expanduser().absolute()
            is_folder = source.is_dir()
        except (OSError, RuntimeError) as error:  # a name that is too long, the home of nobody
            raise InputError(source, found=reason(error), accepted=accepted) from error
        if not is_folder and source.suffix.lower() != ".glb":
            raise InputError(source, found="a file" if source.exists() else "nothing there", accepted=accepted)
        if self.folder.is_relative_to(source) or source.is_relative_to(self.folder):
            raise InputError(source, found="the workspace itself", accepted="a folder outside it")
        if is_package(source):
            return self._copied(source.name, "package", source, "package")
        if (source / MASKS).is_dir():
            return self._copied(source.name, "input folder", source, "input")
        return self._imported(source)

    def keep_options(self, project: Project, options: dict[str, Any]) -> None:
        """Remember the options of a run for the next one."""
        self._keep(project, options=options)

    def keep_segmenter(self, project: Project, name: str) -> None:
        """Remember which back end cuts objects out."""
        self._keep(project, segmenter=name)

    def _keep(self, project: Project, **changed: Any) -> None:
        record = _record(project.folder / RECORD).model_copy(update=changed)
        write_whole(project.folder / RECORD, record.model_dump_json(indent=1).encode())

    def delete(self, id: str) -> None:
        """Take a project away: first out of sight, then from the disk. Raises InputError where there is none."""
        folder = self._folder(id)
        gone = folder.with_name(f"{GONE}{id}-{secrets.token_hex(4)}")
        try:
            folder.rename(gone)
        except OSError as error:
            raise OutputError(f"{folder}: cannot be deleted ({reason(error)})") from error
        shutil.rmtree(gone, ignore_errors=True)

    def _folder(self, id: str) -> Path:
        """Of a project, damaged or not. Raises InputError where there is none."""
        if _is_id(id) and _is_project(folder := self.folder / PROJECTS / id):
            return folder
        raise InputError("the project", found=cut(repr(id[:80])), accepted="one of the workspace's")

    def _imported(self, source: Path) -> Project:
        from f3sr.importing.import_source import ImportSource
        from f3sr.importing.scene_import import import_output

        remarks = list[str]()
        with self._made(source.stem, "import", remarks=remarks) as folder:
            found = import_output(ImportSource(path=source), folder / "input")
            remarks += [f"read as {found.source}, masks {found.masks}, poses {found.poses}", *found.remarks]
            remarks += [f"left out: {item.label or item.id}; {item.reason}" for item in found.left_out]
        return _read(self._at(folder))

    def _copied(self, name: str, origin: Origin, source: Path, inside: str) -> Project:
        with self._made(name, origin) as folder:
            _copy(source, folder / inside)
        return _read(self._at(folder))

    @contextmanager
    def _made(self, name: str, origin: Origin, photo: str = "", remarks: Sequence[str] = ()) -> Generator[Path]:
        """A folder that becomes a project if the block ends well, and vanishes otherwise."""
        places = self.folder / PROJECTS
        if sum(map(_is_project, places.iterdir())) >= MOST_PROJECTS:
            raise OutputError(f"{places}: has {MOST_PROJECTS} projects; delete some")
        shown = _shown_name(name)
        folder = places / f"{NEW}{_slug(shown)}-{secrets.token_hex(4)}"
        try:
            folder.mkdir()
            yield folder
            known = {"name": shown, "origin": origin, "created": time.time(), "photo": photo}
            record = _ProjectRecord.model_validate({**known, "remarks": [cut(r) for r in remarks]})
            write_whole(folder / RECORD, record.model_dump_json(indent=1).encode())
            folder.rename(self._at(folder))
        except OSError as error:
            raise OutputError(f"{places}: no project can be made ({reason(error)})") from error
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _at(self, folder: Path) -> Path:
        """Where a folder that is being made ends."""
        return folder.with_name(folder.name.removeprefix(NEW))


def read_project(folder: Path) -> Project:
    """The project of a folder. Raises F3srError where it cannot be read."""
    project = _read(folder)
    if project.problem:
        raise F3srError(project.problem)
    return project


def _is_id(name: str) -> bool:
    return len(name) <= LONGEST_ID and ID.fullmatch(name) is not None


def _is_project(folder: Path) -> bool:
    """A link may lead anywhere, so it is none."""
    return _is_id(folder.name) and folder.is_dir() and not folder.is_symlink()


def _slug(name: str) -> str:
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    return re.sub(r"[^a-z0-9]+", "-", plain).strip("-")[:SLUG].strip("-") or "scene"


def _shown_name(name: str) -> str:
    """A name without what no page shows, and not empty."""
    kept = "".join(c for c in name if unicodedata.category(c)[0] != "C").strip()
    return kept[:100] or "Scene"


def _record(file: Path) -> _ProjectRecord:
    accepted = "what the studio wrote there"
    tree = strict_json.read(file, most=MAX_RECORD, accepted=accepted)
    try:
        return _ProjectRecord.model_validate(tree)
    except ValidationError as error:
        found, wanted = strict_json.problem(error, ", ".join(_ProjectRecord.model_fields))
        raise InputError(file, found=found, accepted=wanted) from None


def _read(folder: Path) -> Project:
    try:
        record = _record(folder / RECORD)
    except F3srError as error:
        return Project(folder, problem=str(error))
    photo = folder / record.photo if record.photo else None
    return Project(
        folder, _shown_name(record.name), record.created, photo, record.options, tuple(record.remarks), record.segmenter
    )


def _copy(source: Path, target: Path) -> None:
    """Files and folders, nothing through links. Raises InputError for more than a scene can have."""
    left = [MAX_FILES, MAX_BYTES]

    def ignored(folder: str, names: list[str]) -> list[str]:
        place, away = Path(folder), list[str]()
        for name in names:
            file = place / name
            if file.is_symlink() or not (file.is_file() or file.is_dir()):
                away.append(name)
            else:
                left[0] -= 1
                left[1] -= file.stat().st_size
        if min(left) < 0 or len(place.relative_to(source).parts) > MAX_DEPTH:
            found = f"more than {MAX_FILES:,} files, {MAX_BYTES // 10**9} GB or {MAX_DEPTH} folders in each other"
            raise InputError(source, found=found, accepted="one scene's folder")
        return away

    try:
        shutil.copytree(source, target, ignore=ignored, copy_function=shutil.copyfile)
    except shutil.Error as error:
        raise OutputError(f"{source}: cannot be copied ({str(error.args[0][0][2])[:200]})") from error
