"""Recorded episodes: what was seen comes back, killed recordings leave whole datasets, and LeRobot loads them."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed: pip install 'f3sr[gym]'")
parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed: pip install 'f3sr[dataset]'")

import av  # noqa: E402

from f3sr.env import ID  # noqa: E402
from f3sr.env.gripper import GripperConfig  # noqa: E402
from f3sr.env.lerobot_dataset import INFO, LeRobotDataset  # noqa: E402
from f3sr.env.recording import PICTURE, Recording  # noqa: E402
from f3sr.env.scene_env import RATE, SceneEnv  # noqa: E402
from f3sr.env.scripted_grasp import pick  # noqa: E402
from f3sr.errors import InputError, OutputError  # noqa: E402
from f3sr.film.video import BT601, yuv420  # noqa: E402
from f3sr.scene_package.package import Package  # noqa: E402
from goal_scene import BALL, CAN, goal_package  # noqa: E402


@dataclass(frozen=True)
class Recorded:
    folder: Path
    rows: NDArray[Any]
    """(n, k) of state, objects and action as they were, in double precision."""
    pictures: NDArray[np.uint8]
    lengths: list[int]


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return goal_package(tmp_path_factory.mktemp("recording") / "package")


@pytest.fixture(scope="module")
def recorded(package: Package, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Two scripted grasps with pictures, of a can and a ball."""
    folder = tmp_path_factory.mktemp("recorded") / "grasps"
    inner = gymnasium.make(ID, package=package, control="pose", observation="both", longest=64, seconds=30)
    env = Recording(inner, folder, task="lift the soup can")
    rows, pictures, lengths = list[NDArray[Any]](), list[NDArray[np.uint8]](), list[int]()
    for id, task in ((CAN, "lift the soup can"), (BALL, "lift the tennis ball")):
        env.task = task
        seen, _ = env.reset(seed=id)
        lengths.append(0)
        for action in pick(env.scene_env.scene, id, GripperConfig(), rate=RATE, hold=0.2):
            objects = np.concatenate([seen["poses"], seen["velocities"]], axis=1).ravel()
            rows.append(np.concatenate([seen["controller"], objects, action]))
            pictures.append(seen["picture"])
            seen, *_ = env.step(action)
            lengths[-1] += 1
    env.close()
    return Recorded(folder, np.array(rows), np.array(pictures), lengths)


def state_env(package: Package, **options: Any) -> SceneEnv:
    return SceneEnv(package, "push the can 10 cm to the left", **options)


def info_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / INFO).read_text())


def decoded(folder: Path) -> NDArray[np.uint8]:
    """The pictures of all episodes, as PyAV shows them."""
    shown = list[NDArray[np.uint8]]()
    for film in sorted((folder / "videos" / PICTURE).glob("*/*.mp4")):
        with av.open(str(film)) as file:
            shown += [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    return np.array(shown)


def read(folder: Path) -> dict[str, NDArray[Any]]:
    """Columns of the frames that a dataset counts, all episodes in order."""
    files = sorted((folder / "data").glob("*/*.parquet"))
    rows = [row for file in files for row in parquet.read_table(file).to_pylist()][: info_of(folder)["total_frames"]]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@pytest.mark.slow
def test_values_come_back_in_single_precision(recorded: Recorded) -> None:
    found = read(recorded.folder)
    columns = (found["observation.state"], found["observation.environment_state"], found["action"])
    assert np.array_equal(np.concatenate(columns, axis=1).astype(np.float32), recorded.rows.astype(np.float32))
    first, second = recorded.lengths
    assert found["episode_index"].tolist() == [0] * first + [1] * second == found["task_index"].tolist()
    assert found["index"].tolist() == list(range(first + second))
    assert np.allclose(found["timestamp"], found["frame_index"] / RATE)
    assert np.flatnonzero(found["next.done"]).tolist() == [first - 1, first + second - 1]


def test_frames_come_back_within_the_codec_s_loss(recorded: Recorded) -> None:
    films = sorted((recorded.folder / "videos" / PICTURE).glob("*/*.mp4"))
    assert len(films) == 2
    luma = list[NDArray[Any]]()
    for film, length in zip(films, recorded.lengths, strict=True):
        with av.open(str(film)) as file:
            frames = list(file.decode(video=0))
        assert [float(f.time) for f in frames] == pytest.approx([k / RATE for k in range(length)])
        assert [f.key_frame for f in frames] == [k % 2 == 0 for k in range(length)]
        luma += [f.to_ndarray(format="yuv420p")[: f.height].astype(int) for f in frames]
    exact = [yuv420(picture, BT601)[: len(picture)] for picture in recorded.pictures]
    error = np.array([[np.abs(a - b).mean() for b in (exact[k], exact[k - 1])] for k, a in enumerate(luma)])
    assert error[:, 0].max() < 2
    moved = [np.abs(a.astype(int) - b).mean() for a, b in zip(exact, [exact[0], *exact], strict=False)]
    k = int(np.argmax(moved))  # where the picture changes most, it is the right frame
    assert error[k, 1] > 2 * error[k, 0]


def test_the_meta_files_tell_of_every_episode(recorded: Recorded) -> None:
    info, folder = info_of(recorded.folder), recorded.folder
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", RATE, 2)
    assert info["total_frames"] == len(recorded.rows) and info["splits"] == {"train": "0:2"}
    names = info["features"]["observation.environment_state"]["names"]
    assert names[13 * CAN] == "soup_can_01.x" and len(names) == 13 * 6
    assert info["features"][PICTURE]["shape"] == list(recorded.pictures.shape[1:])
    tasks = parquet.read_table(folder / "meta/tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0, 1], "task": ["lift the soup can", "lift the tennis ball"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    episodes = parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [e["length"] for e in episodes] == recorded.lengths
    assert [e["dataset_from_index"] for e in episodes] == [0, recorded.lengths[0]]
    stats = json.loads((folder / "meta/stats.json").read_text())
    assert np.allclose(stats["action"]["mean"], recorded.rows[:, -8:].mean(0), atol=1e-6)
    assert np.allclose(np.ravel(stats[PICTURE]["mean"]), recorded.pictures.mean((0, 1, 2)) / 255, atol=1e-6)
    assert set(stats) == set(info["features"])


def test_equal_recordings_have_equal_bytes(package: Package, tmp_path: Path) -> None:
    trees = list[dict[str, bytes]]()
    for name in ("a", "b"):
        env = Recording(state_env(package), tmp_path / name)
        env.action_space.seed(0)
        env.reset(seed=0)
        for _ in range(3):
            env.step(env.action_space.sample())
        env.close()
        files = (p for p in sorted((tmp_path / name).rglob("*")) if p.is_file())
        trees.append({str(p.relative_to(tmp_path / name)): p.read_bytes() for p in files})
    assert trees[0] == trees[1] and len(trees[0]) == 5
    assert info_of(tmp_path / "a")["video_path"] is None


def test_ends_of_episodes_and_what_is_discarded(package: Package, tmp_path: Path) -> None:
    env = Recording(state_env(package, seconds=0.2), tmp_path / "data")
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(7))
    env.reset(seed=0)
    for _ in range(4):
        *_, truncated, _ = env.step(np.zeros(7))
    assert truncated and len(env.dataset) == 1, "written when it ended"
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(7))
    env.reset()
    env.step(np.zeros(7))
    env.discard()
    env.reset()
    env.reset()
    env.step(np.zeros(7))
    env.close()
    assert len(env.dataset) == 2 and info_of(tmp_path / "data")["total_frames"] == 5


def test_a_dataset_is_gone_on_with_only_if_told(package: Package, tmp_path: Path) -> None:
    out = tmp_path / "data"

    def episode(append: bool, **options: Any) -> None:
        env = Recording(state_env(package, **options), out, append=append)
        env.reset(seed=0)
        env.step(np.zeros(env.action_space.shape or ()))
        env.close()

    episode(False)
    with pytest.raises(OutputError, match="append=True"):
        episode(False)
    episode(True)
    with pytest.raises(OutputError, match="another robot_type"):
        episode(True, gripper=False)
    assert info_of(out)["total_episodes"] == 2 and read(out)["episode_index"].tolist() == [0, 1]
    (tmp_path / "other").mkdir()
    (tmp_path / "other/file").touch()
    with pytest.raises(OutputError, match="no LeRobot dataset"):
        Recording(state_env(package), tmp_path / "other")
    (out / "meta/episodes/chunk-000/file-000.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match="Parquet"):
        episode(True)


def test_one_process_writes_a_dataset(package: Package, tmp_path: Path) -> None:
    env = Recording(state_env(package), tmp_path / "data")
    with pytest.raises(OutputError, match="another run"):
        Recording(state_env(package), tmp_path / "data")
    env.close()
    assert list(tmp_path.iterdir()) == [], "nothing was recorded"


class KilledError(BaseException):
    """As a signal that nothing catches."""


@pytest.mark.parametrize("after", range(6))
def test_a_recording_that_is_killed_is_whole(
    after: int, package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between any two files of the second episode, readers find the first one, or both."""
    out = tmp_path / "data"
    env = Recording(state_env(package), out)
    put: Callable[..., None] = LeRobotDataset._put
    written = list[str]()

    def killed(self: LeRobotDataset, name: str, data: bytes) -> None:
        if len(written) == after:
            raise KilledError
        put(self, name, data)
        written.append(name)

    monkeypatch.setattr(LeRobotDataset, "_put", killed)
    for k in range(2):
        env.reset(seed=k)
        env.step(np.full(7, 0.1 * k))
    if after < 5:
        with pytest.raises(KilledError):
            env.save()
    else:
        env.save()
    monkeypatch.undo()
    assert info_of(out)["total_episodes"] == (2 if after == 5 else 1)
    assert len(read(out)["index"]) == info_of(out)["total_frames"]
    env.dataset._open.close()
    again = Recording(state_env(package), out, append=True)
    again.reset(seed=5)
    again.step(np.zeros(7))
    again.close()
    found = read(out)
    assert found["episode_index"].tolist() == list(range(info_of(out)["total_episodes"]))


def test_a_recording_needs_a_task(package: Package, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no goal"):
        Recording(SceneEnv(package), tmp_path / "data")


LOAD = """
import sys
import numpy as np
import torch
library = torch.library.Library("torchvision", "FRAGMENT")
try:  # beside a torch of another build torchvision has no operators, and wants to know of this one
    library.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
except RuntimeError:
    pass
from lerobot.datasets.lerobot_dataset import LeRobotDataset
data = LeRobotDataset("f3sr/test", root=sys.argv[1], video_backend="pyav")
frames = [data[k] for k in range(len(data))]
names = "observation.state", "observation.environment_state", "action"
rows = np.array([np.concatenate([f[n].numpy() for n in names]) for f in frames])
pictures = np.array([f["observation.images.photo"].numpy().transpose(1, 2, 0) for f in frames])
batch = next(iter(torch.utils.data.DataLoader(data, batch_size=4, shuffle=True)))
assert batch["action"].shape == (4, 8)
np.savez(sys.argv[2], rows=rows, pictures=pictures, tasks=[f["task"] for f in frames])
"""


def test_lerobot_loads_it(recorded: Recorded, tmp_path: Path) -> None:
    """In an environment of its own: LEROBOT_PYTHON names its Python."""
    python = os.environ.get("LEROBOT_PYTHON")
    if not python:
        pytest.skip("LEROBOT_PYTHON does not name a Python with lerobot")
    out = tmp_path / "seen.npz"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {"HF_HUB_OFFLINE": "1"}
    subprocess.run([python, "-c", LOAD, recorded.folder, out], check=True, capture_output=True, env=environment)
    with np.load(out) as seen:
        assert np.array_equal(seen["rows"], recorded.rows.astype(np.float32))
        assert np.abs(255 * seen["pictures"] - decoded(recorded.folder)).mean() < 1
        first, second = recorded.lengths
        assert seen["tasks"].tolist() == ["lift the soup can"] * first + ["lift the tennis ball"] * second
