"""A job: one input folder with its options and goals, and the key that names its result by content."""

from __future__ import annotations

import hashlib
import stat
import tempfile
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, Self, cast

import f3sr
from f3sr.backends.model_choice import Device, ModelChoice, Precision
from f3sr.errors import F3srError, reason
from f3sr.files.limited_file import MAX_FILE_BYTES
from f3sr.runtime.extras import library
from f3sr.runtime.result_store import code_version, digest

MOST_FILES = 10_000
"""Files of one input folder."""
DEEPEST = 3
"""Folders inside each other: an input folder has two."""
UNKEYED = ("name", "source", "allow_downloads")
"""What a job says that its result does not depend on."""
NUMERIC = (
    *("numpy", "scipy", "highspy", "numba", "mujoco-core", "manifold3d", "trimesh", "fast-simplification"),
    *("pillow", "av", "jinja2"),
)
"""Libraries whose version may change a byte of a package."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Job:
    """What is to be made of one input folder. Plain values only: it travels to other processes as JSON."""

    name: str
    """Unique in a dataset."""
    source: str
    """The input folder: a path, or a URL that fsspec reaches."""
    goals: tuple[str, ...] = ()
    skip: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()
    asset_frame: str = "auto"
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Settings that differ from the defaults, by dotted name."""
    backends: Mapping[str, str] = field(default_factory=dict[str, str])
    """Names of back ends by option: geometry, normals, assets, scene_graph, background."""
    normals_axes: str = ""
    """Axes of the normals that a network gives, as "rdf"; empty where they are to be found."""
    device: Device = "auto"
    precision: Precision = "auto"
    allow_downloads: bool = False
    """Where and how models of these back ends run, and whether their weights may be fetched."""
    backend_keys: tuple[str, ...] = ()
    """Versions and sources of these back ends."""
    film: bool = False
    work: str = ""
    """``module:function`` that does the job."""
    inputs: str = ""
    """Digest of the input folder."""
    code: str = ""
    """Digest of f3sr and of the versions of its libraries."""

    @property
    def choice(self) -> ModelChoice:
        """Of the back ends' models, without their names."""
        return ModelChoice(
            device=self.device,
            precision=self.precision,
            allow_downloads=self.allow_downloads,
            axes=self.normals_axes,
        )

    @property
    def key(self) -> str:
        """Digest of all that the result depends on; neither name nor place of the input is part of it, nor how weights
        come to this machine."""
        values = asdict(self)
        return digest("job 1", {name: value for name, value in values.items() if name not in UNKEYED})

    @property
    def remote(self) -> bool:
        """Whether the input lies behind a URL. It is digested where it is fetched for the work."""
        return "://" in self.source

    @classmethod
    def from_plain(cls, values: Mapping[str, Any]) -> Self:
        """The job whose ``asdict`` went through JSON."""
        lists = {name: tuple(values[name]) for name in ("goals", "skip", "ignore", "backend_keys")}
        return cls(**cast(dict[str, Any], {**values, **lists}))


@cache
def code_digest() -> str:
    """Digest of f3sr's files and of the versions of numerical libraries: other code makes other packages."""
    here = Path(f3sr.__file__).parent
    pages = sorted(p for p in here.rglob("*") if p.suffix in (".html", ".css", ".js"))
    shown = [(p.relative_to(here).as_posix(), hashlib.sha256(p.read_bytes()).hexdigest()) for p in pages]
    return digest(code_version(), shown, versions())


@cache
def versions() -> dict[str, str]:
    """f3sr and the libraries that its results depend on, by name."""
    return {"f3sr": f3sr.__version__, **{name: metadata.version(name) for name in NUMERIC}}


def inputs_digest(source: Path) -> str:
    """Digest of every file of a local input folder by relative path and content. What cannot be read has a digest too:
    the job then says what is wrong, and another one begins where it is mended."""
    return digest([*_local_digests(source)])


def _local_digests(root: Path) -> Iterator[tuple[str, str]]:
    """Files in order of their paths. Other things, and what lies too deep, count by what they are."""
    try:
        names = sorted(_below(root, 0))
    except OSError as error:
        yield "", reason(error)
        return
    for path in names[:MOST_FILES]:
        yield path.relative_to(root).as_posix(), _file_digest(path)
    yield "files", str(len(names))


def _below(folder: Path, depth: int) -> Iterator[Path]:
    for path in folder.iterdir():
        if path.name.startswith("."):
            continue
        if path.is_dir() and depth < DEEPEST:
            yield from _below(path, depth + 1)
        else:
            yield path


def _file_digest(path: Path) -> str:
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode) or status.st_size > MAX_FILE_BYTES:
            return f"{stat.S_IFMT(status.st_mode)} of {status.st_size} bytes"
        with path.open("rb") as file:
            return hashlib.file_digest(cast(Any, file), "sha256").hexdigest()
    except OSError as error:
        return reason(error)


@contextmanager
def fetched(source: str) -> Generator[Path]:
    """An input folder as local files; one behind a URL is copied for as long as the block lasts."""
    if "://" not in source:
        yield Path(source)
        return
    fsspec = library("fsspec", extra="ray", why=f"the input {source.partition('://')[0]}://")
    with tempfile.TemporaryDirectory(prefix="f3sr-input-") as made:
        folder = Path(made, "input")
        try:
            files, root = fsspec.core.url_to_fs(source)
            if not files.isdir(root):
                raise UnreachableError(f"{source}: found no folder there; accepted: an input folder")
            files.get(root, str(folder), recursive=True)
        except (OSError, ValueError, ImportError) as error:
            raise UnreachableError(f"{source}: could not be read ({error})") from error
        yield folder


class UnreachableError(F3srError):
    """An input behind a URL that cannot be had, perhaps for the moment only."""
