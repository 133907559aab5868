"""The ground's normal by a network's normals: its median and measured error, in the camera and in what is read."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from f3sr.backends.protocols import EstimatedNormals, PromptedImage
from f3sr.backends.registry import Backend
from f3sr.cli.main import main
from f3sr.core.transforms import Array, rotation_from_vector
from f3sr.errors import InputError
from f3sr.io import inputs
from f3sr.io.inputs import Fillers
from f3sr.metrology.camera_estimate import attitude, estimate_camera
from f3sr.metrology.ground_normal import ground_normal
from f3sr.photo_inputs import read_inputs
from f3sr.scene import Instance, Photo
from f3sr.stages.assemble import as_given, assemble
from f3sr.stages.level import level
from folders import camera, write_folder

H, W = 60, 80
UP = attitude(math.radians(30), math.radians(3))[:, 2]
ERROR = math.radians(2)


def image(normals: Array, *, ground: bool = True) -> PromptedImage:
    """A grey photo with an object in its lower half, whose normals differ from the ground's."""
    mask = np.zeros((H, W), bool)
    mask[40:55, 30:50] = True
    values = np.where(mask[::2, ::2, None], [0.0, 0, -1], normals[::2, ::2])
    return PromptedImage(
        photo=Photo(rgb=np.full((H, W, 3), 127, np.uint8)),
        instances=(Instance(id=0, label="", name="00.png", mask=mask),),
        ground_mask=~mask if ground else None,
        normals=EstimatedNormals(values=values, error=ERROR),
    )


@pytest.mark.parametrize("ground", [True, False])
def test_the_median_is_the_plane_and_noise_of_pixels_goes(ground: bool):
    rng = np.random.default_rng(0)
    noisy = UP + 0.2 * rng.standard_normal((H, W, 3))
    noisy /= np.linalg.norm(noisy, axis=2, keepdims=True)
    found = ground_normal(image(noisy, ground=ground))
    assert found is not None and math.acos(float(found.normal @ UP)) < math.radians(2)
    assert 2 * ERROR <= found.error < 6 * ERROR, "two standard errors, the common one among them"
    exact = ground_normal(image(np.broadcast_to(UP, (H, W, 3))))
    assert exact is not None and exact.error == pytest.approx(2 * ERROR)


def test_parts_that_differ_are_an_error_that_is_measured():
    bent = np.broadcast_to(UP, (H, W, 3)).copy()
    bent[:, W // 2 :] = rotation_from_vector([0.2, 0, 0]) @ UP
    found = ground_normal(image(bent))
    assert found is not None and found.error > 0.2


def test_no_plane_is_no_evidence():
    rng = np.random.default_rng(0)
    anywhere = rng.standard_normal((H, W, 3))
    anywhere /= np.linalg.norm(anywhere, axis=2, keepdims=True)
    assert ground_normal(image(anywhere)) is None
    assert ground_normal(image(np.zeros((H, W, 3)))) is None
    assert ground_normal(replace(image(anywhere), normals=None)) is None


def test_a_photo_that_shows_nothing_takes_the_tilt_of_the_normals():
    up = attitude(math.radians(55), math.radians(1))[:, 2]
    grey = image(np.broadcast_to(up, (H, W, 3)))
    masks = [i.mask for i in grey.instances]
    without = estimate_camera(grey.photo.rgb, masks, grey.ground_mask)
    seen = estimate_camera(grey.photo.rgb, masks, grey.ground_mask, normal=ground_normal(grey))
    assert seen.normal_off is not None and math.degrees(seen.normal_off) < 2
    assert math.acos(float(seen.up @ up)) < 0.2 * math.acos(float(without.up @ up))
    assert math.hypot(*seen.errors[1:]) < 0.7 * math.hypot(*without.errors[1:])


# --- in a run -----------------------------------------------------------------------------------------------------


class Planted:
    """A NormalEstimator of one answer, which notes what it is asked."""

    def __init__(self, **changes: Any) -> None:
        self.asked: list[bool] = []
        self.changes = changes

    def normals(self, image: PromptedImage, geometry: Any, K: Any) -> EstimatedNormals:
        self.asked.append(geometry is not None)
        up = camera().T_world_camera[2, :3]
        values = np.broadcast_to(up, (36, 48, 3)).astype(np.float32)
        return replace(EstimatedNormals(values=values, error=ERROR, told="planted"), **self.changes)


def backend(made: Any) -> Backend[Any]:
    return Backend(kind="normals", name="planted", version="1", made=made)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_folder(tmp_path / "in")
    return tmp_path / "in"


def test_a_geometry_without_normals_gets_them_and_level_weighs_them(folder: Path):
    made = Planted()
    given = read_inputs(folder, fillers=Fillers(normals=backend(made)))
    assert made.asked == [True] and given.geometry.normals_error == ERROR
    assert given.geometry.normals is not None and given.geometry.normals.shape == given.geometry.points.shape
    assert given.fillers == {"normals": "planted 1"}
    told = "normals: estimated by normals back end planted 1: planted"
    assert told in [d.choice for d in given.decisions]
    plain = read_inputs(folder)
    assert given.key != plain.key
    (_, with_normals), (_, without) = (level(assemble(as_given(g))[0]) for g in (given, plain))
    assert with_normals.fit is not None and without.fit is not None
    assert with_normals.fit.agreement == 1 and math.isfinite(with_normals.fit.tilt_error)
    assert not math.isfinite(without.fit.tilt_error), "an estimate alone does not know it"


def test_a_larger_common_error_has_less_say(folder: Path):
    errors = []
    for error in (ERROR, 3 * ERROR):
        given = read_inputs(folder, fillers=Fillers(normals=backend(Planted(error=error))))
        fit = level(assemble(as_given(given))[0])[1].fit
        assert fit is not None
        errors.append(fit.tilt_error)
    assert errors[1] > errors[0]


def test_a_geometry_with_normals_is_not_given_others(folder: Path):
    arrays = dict(np.load(folder / "geometry.npz"))
    own = np.broadcast_to(np.float32([0, -1, 0]), arrays["points"].shape)
    np.savez(folder / "geometry.npz", **arrays, normal=own)
    made = Planted()
    given = read_inputs(folder, fillers=Fillers(normals=backend(made)))
    assert not made.asked and given.geometry.normals_error is None and np.array_equal(given.geometry.normals, own)
    assert any("is not asked" in d.choice for d in given.decisions)


def test_without_geometry_the_camera_has_the_evidence_and_level_does_not_weigh_it_twice(folder: Path):
    made = Planted()
    given = read_inputs(folder, ignore=["geometry"], fillers=Fillers(normals=backend(made)))
    assert made.asked == [False] and given.geometry.normals is None
    (told,) = [d.choice for d in given.decisions if d.choice.startswith("geometry: estimated")]
    assert "a network's normals of the ground" in told
    up = camera().T_world_camera[2, :3]
    points = given.geometry.points[given.geometry.valid].astype(float)
    plane = np.linalg.lstsq(points, np.ones(len(points)), rcond=None)[0]
    assert math.degrees(math.acos(abs(float(plane @ up)) / np.linalg.norm(plane))) < 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"values": np.full((36, 48, 3), 0.9, np.float32)}, "found a normal of length 1.56; accepted: unit vectors"),
        ({"values": np.full((36, 48, 3), np.nan, np.float32)}, "found a normal of length nan"),
        ({"values": np.zeros((36, 48), np.float32)}, r"values of shape \(36, 48\)"),
        ({"values": [[0, 0, 1]]}, "accepted: ndarray"),
        ({"error": math.nan}, "found an error of nan rad; accepted: 0 to pi"),
        ({"error": -1.0}, "found an error of -1 rad"),
    ],
)
def test_hostile_answers_are_one_error(folder: Path, changes: dict[str, Any], message: str):
    with pytest.raises(InputError, match=f"normals back end planted 1: .*{message}"):
        inputs.read(folder, fillers=Fillers(normals=backend(Planted(**changes))))


def test_doubtful_axes_are_a_fallback_in_the_report(folder: Path):
    given = inputs.read(folder, fillers=Fillers(normals=backend(Planted(warning="axes lub are documented"))))
    (doubt,) = [d for d in given.decisions if d.choice == "normals: their axes are doubtful"]
    assert doubt.fallback and doubt.reason == "axes lub are documented"


def test_axes_alone_are_one_error(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["reconstruct", str(folder), "-o", str(tmp_path / "out"), "--normals-axes", "rdf"]) != 0
    assert "--normals-axes: found rdf; accepted: together with --normals" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
