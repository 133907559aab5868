"""Workers: a scripted generator in a process of its own, well-behaved, killed, slow and lying."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import forked
from f3sr.backends.model_choice import ModelChoice
from f3sr.backends.protocols import PromptedImage
from f3sr.errors import F3srError, InputError
from f3sr.generators import worker_assets
from f3sr.io import inputs
from f3sr.io.inputs import Inputs
from f3sr.lifting.generators import ASSET_GENERATORS
from f3sr.workers.mesh_worker import MeshModel, MeshWorker
from f3sr.workers.worker_process import WorkerError, WorkerLimits
from folders import write_folder
from worker_jobs import LIMITS, command_of

SCRIPT = Path(__file__).parent / "scripted_worker.py"
command = partial(command_of, SCRIPT)
Worker = Callable[..., MeshWorker]


@pytest.fixture
def source(tmp_path: Path) -> Path:
    write_folder(tmp_path / "given")
    return tmp_path / "given"


@pytest.fixture
def given(source: Path) -> Inputs:
    return inputs.read(source)


@pytest.fixture
def image(given: Inputs) -> PromptedImage:
    return PromptedImage(photo=given.photo, instances=given.instances, ground_mask=given.ground_mask)


@pytest.fixture
def worker(source: Path, jobs: Path) -> Worker:
    return partial(scripted, source)


def scripted(source: Path, *, limits: WorkerLimits = LIMITS, **options: object) -> MeshWorker:
    choice = ModelChoice(model=command(source, **options))
    return MeshWorker(MeshModel(name="scripted"), choice, limits=limits)


def asked(jobs: Path) -> Counter[int]:
    """How often each object was asked for."""
    (job,) = jobs.iterdir()
    return Counter(map(int, (job / "asked.txt").read_text().split()))


# --- answers ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("convention", ["sam3d", "xyzw"])
def test_poses_come_out_as_the_folder_has_them(
    source: Path, jobs: Path, given: Inputs, image: PromptedImage, convention: str
):
    assets = worker_assets.worker(ModelChoice(model=command(source, convention=convention)))
    made = assets.generate(image, given.geometry, given.K)
    for id, asset in given.assets.items():
        wanted = asset.T_camera_object @ np.append(asset.scale * asset.mesh.vertices[0], 1)
        found = made[id].T_camera_object @ np.append(made[id].scale * made[id].mesh.vertices[0], 1)
        assert np.allclose(found, wanted, atol=1e-6)
        assert "Scripted, weights r1, licence CC0" in made[id].told
    assert assets.provenance == {"model": "Scripted, weights r1, licence CC0", "licence": ""}


def test_meshes_without_a_pose_stand_on_their_masks(source: Path, jobs: Path, given: Inputs, image: PromptedImage):
    assets = worker_assets.worker(ModelChoice(model=command(source, convention="none")))
    made = assets.generate(image, given.geometry, given.K)
    for id, asset in given.assets.items():
        middle = [m.T_camera_object @ np.append(m.scale * m.mesh.bounds.mean(0), 1) for m in (asset, made[id])]
        assert np.linalg.norm(middle[0] - middle[1]) < 0.1 * asset.scale * asset.mesh.diagonal
        assert made[id].scale == pytest.approx(asset.scale, rel=0.06)
        assert "pose by its mask" in made[id].told


def test_an_equal_job_is_not_asked_again(worker: Worker, jobs: Path, given: Inputs, image: PromptedImage):
    for _ in range(2):
        worker().produce(image, given.geometry, given.K)
    assert set(asked(jobs).values()) == {1}


# --- killed, slow ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fault", ["crash", "kill"])
@pytest.mark.parametrize("at", [2, 5, 7])
def test_a_worker_that_dies_is_resumed(
    source: Path, jobs: Path, given: Inputs, image: PromptedImage, tmp_path: Path, fault: str, at: int
):
    """The command is the same; only the script behind it is mended."""
    script = tmp_path / "worker.sh"
    script.write_text(f'#!/bin/sh\nexec {command(source, fault=fault, at=at)} "$@"\n')
    script.chmod(0o700)
    worker = MeshWorker(MeshModel(name="scripted"), ModelChoice(model=str(script)), limits=LIMITS)
    with pytest.raises(WorkerError, match="the next run goes on in") as error:
        worker.produce(image, given.geometry, given.K)
    if fault == "crash":
        assert "exit code 7" in str(error.value) and "CUDA out of memory" in str(error.value)
        assert "\x1b" not in str(error.value)
    script.write_text(f'#!/bin/sh\nexec {command(source)} "$@"\n')
    made = worker.produce(image, given.geometry, given.K)
    assert set(made) == {2, 5, 7}
    assert asked(jobs) == Counter({2: 1, 5: 1, 7: 1} | {at: 2})


@pytest.mark.parametrize(
    ("fault", "limits", "told"),
    [
        ("hang", WorkerLimits(silence_s=1.0), "no progress for 1 s"),
        ("drip", WorkerLimits(wall_s=1.5), "not done after 2 s"),
        ("flood", WorkerLimits(folder_bytes=10**9), "10,00.* bytes in its job folder"),
    ],
)
def test_a_worker_beyond_its_limits_is_ended(
    worker: Worker, source: Path, given: Inputs, image: PromptedImage, fault: str, limits: WorkerLimits, told: str
):
    began = time.monotonic()
    with pytest.raises(WorkerError, match=told):
        worker(fault=fault, at=2, limits=limits).produce(image, given.geometry, given.K)
    assert time.monotonic() - began < 20
    assert not running(source)


def test_chatter_is_read_and_ignored(worker: Worker, given: Inputs, image: PromptedImage):
    assert set(worker(fault="chatter", at=5).produce(image, given.geometry, given.K)) == {2, 5, 7}


def test_a_worker_ends_with_f3sr(source: Path, tmp_path: Path, jobs: Path):
    """kill -9 of the process that started it."""
    hanging = command(source, fault="hang", at=5)
    arguments = [sys.executable, "-m", "f3sr", "reconstruct", str(source), "-o", str(tmp_path / "out")]
    process = forked.Popen([*arguments, "--ignore", "assets", "--assets", f"worker:{hanging}"])
    try:
        wait_for(lambda: running(source))
        process.kill()
        process.wait()
        wait_for(lambda: not running(source))
    finally:
        process.kill()


# --- lying -----------------------------------------------------------------------------------------------------------

LIES = (
    *("escape", "no such mesh", "wrong id", "no rotation", "zero rotation", "negative scale", "bad up", "long model"),
    *("other type", "nan", "half json", "large json", "huge mesh", "no glb", "link", "stranger"),
)


@pytest.mark.parametrize("fault", LIES)
def test_bad_answers_are_refused_by_name(worker: Worker, jobs: Path, given: Inputs, image: PromptedImage, fault: str):
    with pytest.raises(InputError) as error:
        worker(fault=fault, at=5).produce(image, given.geometry, given.K)
    (job,) = jobs.iterdir()
    assert str(job) in str(error.value)
    if fault != "stranger":
        assert not (job / "05.json").exists()  # the next run asks for it again
        assert (job / "02.json").exists()


def test_an_object_without_an_answer_is_told(worker: Worker, given: Inputs, image: PromptedImage):
    with pytest.raises(WorkerError, match="2 of 3 objects done"):
        worker(fault="forget", at=7).produce(image, given.geometry, given.K)


# --- commands --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["", "no-such-program --x", "'open"])
def test_a_command_that_cannot_run_is_told(jobs: Path, given: Inputs, image: PromptedImage, text: str):
    worker = MeshWorker(MeshModel(name="scripted"), ModelChoice(model=text), limits=LIMITS)
    with pytest.raises(F3srError, match=r"command|no-such-program|quotation"):
        worker.produce(image, given.geometry, given.K)


def test_doctor_tells_what_a_worker_needs(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("F3SR_WORKER_SAM3D", raising=False)
    (need,) = next(f for f in ASSET_GENERATORS.examined() if f.name == "sam3d").needs
    assert not need.met and "export F3SR_WORKER_SAM3D" in need.remedy
    monkeypatch.setenv("F3SR_WORKER_SAM3D", f"{sys.executable} worker.py")
    (need,) = next(f for f in ASSET_GENERATORS.examined() if f.name == "sam3d").needs
    assert need.met


def running(source: Path) -> list[int]:
    """Process ids of scripted workers that run on a folder: tests beside this one have workers of their own."""
    found = list[int]()
    for place in Path("/proc").glob("[0-9]*"):
        try:
            words = (place / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        launches = b"worker_launcher.py" in b" ".join(words[:3])
        if {bytes(SCRIPT), bytes(source), b"--job"} <= {*words} and not launches:
            found.append(int(place.name))
    return found


def wait_for(condition: Callable[[], object], seconds: float = 60) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)
