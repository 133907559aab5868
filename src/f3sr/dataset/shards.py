"""Shards for training: tar files as WebDataset reads them, with equal bytes for equal packages.

A sample is one scene: members ``KEY.photo.png``, ``KEY.scene.json`` and so on. What comes before the first dot is the
sample's key. A file in a folder of the package has dots for slashes: ``KEY.masks.00_mug.png``.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from f3sr.dataset.layout import Dataset, Listed
from f3sr.dataset.record import to_bytes
from f3sr.dataset.storage import files_of
from f3sr.errors import InputError, OutputError
from f3sr.runtime import atomic_folder

DEFAULT_FILES = (
    *("photo.png", "scene.json", "scene.glb", "masks/*", "rollouts/*/plan.json", "rollouts/*/verdict.json"),
    *("rollouts/*/rollout.npz", "rollouts/*/film.mp4"),
)
"""Files of a package that go into shards."""
RECORD_MEMBER = "record.json"
KEY_LENGTH = 32
"""Characters of a key that name a sample."""
CONTENTS = "shards.json"
BLOCK = tarfile.BLOCKSIZE


def export(dataset: Dataset, jobs: Sequence[Listed], out: Path, *, megabytes: float, files: Sequence[str]) -> Path:
    """Write the packages of jobs as shards of at most about so many MB to a new folder; returns its full path.

    ``files`` are patterns of paths in the package. A shard holds whole samples, at least one. Jobs without a package
    are left out, and those of equal content come once. Raises OutputError if the folder holds anything.
    """
    out = out.absolute()
    shards: list[dict[str, object]] = []
    with atomic_folder.claimed(out, _require_empty) as claim:
        folder = atomic_folder.building_of(out) / atomic_folder.NEW
        folder.mkdir(parents=True)
        samples = _samples(dataset, jobs, files)
        sample = next(samples, None)
        if sample is None:
            raise InputError(dataset.storage.place, found="no scene that is done", accepted="at least one")
        while sample is not None:
            name = f"shard-{len(shards):06d}.tar"
            size, keys = 0, list[str]()
            with tarfile.open(folder / name, "w", format=tarfile.GNU_FORMAT) as tar:
                while sample is not None and (not keys or size + sample[1] <= 1e6 * megabytes):
                    key, length, members = sample
                    for member, data in members:
                        tar.addfile(_member(f"{key}.{member}", len(data)), io.BytesIO(data))
                    size, keys = size + length, [*keys, key]
                    sample = next(samples, None)
            shards.append({"shard": name, "samples": len(keys), "bytes": (folder / name).stat().st_size})
        claim.write(CONTENTS, (json.dumps({"format": "webdataset", "shards": shards}, indent=1) + "\n").encode())
        claim.replace()
    return out


def _samples(
    dataset: Dataset, jobs: Sequence[Listed], files: Sequence[str]
) -> Iterator[tuple[str, int, list[tuple[str, bytes]]]]:
    """Key, size in a tar and members of every sample, in the order of jobs."""
    seen = set[str]()
    for job in jobs:
        record = dataset.record(job.key)
        if record is None or record.status != "done" or job.key in seen:
            continue
        seen.add(job.key)
        with dataset.package(job.key) as package:
            members = [(RECORD_MEMBER, to_bytes(record)), *_members(package, files)]
        size = sum(2 * BLOCK + len(data) for _, data in members)
        yield job.key[:KEY_LENGTH], size, members


def _members(package: Path, files: Sequence[str]) -> Iterator[tuple[str, bytes]]:
    taken = set[str]()
    for name in sorted(files_of(package)):
        if any(fnmatchcase(name, pattern) for pattern in files):
            member = name.replace("/", ".")
            if member in taken:
                raise InputError(
                    package / name, found=f"a second {member}", accepted="paths that differ by their parts"
                )
            taken.add(member)
            yield member, (package / name).read_bytes()


def _member(name: str, size: int) -> tarfile.TarInfo:
    """A file of nobody in particular at no particular time."""
    info = tarfile.TarInfo(name)
    info.size, info.mode, info.mtime = size, 0o644, 0
    return info


def _require_empty(out: Path) -> None:
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out}: is not empty; give a new folder")
