"""Networks without a camera: their depths under the built-in metrology's, with planted maps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from f3sr.backends.model_choice import ModelChoice
from f3sr.backends.protocols import EstimatedGeometry, GeometryEstimator, KnownFocal, PromptedImage
from f3sr.backends.registry import Backend
from f3sr.core.transforms import rotation_about
from f3sr.errors import InputError
from f3sr.io.answers import geometry_of
from f3sr.io.input_folder import InputFolder
from f3sr.io.inputs import Fillers, Inputs
from f3sr.io.photo_hints import PhotoHints
from f3sr.metrology.fitted_depth import DepthAnythingGeometry, FittedDepth, fitted
from f3sr.neural.depth_maps import DepthMap
from f3sr.neural.pixel_rays import rays
from f3sr.photo_inputs import read_inputs
from f3sr.scene import Instance, Photo
from folders import write_folder
from lazily import WITH_MODELS, Lazily

tiny = Lazily("tiny_models")
pytestmark = WITH_MODELS
W, H, F = 96, 64, 90.0
K = np.array([[F, 0, W / 2], [0, F, H / 2], [0, 0, 1]])


class KnownGround:
    """A ground .5 m below a camera that looks 35 degrees down; the metrology's answer, exactly."""

    def __init__(self, size: tuple[int, int] = (W // 2, H // 2)) -> None:
        self.size = size

    def depth(self) -> np.ndarray:
        up = rotation_about([1, 0, 0], np.radians(35)) @ [0, -1, 0]
        return -0.5 / (rays(K, W, H) @ up)

    def estimate(self, image: PromptedImage) -> EstimatedGeometry:
        w, h = self.size
        small = rays(K / [[W / w], [H / h], [1]], w, h)
        up = rotation_about([1, 0, 0], np.radians(35)) @ [0, -1, 0]
        points = small * (-0.5 / (small @ up))[..., None]
        return EstimatedGeometry(points=points, valid=points[..., 2] > 0, K=K, ground_only=True, told="a known ground")


class PlantedNetwork(FittedDepth):
    network_class = DepthAnythingGeometry.network_class

    def __init__(self, depth: DepthMap) -> None:
        super().__init__(ModelChoice(model="planted"), KnownGround())
        self.network.predict = lambda photo: depth  # type: ignore[method-assign]


def scene() -> tuple[np.ndarray, np.ndarray]:
    """Depths (H, W) of the ground with a box's front at .7 m, and its mask."""
    z, mask = KnownGround().depth(), np.zeros((H, W), bool)
    mask[20:40, 30:60] = True
    return np.where(mask, 0.7, z), mask


def asked(mask: np.ndarray, *, ground: bool = True) -> PromptedImage:
    return PromptedImage(
        photo=Photo(rgb=np.zeros((H, W, 3), np.uint8)),
        instances=(Instance(id=0, label="box", name="00_box.png", mask=mask),),
        ground_mask=~mask if ground else None,
    )


@pytest.mark.parametrize("ground", [True, False])
def test_planted_relative_depths_come_back_in_the_grounds_unit(ground: bool):
    z, mask = scene()
    found = PlantedNetwork(DepthMap(values=((1 / z - 0.3) / 0.02).astype(np.float32), metric=False)).estimate(
        asked(mask, ground=ground)
    )
    assert found.valid.all() and found.guessed_unit and not found.ground_only
    np.testing.assert_allclose(found.points[..., 2], z, rtol=1e-4)
    np.testing.assert_allclose(found.points, rays(K, W, H) * z[..., None], rtol=1e-4, atol=1e-5)
    assert "scale 0.02 and shift 0.3 1/m" in found.told and "a known ground" in found.told
    assert "distances of objects +- 0.0 %" in found.told


def test_what_is_beyond_the_horizon_of_the_fit_has_no_depth():
    z, mask = scene()
    values = (1 / z - 0.3) / 0.02
    values[:6] = (0 - 0.3) / 0.02
    found = PlantedNetwork(DepthMap(values=values.astype(np.float32), metric=False)).estimate(asked(mask))
    assert not found.valid[:6].any() and found.valid[6:].all() and np.isfinite(found.points).all()


def test_metric_depths_take_the_camera_and_keep_their_unit():
    z, mask = scene()
    found = PlantedNetwork(DepthMap(values=(3 * z).astype(np.float32), metric=True)).estimate(asked(mask))
    assert not found.guessed_unit and found.told.startswith("metric depths of planted")
    np.testing.assert_allclose(found.points[..., 2], 3 * z, rtol=1e-6)
    np.testing.assert_array_equal(found.K, K)


def test_a_ground_too_small_is_one_error():
    z, mask = scene()
    few = np.zeros((H, W), bool)
    few[60:62, :10] = True
    with pytest.raises(InputError, match=r"Depth Anything: found 20 pixels of the ground; accepted: at least 64"):
        fitted((1 / z).astype(np.float32), KnownGround().estimate(asked(mask)), few, "Depth Anything")


@pytest.mark.parametrize("bad", [np.nan, 0.0, -3.0])
def test_hostile_metric_depths_are_refused_when_they_are_read(tmp_path: Path, bad: float):
    _, mask = scene()
    made = PlantedNetwork(DepthMap(values=np.full((H, W), bad, np.float32), metric=True))
    backend = Backend(kind="geometry", name="planted", version="1", made=made)
    write_folder(tmp_path / "in")
    with pytest.raises(InputError, match="geometry back end planted 1"):
        geometry_of(InputFolder(tmp_path / "in"), backend, asked(mask))


def test_a_hostile_camera_is_refused_before_its_points(tmp_path: Path):
    z, mask = scene()

    class Hostile:
        def estimate(self, image: PromptedImage) -> EstimatedGeometry:
            points = (rays(K, W, H) * z[..., None]).astype(np.float32)
            return EstimatedGeometry(points=points, valid=points[..., 2] > 0, K=K * [[-1], [1], [1]])

    backend = Backend(kind="geometry", name="hostile", version="1", made=Hostile())
    write_folder(tmp_path / "in")
    with pytest.raises(InputError, match=r"K = \[\[-90"):
        geometry_of(InputFolder(tmp_path / "in"), backend, asked(mask))


def test_a_real_network_of_random_weights_ends_in_an_answer_or_one_error(tmp_path: Path):
    """With the built-in metrology and a known focal length, which it keeps."""
    place = tiny.depth_anything(tmp_path / "metric", "metric")
    _, mask = scene()
    rgb = np.random.default_rng(0).integers(0, 255, (H, W, 3), np.uint8)
    given = replace(asked(mask), photo=Photo(rgb=rgb), focal=KnownFocal(pixels=F, sigma=0, source="--focal"))
    found = DepthAnythingGeometry(ModelChoice(model=str(place))).estimate(given)
    assert found.K[0, 0] == pytest.approx(F) and found.points.shape == (H, W, 3)
    np.testing.assert_allclose(found.points[..., 2], 10, rtol=0.2)  # half of max_depth: a sigmoid of about 0


def test_the_unit_of_relative_depths_is_the_camera_height_that_is_given(tmp_path: Path):
    """Without one it is a guess, which the report tells; metric depths take no height."""
    truth = write_folder(tmp_path / "in")
    eye = truth.camera
    n, below = eye.T_world_camera[2, :3], float(eye.center[2])
    w, h = eye.width, eye.height
    toward = rays(eye.K, w, h)
    depth = -below / (toward @ n)

    def backend(*, metric: bool) -> Backend[GeometryEstimator]:
        values = depth if metric else 7 / depth + 3
        made = DepthAnythingGeometry(ModelChoice(model="planted"))
        made.network.predict = lambda photo: DepthMap(  # type: ignore[method-assign]
            values=values.astype(np.float32), metric=metric
        )
        return Backend(kind="geometry", name="planted", version="1", made=made)

    def read(hints: PhotoHints, *, metric: bool = False) -> Inputs:
        return read_inputs(
            tmp_path / "in",
            ignore=["geometry"],
            fillers=Fillers(geometry=backend(metric=metric)),
            hints=hints,
        )

    focal = float(eye.K[0, 0])
    low, high = (read(PhotoHints(focal=focal, camera_height=height)) for height in (below, 2 * below))
    assert low.geometry.source == "estimate" and low.K[0, 0] == pytest.approx(focal)
    middle = low.geometry.valid & high.geometry.valid
    assert middle.mean() > 0.5
    np.testing.assert_allclose(high.geometry.points[middle], 2 * low.geometry.points[middle], rtol=1e-3)
    assert any("unit: metres" in d.choice and "--camera-height" in d.reason for d in low.decisions)
    guessed = read(PhotoHints(focal=focal))
    assert any("unknown unit" in d.choice and d.fallback for d in guessed.decisions)
    with pytest.raises(InputError, match="--camera-height: found a back end for geometry that takes no hint"):
        read(PhotoHints(focal=focal, camera_height=below), metric=True)
    assert not any("unit" in d.choice for d in read(PhotoHints(focal=focal), metric=True).decisions)
