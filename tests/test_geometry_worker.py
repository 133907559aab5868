"""Geometry workers: a scripted model in a process of its own, well-behaved, killed, slow and lying."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from f3sr.backends.model_choice import ModelChoice
from f3sr.backends.protocols import KnownFocal, PromptedImage
from f3sr.backends.registry import Backend
from f3sr.cli import console
from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.io import inputs
from f3sr.io.inputs import Fillers, Inputs
from f3sr.metrology import worker_geometry
from f3sr.metrology.estimators import GEOMETRY_ESTIMATORS
from f3sr.metrology.worker_geometry import WorkerGeometry
from f3sr.neural.pixel_rays import rays
from f3sr.photo_inputs import read_inputs
from f3sr.pipeline import reconstruct
from f3sr.runtime.progress import words_to
from f3sr.workers.geometry_worker import GeometryWorker
from f3sr.workers.job_worker import WorkerModel
from f3sr.workers.worker_process import WorkerError, WorkerLimits
from folders import write_folder
from worker_jobs import LIMITS, command_of

SCRIPT = Path(__file__).parent / "scripted_geometry.py"
command = partial(command_of, SCRIPT)
pytestmark = pytest.mark.usefixtures("jobs")
NAMES = ("depth-anything-3", "unidepth", "metric3d", "vggt", "worker")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A folder whose points lie on the rays through the centres of the map's pixels."""
    truth = write_folder(tmp_path / "given")
    file = tmp_path / "given" / "geometry.npz"
    with np.load(file) as archive:
        held = dict(archive)
    h, w = held["mask"].shape
    K = truth.camera.K * [[w / truth.camera.width], [h / truth.camera.height], [1]]
    held["points"] = (rays(K, w, h) * held["points"][..., 2:]).astype(np.float32)
    np.savez(file, **held)
    return tmp_path / "given"


@pytest.fixture
def given(source: Path) -> Inputs:
    return inputs.read(source)


@pytest.fixture
def image(given: Inputs) -> PromptedImage:
    """With the true camera told, and the height of its eye."""
    focal = KnownFocal(pixels=float(given.K[0, 0]), sigma=0, source="--focal", centre=tuple(given.K[:2, 2]))
    return PromptedImage(
        photo=given.photo, instances=given.instances, ground_mask=given.ground_mask, focal=focal, camera_height=1.0
    )


def scripted(source: Path, *, limits: WorkerLimits = LIMITS, **options: object) -> GeometryWorker:
    return GeometryWorker(WorkerModel(name="scripted"), ModelChoice(model=command(source, **options)), limits=limits)


class Plane:
    """The true ground of the folder under a camera that is twice as high as it is: another unit."""

    def __init__(self, given: Inputs, K: Array | None = None) -> None:
        self.given, self.K = given, given.K if K is None else K

    def estimate(self, image: PromptedImage) -> object:
        geometry = self.given.geometry
        assert image.ground_mask is not None
        valid = geometry.inside(image.ground_mask)
        return worker_geometry.EstimatedGeometry(
            points=2 * geometry.points, valid=valid, K=self.K, ground_only=True, told="a known ground"
        )


# --- answers ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("meaning", "factor"), [("metric", 1), ("scaled", 2), ("relative", 2)])
def test_planted_depths_come_back_at_their_pixels(
    source: Path, given: Inputs, image: PromptedImage, meaning: str, factor: float
):
    """Metres stay; what has none gets the unit of the known ground."""
    found = WorkerGeometry(scripted(source, meaning=meaning), Plane(given)).estimate(image)  # type: ignore[arg-type]
    true = given.geometry
    np.testing.assert_array_equal(found.valid, true.valid)
    # relative answers are single precision before they are inverted
    np.testing.assert_allclose(found.points[true.valid], factor * true.points[true.valid], rtol=2e-3, atol=1e-4)
    np.testing.assert_array_equal(found.K, given.K)
    assert found.guessed_unit is (meaning != "metric") and not found.ground_only
    assert "Scripted, weights r1, licence CC0" in found.told


@pytest.mark.parametrize("size", [(48, 36), (96, 72), (101, 77)])
def test_a_map_of_another_size_lies_on_the_whole_photo(
    tmp_path: Path, source: Path, given: Inputs, image: PromptedImage, size: tuple[int, int]
):
    """Pixel centres to pixel centres: points of a plane stay on it, at any resolution."""
    w, h = size
    normal = np.array([0.1, -0.8, -0.6])
    toward = rays(given.K * [[w / 192], [h / 144], [1]], w, h)
    points = toward * (-0.5 / (toward @ normal))[..., None]
    planted = tmp_path / "small"
    planted.mkdir()
    intrinsics = given.K / [[192], [144], [1]]
    np.savez(planted / "geometry.npz", points=points, mask=points[..., 2] > 0, intrinsics=intrinsics)
    found = WorkerGeometry(scripted(planted), Plane(given)).estimate(replace(image, focal=None))  # type: ignore[arg-type]
    assert found.points.shape == (h, w, 3)
    np.testing.assert_allclose(found.K, given.K, rtol=1e-9)
    np.testing.assert_allclose(found.points[found.valid] @ normal, -0.5, rtol=1e-4)


def test_points_are_read_where_they_lie_on_the_rays_of_their_camera(source: Path, given: Inputs, image: PromptedImage):
    found = WorkerGeometry(scripted(source, points=1), Plane(given)).estimate(image)  # type: ignore[arg-type]
    true = given.geometry
    np.testing.assert_allclose(found.points[true.valid], true.points[true.valid], rtol=1e-4, atol=1e-5)


def test_the_camera_is_the_told_one_then_the_models_then_the_metrologys(
    source: Path, given: Inputs, image: PromptedImage
):
    other = given.K * [[1.5], [1.5], [1]]
    untold = replace(image, focal=None)
    cases = ((image, 1, other), (untold, 1, given.K), (untold, 0, other))
    for asked, camera, wanted in cases:
        found = WorkerGeometry(scripted(source, camera=camera), Plane(given, other)).estimate(asked)  # type: ignore[arg-type]
        np.testing.assert_allclose(found.K, wanted, rtol=1e-12)
        np.testing.assert_allclose(found.points[..., 2], np.where(found.valid, given.geometry.points[..., 2], 0))


def test_a_run_with_planted_depths_levels_as_the_folder_does(source: Path, given: Inputs):
    """``--geometry unidepth`` through the registry, the checks of answers and the first stages."""
    backend = GEOMETRY_ESTIMATORS.find(f"unidepth:{command(source)}")
    read = read_inputs(source, ignore=["geometry"], fillers=Fillers(geometry=backend))
    np.testing.assert_allclose(read.K, given.K, rtol=1e-9)
    assert any("metric depths of Scripted" in d.choice for d in read.decisions)
    assert read.fillers["geometry"].startswith("unidepth") and "licence CC0" in read.fillers["geometry"]
    skip = ("align", "decompose", "separate", "settle", "inpaint", "uncertainty", "evaluate")
    one, other = (reconstruct(i, skip=skip, store=None).scene for i in (given, read))
    np.testing.assert_allclose(other.camera.T_world_camera, one.camera.T_world_camera, atol=1e-4)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(b.T_world_object, a.T_world_object, atol=1e-4)


# --- killed, slow ----------------------------------------------------------------------------------------------------


def test_an_equal_job_is_not_asked_again(source: Path, jobs: Path, given: Inputs, image: PromptedImage):
    for _ in range(2):
        scripted(source).predict(image, given.K)
    (job,) = jobs.iterdir()
    assert (job / "asked.txt").read_text().split() == ["asked"]


@pytest.mark.parametrize("fault", ["crash", "kill", "silent"])
def test_a_worker_that_dies_is_asked_again(
    tmp_path: Path, source: Path, jobs: Path, given: Inputs, image: PromptedImage, fault: str
):
    script = tmp_path / "worker.sh"
    script.write_text(f'#!/bin/sh\nexec {command(source, fault=fault)} "$@"\n')
    script.chmod(0o700)
    worker = GeometryWorker(WorkerModel(name="scripted"), ModelChoice(model=str(script)), limits=LIMITS)
    with pytest.raises(WorkerError, match=r"goes on in|without an answer"):
        worker.predict(image, given.K)
    script.write_text(f'#!/bin/sh\nexec {command(source)} "$@"\n')
    assert worker.predict(image, given.K).meaning == "metric"
    assert len(list(jobs.iterdir())) == 1


@pytest.mark.parametrize(
    ("fault", "limits", "told"),
    [
        ("hang", WorkerLimits(silence_s=0.5), "no progress for 0 s"),
        ("hang", WorkerLimits(wall_s=0.5), "not done after 0 s"),
        ("flood", WorkerLimits(folder_bytes=10**9), "bytes in its job folder"),
    ],
)
def test_a_worker_beyond_its_limits_is_ended(
    source: Path, given: Inputs, image: PromptedImage, fault: str, limits: WorkerLimits, told: str
):
    began = time.monotonic()
    with pytest.raises(WorkerError, match=told):
        scripted(source, fault=fault, limits=limits).predict(image, given.K)
    assert time.monotonic() - began < 20


# --- lying -----------------------------------------------------------------------------------------------------------

LIES = (
    *("cropped", "nan", "whole numbers", "three axes", "both", "neither", "other size of mask", "no focal length"),
    *("nan in K", "mirrored", "without a camera", "pickle", "huge", "escape", "no such file", "meaning", "long model"),
    *("half json", "large file", "no npz", "link"),
)


@pytest.mark.parametrize("fault", LIES)
def test_bad_answers_are_refused_by_name(source: Path, jobs: Path, given: Inputs, image: PromptedImage, fault: str):
    with pytest.raises(InputError) as error:
        scripted(source, fault=fault).predict(image, given.K)
    (job,) = jobs.iterdir()
    assert str(job) in str(error.value)
    assert not (job / "geometry.json").exists()  # the next run asks again


def test_scaled_depths_without_a_ground_are_one_error(source: Path, given: Inputs, image: PromptedImage):
    few = np.zeros_like(given.ground_mask)
    few[-1, :20] = True
    with pytest.raises(InputError, match=r"scripted: found 10 points of the ground; accepted: at least 64"):
        WorkerGeometry(scripted(source, meaning="scaled"), Plane(given)).estimate(  # type: ignore[arg-type]
            replace(image, ground_mask=few)
        )


# --- names, words ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_doctor_tells_what_each_needs(monkeypatch: pytest.MonkeyPatch, name: str):
    variable = "F3SR_WORKER_" + ("GEOMETRY" if name == "worker" else name.upper().replace("-", "_"))
    monkeypatch.delenv(variable, raising=False)
    (need,) = next(f for f in GEOMETRY_ESTIMATORS.examined() if f.name == name).needs
    assert not need.met and f"export {variable}" in need.remedy
    script = need.remedy.split()[-1].rstrip("'")
    assert name == "worker" or (SCRIPT.parents[1] / script).is_file()
    monkeypatch.setenv(variable, f"{sys.executable} worker.py")
    (need,) = next(f for f in GEOMETRY_ESTIMATORS.examined() if f.name == name).needs
    assert need.met


def test_a_user_sees_what_is_waited_for(
    source: Path, image: PromptedImage, given: Inputs, capsys: pytest.CaptureFixture[str]
):
    made = WorkerGeometry(scripted(source), Plane(given))  # type: ignore[arg-type]
    backend = Backend(kind="geometry", name="scripted", version="1", made=made)
    with console.steps_shown() as progress:
        backend.telling(words_to(progress)).made.estimate(image)
    lines = capsys.readouterr().out.splitlines()
    assert lines == [f"scripted: {sys.executable} is started", "scripted: loading", "scripted: done"]
