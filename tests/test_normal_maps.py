"""Networks of normals as TorchScript files: planted answers at the right pixels, hostile files and answers."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from f3sr.backends.model_choice import ModelChoice
from f3sr.backends.protocols import KnownFocal, PromptedImage
from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.io import inputs
from f3sr.io.inputs import Fillers
from f3sr.metrology.estimators import NORMAL_ESTIMATORS
from f3sr.metrology.network_normals import DsineNormals, OmnidataNormals
from f3sr.neural.normal_maps import DsineNetwork, NormalNetwork, OmnidataNetwork, assumed_camera
from f3sr.neural.pixel_rays import rays
from f3sr.scene import Photo
from folders import camera, write_folder
from lazily import WITH_MODELS, Lazily

tiny = Lazily("tiny_models")
pytestmark = WITH_MODELS
SIZES = [(96, 64), (64, 96), (384, 288), (701, 403), (50, 50)]


def network(kind: type[NormalNetwork], module: Any, file: Path) -> Any:
    return kind(ModelChoice(model=str(tiny.script(module, file)), device="cpu"))


def coloured(normals: Array) -> Photo:
    """Unit normals (H, W, 3) as colours."""
    return Photo(rgb=np.round(255 * (normals + 1) / 2).astype(np.uint8))


def halves(width: int, height: int) -> tuple[Photo, Array, Array]:
    """A photo whose left half is one wall, its right half another."""
    left, right = np.array([0.6, 0.0, -0.8]), np.array([-0.28, -0.6, -0.75]) / np.linalg.norm([0.28, 0.6, 0.75])
    normals = np.broadcast_to(left, (height, width, 3)).copy()
    normals[:, width // 2 :] = right
    return coloured(normals), left, right


def seen(kind: type[NormalNetwork], folder: Path, photo: Photo) -> Array:
    module = tiny.ColourNormals() if kind is OmnidataNetwork else tiny.ColourNormalsWithCamera()
    return network(kind, module, folder / "colours.pt").predict(photo, assumed_camera(photo, None, None))


@pytest.mark.parametrize("kind", [OmnidataNetwork, DsineNetwork])
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_planted_walls_come_out_at_their_pixels(kind: type[NormalNetwork], width: int, height: int, tmp_path: Path):
    """Colours are normals: each half has its wall's, and their border is in the middle, to a pixel of the map."""
    photo, left, right = halves(width, height)
    values = seen(kind, tmp_path, photo)
    h, w = values.shape[:2]
    assert abs(w / h - width / height) < 2.5 / min(w, h) and max(w, h) <= 640
    assert np.abs(np.linalg.norm(values, axis=2) - 1).max() < 1e-5
    soft = 2 + w // width
    assert np.abs(values[:, : w // 2 - soft] - left).max() < 0.02
    assert np.abs(values[:, w // 2 + soft :] - right).max() < 0.02
    middle = (np.abs(values - left).sum(2) < np.abs(values - right).sum(2)).sum(1)
    assert np.abs(middle - w * (width // 2) / width).max() <= 1


@pytest.mark.parametrize("kind", [OmnidataNetwork, DsineNetwork])
def test_a_mirrored_photo_has_the_mirrored_map(kind: type[NormalNetwork], tmp_path: Path):
    rng = np.random.default_rng(0)
    rough = rng.standard_normal((20, 30, 3))
    normals = np.kron(rough / np.linalg.norm(rough, axis=2, keepdims=True), np.ones((7, 7, 1)))
    turned = seen(kind, tmp_path, coloured(normals[::-1, ::-1]))[::-1, ::-1]
    assert np.abs(turned - seen(kind, tmp_path, coloured(normals))).max() < 1e-4


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_the_camera_is_that_of_the_padded_picture(width: int, height: int, tmp_path: Path):
    """Rays by the network's own camera are those through the middles of our pixels."""
    photo = Photo(rgb=np.zeros((height, width, 3), np.uint8))
    K = np.array([[0.9 * width, 0, 0.47 * width], [0, 0.9 * width, 0.55 * height], [0, 0, 1]])
    values = network(DsineNetwork, tiny.PixelRays(), tmp_path / "rays.pt").predict(photo, K)
    h, w = values.shape[:2]
    expected = rays(K * [[w / width], [h / height], [1]], w, h)
    expected /= -np.linalg.norm(expected, axis=2, keepdims=True)
    assert np.abs(values - expected).max() < 1e-5


def test_without_a_camera_sixty_degrees_are_assumed():
    photo = Photo(rgb=np.zeros((48, 64, 3), np.uint8))
    K = assumed_camera(photo, None, None)
    assert math.degrees(2 * math.atan(32 / K[0, 0])) == pytest.approx(60) and K[:2, 2].tolist() == [32, 24]
    assert assumed_camera(photo, 70.0, (30.0, 20.0))[:2].tolist() == [[70, 0, 30], [0, 70, 20]]


def test_random_weights_answer_and_a_photo_is_asked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    photo = Photo(rgb=np.random.default_rng(0).integers(0, 256, (60, 80, 3), np.uint8))
    one = network(OmnidataNetwork, tiny.TinyNormals(), tmp_path / "tiny.pt")
    K = assumed_camera(photo, None, None)
    first = one.predict(photo, K)
    assert first.shape == (288, 384, 3) and first.dtype == np.float32
    monkeypatch.setattr(one, "network", lambda: pytest.fail("asked again"))
    assert one.predict(photo, K) is first


def answer(change: Callable[[Any], Any]) -> Any:
    values = tiny.torch.zeros(1, 3, 384, 384)
    values[:, 0], values[:, 1], values[:, 2] = 0.5, 0.1, 0.2
    return tiny.Constant(change(values))


def with_holes(values: Any) -> Any:
    values[..., :100, :] = math.nan
    values[..., 100:150, :] = 0.5
    return values


HOSTILE = {
    "a size of its own": (
        lambda v: v[..., :200],
        r"shape \(1, 3, 384, 200\); accepted: \(1, 3, 384, 384\)",
    ),
    "one channel": (lambda v: v[:, :1], r"shape \(1, 1, 384, 384\)"),
    "no batch": (lambda v: v[0], r"shape \(3, 384, 384\)"),
    "NaN": (lambda v: v * math.nan, "100 % of its normals not finite"),
    "infinity": (lambda v: v * math.inf, "100 % of its normals not finite"),
    "zero-length vectors": (lambda v: 0 * v + 0.5, "100 % of its normals not finite or of no length"),
    "another code": (lambda v: 255 * v, "normals of length"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_answers_are_one_error_that_names_the_file(name: str, tmp_path: Path):
    change, message = HOSTILE[name]
    bad = network(OmnidataNetwork, answer(change), tmp_path / "bad.pt")
    photo = Photo(rgb=np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(InputError, match=message) as told:
        bad.predict(photo, assumed_camera(photo, None, None))
    assert "bad.pt" in str(told.value) and "\n" not in str(told.value)


def test_pixels_without_a_direction_are_unknown(tmp_path: Path):
    photo = Photo(rgb=np.zeros((64, 64, 3), np.uint8))
    values = network(OmnidataNetwork, answer(with_holes), tmp_path / "holes.pt").predict(photo, np.eye(3))
    assert not values[:150].any() and np.allclose(np.linalg.norm(values[150:], axis=2), 1)


def test_other_programs_and_files_are_refused(tmp_path: Path):
    photo = Photo(rgb=np.zeros((48, 64, 3), np.uint8))
    K = assumed_camera(photo, None, None)
    two_inputs = network(OmnidataNetwork, tiny.PixelRays(), tmp_path / "two.pt")
    with pytest.raises(InputError, match=r"two.pt: found .*accepted: Omnidata normals's inputs"):
        two_inputs.predict(photo, K)
    (tmp_path / "no.pt").write_bytes(b"no script")
    with pytest.raises(InputError, match="a TorchScript file of Omnidata normals"):
        OmnidataNetwork(ModelChoice(model=str(tmp_path / "no.pt"))).predict(photo, K)
    for choice in (ModelChoice(), ModelChoice(model="somebody/omnidata")):
        with pytest.raises(InputError, match="omnidata:FILE, a local TorchScript file"):
            OmnidataNetwork(choice).predict(photo, K)
    needs = {need.what: need for need in NORMAL_ESTIMATORS.find("omnidata").made.needs()}  # type: ignore[attr-defined]
    assert not needs["weights"].met and "NAME:FILE" in needs["weights"].found


# --- in a run -----------------------------------------------------------------------------------------------------


def painted(folder: Path, signs: Array) -> Array:
    """A folder of boxes on a table whose photo shows their normals, scrambled; the true normal of the table."""
    write_folder(folder)
    given = inputs.read(folder)
    up = camera().T_world_camera[2, :3]
    ball = rays(given.K, given.photo.width, given.photo.height)
    normals = np.broadcast_to(up, ball.shape).copy()
    for i in given.instances:  # each object a ball, as normals go
        rows, columns = np.nonzero(i.mask)
        x, y = (2 * (v - v.min()) / np.ptp(v) - 1 for v in (columns, rows))
        normals[rows, columns] = np.column_stack([0.6 * x, 0.6 * y, -np.sqrt(1 - 0.36 * (x**2 + y**2))])
    from PIL import Image

    Image.fromarray(coloured(normals * signs).rgb).save(folder / "image.png")
    return up


@pytest.mark.parametrize("signs", [(1, 1, 1), (1, 1, -1), (-1, -1, -1)])
def test_a_folder_without_normals_gets_them_in_camera_axes(signs: tuple[int, int, int], tmp_path: Path):
    up = painted(tmp_path / "in", np.array(signs))
    file = tiny.script(tiny.ColourNormals(), tmp_path / "colours.pt")
    backend = NORMAL_ESTIMATORS.find(f"omnidata:{file}", ModelChoice(device="cpu"))
    given = inputs.read(tmp_path / "in", fillers=Fillers(normals=backend))
    assert given.geometry.normals is not None and given.geometry.normals_error is not None
    at = given.geometry.inside(given.ground_mask) if given.ground_mask is not None else None
    assert np.abs(np.median(given.geometry.normals[at], axis=0) - up).max() < 0.02
    (told,) = [d.choice for d in given.decisions if d.choice.startswith("normals")]
    assert "by points" in told and given.fillers["normals"].startswith("omnidata")
    assert given.key != inputs.read(tmp_path / "in").key


def test_a_wrong_statement_is_refused_where_points_say_otherwise(tmp_path: Path):
    painted(tmp_path / "in", np.ones(3))
    file = tiny.script(tiny.ColourNormals(), tmp_path / "colours.pt")
    backend = NORMAL_ESTIMATORS.find(f"omnidata:{file}", ModelChoice(device="cpu", axes="rub"))
    with pytest.raises(InputError, match=r"degrees off those of the points, median, with axes rub; .* show rdf"):
        inputs.read(tmp_path / "in", fillers=Fillers(normals=backend))
    with pytest.raises(InputError, match="--normals-axes: found xyz; accepted: three letters"):
        NORMAL_ESTIMATORS.find(f"omnidata:{file}", ModelChoice(device="cpu", axes="xyz"))


def test_swapped_axes_are_refused(tmp_path: Path):
    """Depth first: no signs make that follow the points."""
    painted(tmp_path / "in", np.ones(3))

    class Swapped(tiny.torch.nn.Module):
        def forward(self, image):
            return image[:, [2, 0, 1]]

    backend = NORMAL_ESTIMATORS.find(f"omnidata:{tiny.script(Swapped(), tmp_path / 'swapped.pt')}")
    with pytest.raises(InputError, match=r"degrees off those of the points|axes"):
        inputs.read(tmp_path / "in", fillers=Fillers(normals=backend))


def test_dsine_takes_the_known_focal_length(tmp_path: Path):
    photo = Photo(rgb=np.zeros((48, 64, 3), np.uint8))
    file = tiny.script(tiny.PixelRays(), tmp_path / "rays.pt")
    image = PromptedImage(photo=photo, instances=(), focal=KnownFocal(pixels=50, sigma=0, source="test"))
    found = DsineNormals(ModelChoice(model=str(file), device="cpu", axes="rdf")).normals(image, None, None)
    expected = rays(np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]), 64, 48)
    assert np.abs(found.values + expected / np.linalg.norm(expected, axis=2, keepdims=True)).max() < 1e-5
    assert isinstance(NORMAL_ESTIMATORS.find("omnidata").made, OmnidataNormals)
