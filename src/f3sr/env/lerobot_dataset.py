"""A LeRobot dataset (v3.0) on disk, an episode at a time: Parquet, MP4 and JSON, without LeRobot.

Every episode has a Parquet and an MP4 file of its own. The folder appears with the first one. Later files appear whole,
``meta/info.json`` last: it counts the episodes, and readers look at no others. So a recording that is killed leaves a
dataset of the episodes before, or none.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from f3sr.env.feature_statistics import PictureStatistics, Statistics, joined, statistics_of
from f3sr.errors import InputError, OutputError
from f3sr.files import limited_file, strict_json
from f3sr.film.video import BT601, Encoder, Video
from f3sr.runtime import signals
from f3sr.runtime.atomic_folder import claimed
from f3sr.runtime.extras import library

VERSION = "v3.0"
INFO, TASKS, STATS = "meta/info.json", "meta/tasks.parquet", "meta/stats.json"
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA, EPISODES, VIDEO = f"data/{FILE}.parquet", f"meta/episodes/{FILE}.parquet", f"videos/{{video_key}}/{FILE}.mp4"
CHUNK = 1000
"""Files of a folder, as LeRobot divides them."""
KEY_SECONDS = 0.1
"""Time between key frames [s]: training reads frames in any order. Two frames at 20 a second, as LeRobot has it."""
MOST_META_BYTES = 1_000_000_000
"""Of a file that is read to go on with a dataset."""
PART = ".part"
"""Suffix of a file that is being written: readers look for no such name."""


@dataclass(frozen=True, kw_only=True)
class Feature:
    """What a frame holds under a name: numbers, a truth, or a picture."""

    dtype: str
    """float32, int64, bool or video."""
    shape: tuple[int, ...]
    names: Sequence[str] | None = None

    def info(self, fps: int) -> dict[str, Any]:
        """As ``info.json`` tells it."""
        told: dict[str, Any] = {"dtype": self.dtype, "shape": list(self.shape)}
        told["names"] = None if self.names is None else list(self.names)
        if self.dtype == "video":
            height, width, channels = self.shape
            told["info"] = {
                "video.height": height,
                "video.width": width,
                "video.codec": "h264",
                "video.pix_fmt": "yuv420p",
                "video.is_depth_map": False,
                "video.fps": fps,
                "video.channels": channels,
                "has_audio": False,
            }
        return told


OWN = {"timestamp": "float32"} | dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")
"""Features of every dataset, which are counted here."""


@dataclass(eq=False)
class _Episode:
    """The frames so far."""

    task: str
    fps: int
    rows: dict[str, list[NDArray[Any]]] = field(default_factory=dict[str, list[NDArray[Any]]])
    films: dict[str, Encoder] = field(default_factory=dict[str, Encoder])
    levels: dict[str, PictureStatistics] = field(default_factory=dict[str, PictureStatistics])
    length: int = 0


class LeRobotDataset:
    """A dataset that episodes are added to; one process at a time.

    ``features`` by name, without ``OWN``. A dataset that is there is gone on with only if ``append``. Raises
    OutputError where ``out`` may not be written or has other features, F3srError without pyarrow.
    """

    def __init__(
        self, out: str | Path, features: Mapping[str, Feature], *, fps: int, robot: str, append: bool = False
    ) -> None:
        self.folder = Path(out).absolute()
        self._features = dict(features)
        self._fps, self._robot = fps, robot
        self._arrow, self._parquet = _pyarrow("pyarrow"), _pyarrow("pyarrow.parquet")
        self._episode: _Episode | None = None
        self._rows, self._tasks = list[dict[str, Any]](), list[str]()
        with contextlib.ExitStack() as stack:
            self._claim = stack.enter_context(claimed(self.folder, lambda out: _require_free(out, append=append)))
            if (self.folder / INFO).exists():
                self._rows, self._tasks = self._read()
            self._open = stack.pop_all()

    def __len__(self) -> int:
        """Episodes."""
        return len(self._rows)

    @property
    def frames(self) -> int:
        """Frames of the episode that goes on."""
        return self._episode.length if self._episode else 0

    def add(self, frame: Mapping[str, ArrayLike], *, task: str) -> None:
        """The next frame, which begins an episode where none goes on; values of all features, of their shapes."""
        if self._episode is None:
            self._episode = _Episode(task, self._fps)
        episode = self._episode
        for name, feature in self._features.items():
            value = np.asarray(frame[name])
            if value.shape != feature.shape:
                raise InputError(name, found=f"shape {value.shape}", accepted=f"{feature.shape}")
            if feature.dtype == "video":
                if name not in episode.films:
                    film = Encoder(self._fps, key_seconds=KEY_SECONDS, matrix=BT601)
                    episode.films[name], episode.levels[name] = film, PictureStatistics()
                episode.films[name].add(value)
                episode.levels[name].add(value)
            else:
                episode.rows.setdefault(name, []).append(value.astype(feature.dtype))
        episode.length += 1

    def discard(self) -> None:
        """Forget the episode that goes on."""
        episode, self._episode = self._episode, None
        for film in episode.films.values() if episode else ():
            film.close()

    def save(self, last: Mapping[str, ArrayLike] | None = None) -> None:
        """Write the episode that goes on; without frames there is none. ``last`` replaces values of its last frame.

        Raises OutputError; then the episode is lost."""
        episode = self._episode
        if episode is None:
            return
        for name, value in (last or {}).items():
            episode.rows[name][-1] = np.asarray(value, self._features[name].dtype)
        try:
            films = {name: film.finish() for name, film in episode.films.items()}
            self._write(episode, films)
        finally:
            self.discard()

    def close(self) -> None:
        """Save what goes on, and let others write."""
        try:
            self.save()
        finally:
            self._open.close()

    def _write(self, episode: _Episode, films: Mapping[str, Video]) -> None:
        number, start = len(self._rows), self._rows[-1]["dataset_to_index"] if self._rows else 0
        if episode.task not in self._tasks:
            self._tasks.append(episode.task)
        columns = self._columns(episode, number, start)
        statistics = {name: statistics_of(rows.reshape(len(rows), -1)) for name, rows in columns.items()}
        statistics |= {name: levels.statistics for name, levels in episode.levels.items()}
        self._rows.append(_row(episode, number, start, films, statistics))
        place = _place(number)
        files = {VIDEO.format(video_key=name, **place): film.data for name, film in films.items()}
        files[DATA.format(**place)] = self._table(columns)
        files[TASKS] = self._task_table()
        files[EPISODES.format(chunk_index=0, file_index=0)] = self._bytes(self._arrow.Table.from_pylist(self._rows))
        files[STATS] = _json(self._statistics())
        files[INFO] = _json(self._info())
        try:
            if number == 0:
                for name, data in files.items():
                    self._claim.write(name, data)
                self._claim.replace()
            else:
                for name, data in files.items():
                    self._put(name, data)
        except OSError as error:
            self._rows.pop()
            raise OutputError(f"{self.folder}: could not be written ({error.strerror or error})") from error

    def _put(self, name: str, data: bytes) -> None:
        """A file in one step."""
        file = self.folder / name
        with signals.held():
            file.parent.mkdir(parents=True, exist_ok=True)
            part = file.with_name(f".{file.name}{PART}")
            part.write_bytes(data)
            part.replace(file)

    def _columns(self, episode: _Episode, number: int, start: int) -> dict[str, NDArray[Any]]:
        n = np.arange(episode.length)
        own = {
            "timestamp": (n / self._fps).astype(np.float32),
            "frame_index": n,
            "episode_index": np.full(len(n), number),
            "index": start + n,
            "task_index": np.full(len(n), self._tasks.index(episode.task)),
        }
        return {**{name: np.stack(rows) for name, rows in episode.rows.items()}, **own}

    def _table(self, columns: Mapping[str, NDArray[Any]]) -> bytes:
        pa = self._arrow
        arrays = dict[str, Any]()
        for name, rows in columns.items():
            flat = pa.array(rows.ravel())
            single = rows.ndim == 1 or rows.shape[1:] == (1,)
            arrays[name] = flat if single else pa.FixedSizeListArray.from_arrays(flat, rows.shape[1])
        return self._bytes(pa.table(arrays))

    def _task_table(self) -> bytes:
        """Texts as the index of a pandas table, which is how LeRobot finds them."""
        pa = self._arrow
        table = pa.table({"task_index": pa.array(range(len(self._tasks)), pa.int64()), "task": self._tasks})
        columns = (("task_index", "int64", "int64"), ("task", "unicode", "object"))
        told = {
            "index_columns": ["task"],
            "column_indexes": [],
            "columns": [
                {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
                for name, kind, numpy in columns
            ],
            "creator": {"library": "pyarrow", "version": pa.__version__},
            "pandas_version": "2.0.0",
        }
        return self._bytes(table.replace_schema_metadata({"pandas": json.dumps(told)}))

    def _bytes(self, table: Any) -> bytes:
        file = io.BytesIO()
        self._parquet.write_table(table, file)
        return file.getvalue()

    def _statistics(self) -> dict[str, Any]:
        """Of all episodes, from what each one's row holds."""
        names = dict.fromkeys(key.split("/")[1] for key in self._rows[0] if key.startswith("stats/"))
        found = dict[str, Any]()
        for name in names:
            begin = f"stats/{name}/"
            episodes = [
                {key.removeprefix(begin): np.asarray(value) for key, value in row.items() if key.startswith(begin)}
                for row in self._rows
            ]
            found[name] = {key: value.tolist() for key, value in joined(episodes).items()}
        return found

    def _info(self) -> dict[str, Any]:
        features = {name: feature.info(self._fps) for name, feature in self._features.items()}
        features |= {name: Feature(dtype=dtype, shape=(1,)).info(self._fps) for name, dtype in OWN.items()}
        films = any(feature.dtype == "video" for feature in self._features.values())
        return {
            "codebase_version": VERSION,
            "robot_type": self._robot,
            "total_episodes": len(self._rows),
            "total_frames": self._rows[-1]["dataset_to_index"] if self._rows else 0,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._rows)}"},
            "data_path": DATA,
            "video_path": VIDEO if films else None,
            "features": features,
        }

    def _read(self) -> tuple[list[dict[str, Any]], list[str]]:
        """Rows of the episodes that a dataset counts, and its tasks. Raises OutputError where it has other features."""
        file = self.folder / INFO
        info = strict_json.read(file, most=MOST_META_BYTES, accepted=f"the info.json of a LeRobot dataset {VERSION}")
        mine = self._info()
        for name in ("codebase_version", "robot_type", "fps", "features", "data_path", "video_path", "chunks_size"):
            if not isinstance(info, dict) or info.get(name) != mine[name]:
                raise OutputError(f"{file}: has another {name} than this recording; give a new folder")
        rows = self._pylist(EPISODES.format(chunk_index=0, file_index=0))
        tasks: list[Any] = [row.get("task") for row in self._pylist(TASKS)]
        count = info.get("total_episodes")
        if not (isinstance(count, int) and 0 < count <= len(rows)) or not all(isinstance(t, str) for t in tasks):
            raise OutputError(f"{file}: counts episodes that are not there, or has damaged tasks; give a new folder")
        known = rows[:count]
        if any(row.get("episode_index") != k or "dataset_to_index" not in row for k, row in enumerate(known)):
            raise OutputError(f"{self.folder}: its episodes are damaged; give a new folder")
        return known, tasks

    def _pylist(self, name: str) -> list[dict[str, Any]]:
        data = limited_file.read(self.folder / name, most=MOST_META_BYTES)
        try:
            return self._parquet.read_table(self._arrow.BufferReader(data), use_threads=False).to_pylist()
        except self._arrow.ArrowException as error:
            raise InputError(self.folder / name, found=str(error), accepted="a Parquet file of a dataset") from None


def _row(
    episode: _Episode, number: int, start: int, films: Mapping[str, Video], statistics: Mapping[str, Statistics]
) -> dict[str, Any]:
    """What ``meta/episodes`` tells of an episode."""
    chunk, file = _place(number).values()
    row: dict[str, Any] = {"episode_index": number, "tasks": [episode.task], "length": episode.length}
    row |= {"data/chunk_index": chunk, "data/file_index": file}
    row |= {"dataset_from_index": start, "dataset_to_index": start + episode.length}
    for name in films:
        row |= {f"videos/{name}/chunk_index": chunk, f"videos/{name}/file_index": file}
        row |= {f"videos/{name}/from_timestamp": 0.0, f"videos/{name}/to_timestamp": episode.length / episode.fps}
    for name, found in statistics.items():
        row |= {f"stats/{name}/{key}": value.tolist() for key, value in found.items()}
    return row | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}


def _place(number: int) -> dict[str, int]:
    return {"chunk_index": number // CHUNK, "file_index": number % CHUNK}


def _require_free(out: Path, *, append: bool) -> None:
    """Raises OutputError unless a dataset may begin, or go on, at ``out``."""
    if (out / INFO).is_file():
        if not append:
            raise OutputError(f"{out}: holds a dataset; append=True goes on with it, or give a new folder")
    elif out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out}: is there already and no LeRobot dataset; give a new or empty folder")


def _json(tree: Mapping[str, Any]) -> bytes:
    return json.dumps(tree, indent=4).encode()


def _pyarrow(module: str) -> Any:
    return library(module, extra="dataset", why="a LeRobot dataset")
