"""The camera and the unit of one photo: drawn pictures of a known camera, exact conics, EXIF, known lengths."""

from __future__ import annotations

import contextlib
import io
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageDraw, TiffImagePlugin
from PIL.ExifTags import IFD, Base

from f3sr.backends.protocols import CameraByPoses, KnownFocal, PromptedImage
from f3sr.core.transforms import Array, rotation_about
from f3sr.errors import InputError
from f3sr.io.exif import FILM_DIAGONAL, ExifError, focal_by_exif
from f3sr.io.images import open_image
from f3sr.io.inputs import Inputs
from f3sr.io.photo_hints import PhotoHints, known_of
from f3sr.metrology.camera_estimate import CameraEstimate, attitude, estimate_camera
from f3sr.metrology.directions import DirectionModel, grouped, log_likelihoods
from f3sr.metrology.edges import edge_points, line_segments
from f3sr.metrology.ellipses import fit_ellipse, fit_ellipses, rims
from f3sr.metrology.ground_metrology import GroundMetrology
from f3sr.metrology.known_sizes import table, usual_size
from f3sr.metrology.posterior import sampled, weighted
from f3sr.metrology.scene_scale import LengthClue, ScaleModel, scene_scale
from f3sr.metrology.tight_box import box_sides
from f3sr.photo_inputs import read_inputs
from f3sr.scene import Photo
from folders import HEIGHT, WIDTH, camera, to_depth, write_folder

SMOOTH = 4
"""Subpixels of a drawn picture, along each axis."""
W, H = 640, 480
FOCAL, PITCH, ROLL = 560.0, math.radians(35), math.radians(2)


def drawn(shapes: list[tuple[Array, int]]) -> NDArray[np.uint8]:
    """A grey picture (H, W, 3) of polygons (n, 2) [px] with their grey levels, in order, with smooth edges."""
    image = Image.new("L", (W * SMOOTH, H * SMOOTH), 120)
    pen = ImageDraw.Draw(image)
    for outline, level in shapes:
        pen.polygon([(float(x), float(y)) for x, y in outline * SMOOTH - 0.5], fill=level)
    small = np.asarray(image.resize((W, H), Image.Resampling.BOX))
    return np.repeat(small[..., None], 3, axis=2)


def projected(points: Array) -> Array:
    """Pixels (n, 2) of places (n, 3) right of, before and above the camera, which looks down and is turned."""
    x, y, z = (points @ attitude(PITCH, ROLL).T).T
    return np.column_stack([FOCAL * x / z + W / 2, FOCAL * y / z + H / 2])


def faces(at: tuple[float, float], size: tuple[float, float, float], yaw: float) -> list[Array]:
    """The faces (4, 3) of a box on the ground, 0.6 below the camera, that it may see: far ones first, the top last."""
    a, b, h = size
    corners = np.array([[-a, -b], [a, -b], [a, b], [-a, b]]) / 2 @ rotation_about([0, 0, 1], yaw)[:2, :2].T + at
    low, high = (np.column_stack([corners, np.full(4, z)]) for z in (-0.6, h - 0.6))
    sides = [np.array([low[k], low[k - 1], high[k - 1], high[k]]) for k in range(4)]
    return [*sorted(sides, key=lambda s: -float(np.linalg.norm(s[:, :2].mean(0)))), high]


def boxes_seen() -> tuple[NDArray[np.uint8], list[NDArray[np.bool_]]]:
    """A picture of three boxes of different turns, and their masks."""
    things = [
        ((-0.16, 0.85), (0.2, 0.1, 0.25), 0.5),
        ((0.2, 0.95), (0.15, 0.2, 0.15), -0.35),
        ((0.03, 0.6), (0.14, 0.1, 0.1), 0.2),
    ]
    shapes, masks = list[tuple[Array, int]](), list[NDArray[np.bool_]]()
    for k, thing in enumerate(things):
        own = [projected(face) for face in faces(*thing)]
        shapes += list(zip(own, (60, 90, 150 + 10 * k, 190, 230), strict=True))
        masks.append(drawn([(outline, 255) for outline in own])[..., 0] > 187)
    for k, mask in enumerate(masks):
        for nearer in masks[k + 1 :]:
            mask &= ~nearer
    return drawn(shapes), masks


@pytest.fixture(scope="module")
def pictured() -> tuple[NDArray[np.uint8], list[NDArray[np.bool_]]]:
    return boxes_seen()


def tilt_of(found: CameraEstimate) -> float:
    return math.degrees(math.acos(min(1.0, float(found.up @ attitude(PITCH, ROLL)[:, 2]))))


# --- edges and ellipses -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.31, 1.1, 2.4])
def test_a_drawn_edge_is_found_to_a_fraction_of_a_pixel(angle: float):
    across = np.array([-math.sin(angle), math.cos(angle)])
    middle = np.array([W / 2 + 0.3, H / 2 - 0.2])
    x, y = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
    covered = np.clip((np.stack([x, y], -1) - middle) @ across + 0.5, 0, 1)
    found = line_segments(edge_points(np.repeat((40 + 150 * covered).astype(np.uint8)[..., None], 3, axis=2)))
    off = (found.reshape(-1, 2) - middle) @ across
    assert len(found) == 1 and np.linalg.norm(found[0, 2:] - found[0, :2]) > 400
    assert np.abs(off).max() < 0.15


def test_points_of_a_conic_give_that_conic():
    t = np.linspace(0.3, 2.6, 20)  # less than half of it
    turn = rotation_about([0, 0, 1], 0.6)[:2, :2]
    points = np.column_stack([80 * np.cos(t), 25 * np.sin(t)]) @ turn.T + [310, 170]
    found = fit_ellipse(points)
    assert found is not None
    np.testing.assert_allclose([found.major, found.minor, *found.centre], [80, 25, 310, 170], rtol=1e-6)
    np.testing.assert_allclose(np.abs(found.axes[:, 1] @ turn[:, 0]), 1, atol=1e-9)


def test_points_on_a_line_have_no_ellipse_and_spoil_no_other():
    t = np.linspace(0, 5, 12)
    line, circle = np.column_stack([t, 2 * t]), np.column_stack([np.cos(t), np.sin(t)])
    none, one = fit_ellipses(np.stack([line, circle]))
    assert none is None and one is not None and one.major == pytest.approx(1)


def test_a_plate_is_a_rim_and_a_square_is_none():
    t = np.linspace(0, 2 * np.pi, 200)
    plate = projected(np.column_stack([0.12 * np.cos(t), 0.8 + 0.12 * np.sin(t), np.full_like(t, -0.55)]))
    square = projected(faces((0.3, 0.9), (0.1, 0.1, 0.1), 0.4)[-1])
    rgb = drawn([(plate, 220), (square, 40)])
    masks = [drawn([(shape, 255)])[..., 0] > 187 for shape in (plate, square)]
    (found,) = rims(masks, edge_points(rgb))
    values = np.column_stack([plate, np.ones(len(plate))])
    steep = np.linalg.norm(2 * (values @ found.conic)[:, :2], axis=1)
    assert np.abs(((values @ found.conic) * values).sum(1) / steep).max() < 0.4  # Sampson's distance [px]


# --- the camera -------------------------------------------------------------------------------------------------


def test_a_drawn_scene_gives_its_camera(pictured: tuple[NDArray[np.uint8], list[NDArray[np.bool_]]]):
    found = estimate_camera(*pictured, None)
    assert tilt_of(found) < 1.5 and abs(math.log(found.focal / FOCAL)) < 0.1
    focal, pitch, roll = found.errors
    assert abs(math.log(found.focal / FOCAL)) < 3 * focal and abs(found.pitch - PITCH) < 3 * pitch
    assert abs(found.roll - ROLL) < 3 * roll


def test_a_told_focal_length_is_kept(pictured: tuple[NDArray[np.uint8], list[NDArray[np.bool_]]]):
    exact = estimate_camera(*pictured, None, focal=KnownFocal(pixels=FOCAL, sigma=0, source="test"))
    assert exact.focal == FOCAL and exact.errors[0] < 0.01 and tilt_of(exact) < 1
    wrong = estimate_camera(*pictured, None, focal=KnownFocal(pixels=1.5 * FOCAL, sigma=0.04, source="test"))
    assert 1.2 * FOCAL < wrong.focal < 1.5 * FOCAL  # EXIF weighs more than three boxes do


def test_a_photo_that_shows_nothing_gives_the_prior():
    found = estimate_camera(np.full((H, W, 3), 128, np.uint8), [], None)
    assert found.segments == 0 and 0.75 * W < found.focal < 1.1 * W
    assert abs(found.roll) < 0.01 and found.errors[0] > 0.15 and found.errors[1] > 0.15


def test_the_ground_plane_lies_below_the_camera_as_high_as_told(
    pictured: tuple[NDArray[np.uint8], list[NDArray[np.bool_]]],
):
    rgb, _ = pictured
    given = KnownFocal(pixels=FOCAL, sigma=0, source="test", centre=(300.0, 250.0))
    image = PromptedImage(photo=Photo(rgb=rgb), instances=(), focal=given, camera_height=1.25)
    made = GroundMetrology().estimate(image)
    np.testing.assert_allclose(made.K, [[FOCAL, 0, 300], [0, FOCAL, 250], [0, 0, 1]])
    points = made.points[made.valid].astype(float)
    normal = np.linalg.svd(points - points.mean(0), full_matrices=False)[2][2]
    np.testing.assert_allclose(np.abs(points @ normal), 1.25, rtol=1e-5)


@pytest.mark.parametrize("sigma", [0.0, 0.01, 0.1])
def test_of_exif_and_poses_the_surer_one_tells_the_focal_length(
    pictured: tuple[NDArray[np.uint8], list[NDArray[np.bool_]]], sigma: float
):
    told = KnownFocal(pixels=FOCAL, sigma=sigma, source="somebody")
    posed = CameraByPoses(focal=KnownFocal(pixels=1.1 * FOCAL, sigma=0.02, source="the poses"), upward=())
    image = PromptedImage(photo=Photo(rgb=pictured[0]), instances=(), focal=told, posed=posed)
    made = GroundMetrology().estimate(image)
    surer = told if sigma < 0.02 else posed.focal
    assert f"told by {surer.source}" in made.told
    assert ("against 616 px +- 2 % by the poses" in made.told) == (sigma < 0.02)
    assert made.K[0, 0] == pytest.approx(surer.pixels, rel=0.05)
    assert made.focal_error == pytest.approx(surer.sigma, abs=0.01)


def test_facets_of_standing_boxes_tell_up_where_a_photo_shows_nothing():
    """Three boxes that lean by three degrees each, in a camera that nothing else tells of."""
    rng, up = np.random.default_rng(3), attitude(PITCH, ROLL)[:, 2]
    upward = list[Array]()
    for yaw in (0.3, 1.0, -0.7):
        axes = attitude(PITCH, ROLL) @ rotation_about([0, 0, 1], yaw) @ rotation_about(rng.normal(size=3), 0.05)
        upward.append(np.concatenate([axes.T, -axes.T]))
    blank = np.full((H, W, 3), 128, np.uint8)
    without, found = estimate_camera(blank, [], None), estimate_camera(blank, [], None, upward=upward)
    assert math.degrees(math.acos(without.up @ up)) > 5 and tilt_of(found) < 3
    assert found.errors[1] < 0.3 * without.errors[1]


def test_likelihoods_do_not_depend_on_order_ends_or_quarter_turns():
    rng = np.random.default_rng(1)
    ends = rng.uniform(0, 400, (30, 4))
    group = rng.integers(0, 3, 30)
    model = DirectionModel()
    R = attitude(0.5, 0.05)
    quarter = R @ rotation_about([0, 0, 1], math.pi / 2)

    def value(ends: Array, group: NDArray[np.int64], R: Array) -> Array:
        segments = grouped(ends, group, objects=2, centre=np.array([200.0, 200]), model=model)
        return log_likelihoods(segments, np.array([500.0]), R[None], model, step=math.radians(1))

    plain, order = value(ends, group, R), rng.permutation(30)
    np.testing.assert_allclose(value(ends[order], group[order], R), plain)
    np.testing.assert_allclose(value(ends.reshape(-1, 2, 2)[:, ::-1].reshape(-1, 4), group, R), plain)
    np.testing.assert_allclose(value(ends, group, quarter), plain, rtol=1e-6)


def test_edges_of_boxes_are_likeliest_under_their_camera():
    edges = np.array([[[s[k], s[(k + 1) % 4]] for k in range(4)] for s in faces((0.1, 0.9), (0.2, 0.1, 0.2), 0.4)])
    ends = projected(edges.reshape(-1, 3)).reshape(-1, 4)
    model = DirectionModel()
    segments = grouped(ends, np.zeros(len(ends), np.int64), objects=1, centre=np.array([W / 2, H / 2]), model=model)

    def value(focal: float, pitch: float, roll: float) -> float:
        return float(log_likelihoods(segments, np.array([focal]), attitude(pitch, roll)[None], model, step=0.002)[0, 0])

    best = value(FOCAL, PITCH, ROLL)
    for focal, pitch, roll in ((1.2, 0, 0), (0.8, 0, 0), (1, 0.06, 0), (1, -0.06, 0), (1, 0, 0.06), (1, 0, -0.06)):
        assert best > value(focal * FOCAL, PITCH + pitch, ROLL + roll)


def test_an_object_that_leans_is_no_horizon_but_a_wall_is():
    """A box tilted by 2 degrees: as an object it hardly speaks against the camera, as a wall it does."""
    edges = np.array([[[s[k], s[(k + 1) % 4]] for k in range(4)] for s in faces((0.1, 0.9), (0.2, 0.1, 0.2), 0.4)])
    centre = np.array([0.1, 0.9, -0.6])
    leaning = (edges - centre) @ rotation_about([0, 1, 0], math.radians(2)).T + centre
    model = DirectionModel()

    def lost(lean: float, objects: int) -> float:
        values = []
        for shown in (edges, leaning):
            ends = projected(shown.reshape(-1, 3)).reshape(-1, 4)
            middle = np.array([W / 2, H / 2])
            segments = grouped(ends, np.zeros(len(ends), np.int64), objects=objects, centre=middle, model=model)
            R = attitude(PITCH, ROLL)[None]
            found = log_likelihoods(segments, np.array([FOCAL]), R, replace(model, lean=lean), step=0.002)
            values.append(float(found[0, 0]))
        return values[0] - values[1]

    assert lost(model.lean, 1) < 0.6 * lost(0.0, 1)
    assert lost(model.lean, 0) == lost(0.0, 0) > 0


def test_samples_give_mean_and_spread_and_the_heavier_of_two_clusters():
    mean, spread = np.array([1.0, -2]), np.array([0.5, 0.2])
    start = weighted(np.zeros((1, 2)), np.zeros(1))

    def normal(x: Array) -> Array:
        return -0.5 * (((x - mean) / spread) ** 2).sum(1)

    found = sampled(start, [normal] * 4, spacing=np.array([2.0, 2]), least=np.full(2, 1e-3))
    np.testing.assert_allclose(found.mean, mean, atol=0.06)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance(found.mean))), spread, rtol=0.15)
    two = weighted(np.array([[0.0], [0.1], [5.0]]), np.log([0.3, 0.3, 0.4]))
    assert two.centre(np.array([0.5]))[0] == pytest.approx(0.05, abs=0.01)


# --- EXIF -------------------------------------------------------------------------------------------------------


def jpeg(tags: dict[int, Any], *, size: tuple[int, int] = (400, 300), orientation: int = 1) -> Image.Image:
    """A JPEG with EXIF tags, written and read."""
    exif = Image.Exif()
    exif[Base.Orientation] = orientation
    exif.get_ifd(IFD.Exif).update(tags)
    stream = io.BytesIO()
    Image.new("RGB", size, (90, 120, 60)).save(stream, "JPEG", exif=exif)
    return Image.open(io.BytesIO(stream.getvalue()))


def rational(a: int, b: int = 1) -> TiffImagePlugin.IFDRational:
    return TiffImagePlugin.IFDRational(a, b)


F35, LENGTH, ZOOM = Base.FocalLengthIn35mmFilm, Base.FocalLength, Base.DigitalZoomRatio
PLANE, UNIT = Base.FocalPlaneXResolution, Base.FocalPlaneResolutionUnit
WIDE, HIGH = Base.ExifImageWidth, Base.ExifImageHeight


def test_exif_gives_the_focal_length_by_diagonals():
    found = focal_by_exif(jpeg({F35: 26}))
    assert found is not None and found.pixels == pytest.approx(26 * 500 / FILM_DIAGONAL)
    full = focal_by_exif(jpeg({F35: 36}, size=(360, 240)))
    assert full is not None and full.pixels == pytest.approx(360)  # on film itself, a pixel per tenth of a millimetre


def test_exif_gives_the_focal_length_by_the_sensor():
    # 25 mm over pixels of 1 / 200 mm, in a photo of half size.
    tags = {LENGTH: rational(25), PLANE: rational(2000), UNIT: 3, WIDE: 800, HIGH: 600}
    found = focal_by_exif(jpeg(tags))
    assert found is not None and found.pixels == pytest.approx(25 * 200 / 2, rel=1e-6)


def test_digital_zoom_lengthens_and_makes_less_sure():
    plain, zoomed = focal_by_exif(jpeg({F35: 26})), focal_by_exif(jpeg({F35: 26, ZOOM: rational(2)}))
    assert plain is not None and zoomed is not None
    assert plain.pixels < zoomed.pixels < 2 * plain.pixels and zoomed.sigma > 0.3
    none = focal_by_exif(jpeg({F35: 26, ZOOM: rational(0)}))
    assert none is not None and none.pixels == plain.pixels


@pytest.mark.parametrize("tags", [{}, {F35: 0}, {LENGTH: rational(4)}, {ZOOM: rational(3)}])
def test_exif_without_a_focal_length_says_nothing(tags: dict[int, Any]):
    assert focal_by_exif(jpeg(tags)) is None


@pytest.mark.parametrize(
    ("tags", "why"),
    [
        ({F35: 60000}, "no lens"),
        ({F35: 1}, "no lens"),
        ({LENGTH: rational(4, 0), PLANE: rational(2000), WIDE: 400, HIGH: 300}, "FocalLength"),
        ({LENGTH: rational(25), PLANE: rational(0, 1), WIDE: 400, HIGH: 300}, "FocalPlaneXResolution"),
        ({LENGTH: rational(25), PLANE: rational(2000), UNIT: 9, WIDE: 400, HIGH: 300}, "Unit"),
        ({LENGTH: rational(25), PLANE: rational(2000)}, "first size"),
        ({F35: 26, WIDE: 900, HIGH: 300}, "cropped"),
        ({F35: 26, ZOOM: rational(1, 3)}, "DigitalZoomRatio"),
        ({F35: 26, ZOOM: rational(1, 0)}, "DigitalZoomRatio"),
        ({F35: "long"}, "FocalLengthIn35mmFilm"),
    ],
)
def test_hostile_exif_is_refused_with_its_reason(tags: dict[int, Any], why: str):
    image = jpeg({})
    image.getexif().get_ifd(IFD.Exif).update(tags)
    with pytest.raises(ExifError, match=why):
        focal_by_exif(image)


@pytest.mark.parametrize(
    "blob",
    [
        b"II*\0\xff\xff\xff\x7f",
        b"MM\0*\0\0\0\x08\xff\xff" + bytes(range(256)),
        b"II*\0\x08\0\0\0\x01\0\x69\x87\x04\0\x01\0\0\0\x08\0\0\0",  # a directory inside itself
        bytes(range(200)),
    ],
)
def test_broken_exif_spoils_no_photo(tmp_path: Path, blob: bytes):
    file = tmp_path / "image.jpg"
    Image.new("RGB", (64, 48)).save(file, exif=b"Exif\0\0" + blob)
    image = open_image(file)
    assert image.size == (64, 48)
    with contextlib.suppress(ExifError):
        assert focal_by_exif(image) is None


def test_a_turned_photo_has_the_same_focal_length(tmp_path: Path):
    file = tmp_path / "image.jpg"
    exif = Image.Exif()
    exif[Base.Orientation] = 6
    exif.get_ifd(IFD.Exif).update({F35: 26, WIDE: 400, HIGH: 300})
    Image.new("RGB", (400, 300)).save(file, exif=exif)
    image = open_image(file)
    found = focal_by_exif(image)
    assert image.size == (300, 400)
    assert found is not None and found.pixels == pytest.approx(26 * 500 / FILM_DIAGONAL)


# --- the unit ---------------------------------------------------------------------------------------------------


def clue(found: float, true: float, sigma: float = 0.1, *, given: bool = False) -> LengthClue:
    return LengthClue(id=0, name="thing", found=found, true=true, sigma=sigma, given=given)


def test_without_clues_the_unit_is_the_usual_height():
    scale = scene_scale([])
    assert scale.factor == pytest.approx(1) and scale.error == pytest.approx(ScaleModel().height, rel=1e-3)


def test_a_known_length_decides_and_usual_ones_have_no_say():
    scale = scene_scale([clue(2.0, 0.5, 0.0, given=True), clue(1.0, 1.0), clue(1.0, 1.0)])
    assert scale.factor == pytest.approx(0.25, rel=1e-3)
    assert scale.error == pytest.approx(math.hypot(math.sqrt(2) * ScaleModel().shape, ScaleModel().common), rel=0.01)


def test_a_known_length_decides_however_high_the_camera_is_usually():
    assert scene_scale([clue(1.0, 20.0, given=True)]).factor == pytest.approx(20, rel=1e-3)


def test_one_shape_that_is_wrong_does_not_move_the_unit_of_three_known_lengths():
    scale = scene_scale([clue(1.0, 0.5, given=True), clue(1.0, 0.51, given=True), clue(1.0, 1.2, given=True)])
    assert scale.factor == pytest.approx(0.51, rel=1e-3)


def test_two_known_lengths_that_disagree_meet_in_the_middle():
    scale = scene_scale([clue(1.0, 0.5, given=True), clue(1.0, 0.6, given=True)])
    assert scale.factor == pytest.approx(math.sqrt(0.3), rel=1e-3)


def test_one_strange_size_does_not_move_the_unit():
    four = [clue(1.0, 0.5), clue(1.0, 0.52), clue(1.0, 0.48), clue(1.0, 0.5)]
    plain, spoilt = scene_scale(four), scene_scale([*four, clue(1.0, 30.0)])
    assert plain.factor == pytest.approx(0.5, rel=0.05) and spoilt.factor == pytest.approx(plain.factor, rel=0.05)


def test_a_given_height_keeps_its_unit():
    scale = scene_scale([clue(1.0, 0.5)], height_given=True)
    assert scale.factor == pytest.approx(1) and scale.error < 0.06


def test_the_unit_of_a_scene_does_not_depend_on_its_unit():
    things = [clue(1.0, 0.5, given=True), clue(2.0, 1.1, given=True)]
    larger = [clue(3 * c.found, c.true, given=True) for c in things]
    assert scene_scale(larger).factor == pytest.approx(scene_scale(things).factor / 3, rel=0.01)


def test_the_sides_of_a_turned_box():
    corners = np.array(np.meshgrid([0, 0.3], [0, 0.2], [0, 0.05])).reshape(3, -1).T
    R = rotation_about([1, 0, 0], 0.7) @ rotation_about([0, 0, 1], 0.4)
    np.testing.assert_allclose(box_sides(corners @ R.T + [1, 2, 3]), [0.3, 0.2, 0.05], rtol=1e-9)


def test_the_table_of_usual_sizes_is_sound():
    assert 60 <= len({id(size) for size in table().values()}) <= 150
    for name, size in table().items():
        assert 0.01 <= size.metres <= 6 and 0.005 <= size.spread <= 0.5 and size.why, name


@pytest.mark.parametrize(
    ("label", "metres"),
    [("red mug", 0.118), ("wine bottle", 0.3), ("bottle of wine", 0.23), ("coffee table", 1.0), ("Tennis Ball", 0.067)],
)
def test_a_label_tells_the_usual_size_of_its_thing(label: str, metres: float):
    size = usual_size(label)
    assert size is not None and size.metres == metres


@pytest.mark.parametrize("label", ["", "thing", "mugger", "00", "toy car"])
def test_other_labels_tell_none(label: str):
    assert usual_size(label) is None


# --- folders ----------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_folder(tmp_path / "given")
    return tmp_path / "given"


def read(folder: Path, *ignore: str, **hints: Any) -> Inputs:
    return read_inputs(folder, ignore=ignore, hints=PhotoHints(**hints))


def said(inputs: Inputs, text: str) -> bool:
    return any(text in d.choice or text in d.reason for d in inputs.decisions)


def test_a_material_that_would_change_nothing_is_refused(folder: Path):
    def give(**material: Any) -> None:
        (folder / "materials.json").write_text(json.dumps({"objects": [{"id": 2, **material}]}))

    give(material="stel")
    with pytest.raises(InputError, match=r"object 2 of the material 'stel'; accepted: wood, .*, a label"):
        read_inputs(folder)
    for known in ({"material": "steel"}, {"material": "wooden spoon"}, {"material": "moon rock", "density": 3300.0}):
        give(**known)
        assert read_inputs(folder).properties[2].material == known["material"]


def longest(inputs: Inputs, id: int) -> float:
    asset = inputs.assets[id]
    return float(box_sides(asset.scale * asset.mesh.vertices)[0])


def test_a_known_length_scales_the_scene_and_keeps_the_picture(folder: Path):
    plain, known = read(folder, "geometry"), read(folder, "geometry", known={"tall box": 1.0})
    assert longest(known, 7) == pytest.approx(1.0, rel=1e-3)
    factor = longest(known, 7) / longest(plain, 7)
    for id in plain.assets:
        one, other = plain.assets[id], known.assets[id]
        np.testing.assert_allclose(other.T_camera_object[:3, 3], factor * one.T_camera_object[:3, 3])
        assert other.scale == pytest.approx(factor * one.scale)
    np.testing.assert_allclose(known.geometry.points, factor * plain.geometry.points, rtol=1e-5)
    assert known.key != plain.key and (known.K == plain.K).all()
    assert said(known, "tall box (7) is 1 m") and said(plain, "unknown unit")


def test_pixels_that_lie_apart_make_no_object_longer(folder: Path):
    clean = read(folder, "geometry", known={"tall box": 0.3}).assets[7].scale
    file = next((folder / "masks").glob("07*"))
    mask = np.array(Image.open(file).convert("L"))
    mask[2:6, 2:6] = 255
    Image.fromarray(mask).save(file)
    assert read(folder, "geometry", known={"tall box": 0.3}).assets[7].scale == pytest.approx(clean, rel=0.01)


def test_an_id_names_an_object_too(folder: Path):
    by_id, by_label = read(folder, "geometry", known={"7": 0.3}), read(folder, "geometry", known={"tall box": 0.3})
    assert by_id.key == by_label.key


def test_a_told_focal_length_and_height_are_used(folder: Path):
    given = read(folder, "geometry", focal=230.0, camera_height=0.5)
    assert given.K[0, 0] == 230 and said(given, "told by --focal") and said(given, "is, as given, 0.5 m")
    points = given.geometry.points[given.geometry.valid].astype(float)
    normal = np.linalg.svd(points - points.mean(0), full_matrices=False)[2][2]
    assert np.abs(points @ normal).mean() == pytest.approx(0.5, rel=1e-4)
    by_film = read(folder, "geometry", focal_35mm=36.0)
    assert by_film.K[0, 0] == pytest.approx(36 * math.hypot(WIDTH, HEIGHT) / FILM_DIAGONAL)


def test_exif_is_used_and_hostile_exif_is_told(folder: Path):
    with Image.open(folder / "image.png") as image:
        rgb = image.convert("RGB")
    (folder / "image.png").unlink()
    for f35, told in ((40, "told by EXIF"), (60000, "EXIF ignored")):
        exif = Image.Exif()
        exif.get_ifd(IFD.Exif)[F35] = f35
        rgb.save(folder / "image.jpg", exif=exif, quality=98)
        given = read(folder, "geometry")
        assert said(given, told)
    assert not said(read(folder), "EXIF")  # the folder's own geometry has its camera


def test_intrinsics_alone_give_the_camera(folder: Path):
    (folder / "geometry.npz").unlink()
    (folder / "intrinsics.json").write_text(json.dumps({"K": camera().K.tolist()}))
    given = read(folder)
    np.testing.assert_allclose(given.K, camera().K)
    assert given.geometry.source == "ground" and said(given, "told by intrinsics.json")
    with pytest.raises(InputError, match="--focal: found intrinsics"):
        read(folder, focal=230.0)


def test_depth_alone_is_accepted(folder: Path):
    to_depth(folder)
    (folder / "intrinsics.json").unlink()
    given = read(folder, focal=230.0)
    assert given.geometry.source == "sensor" and given.K[0, 0] == 230
    assert said(given, "depths in millimetres") and said(given, "depths without intrinsics.json")
    assert any(d.fallback and "camera: focal length" in d.choice for d in read(folder).decisions)
    with pytest.raises(InputError, match="--known"):
        read(folder, known={"7": 1.0})


def test_depths_of_floats_alone_are_metres(folder: Path):
    to_depth(folder)
    depth = np.asarray(Image.open(folder / "depth.png")).astype(np.float32) / 1000
    for name in ("depth.png", "intrinsics.json"):
        (folder / name).unlink()
    np.save(folder / "depth.npy", depth)
    given = read(folder, focal=230.0)
    assert said(given, "depths in metres")
    assert np.median(given.geometry.points[given.geometry.valid][:, 2]) == pytest.approx(np.median(depth[depth > 0]))


@pytest.mark.parametrize(
    "hints", [{"focal": 200.0}, {"focal_35mm": 30.0}, {"camera_height": 1.0}, {"known": {"7": 1.0}}]
)
def test_hints_beside_a_given_geometry_are_refused(folder: Path, hints: dict[str, Any]):
    with pytest.raises(InputError, match="only where geometry is made from the photo"):
        read(folder, **hints)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: PhotoHints(camera_height=math.nan),
        lambda: PhotoHints(camera_height=0),
        lambda: PhotoHints(focal_35mm=2),
        lambda: PhotoHints(focal=200, focal_35mm=30),
        lambda: PhotoHints(known={"mug": -1}),
        lambda: known_of("mug"),
        lambda: known_of("mug=tall"),
        lambda: known_of("mug=nan"),
        lambda: known_of("=1"),
        lambda: known_of("mug=1,Mug=2"),
    ],
)
def test_impossible_hints_are_refused(wrong: Callable[[], object]):
    with pytest.raises(InputError, match="accepted"):
        wrong()


@pytest.mark.parametrize("hints", [{"focal": 1.0}, {"known": {"teapot": 1.0}}, {"known": {"7": 1.0, "tall box": 1.0}}])
def test_hints_that_do_not_fit_the_photo_are_refused(folder: Path, hints: dict[str, Any]):
    with pytest.raises(InputError, match="--"):
        read(folder, "geometry", **hints)


def test_known_lengths_are_read():
    assert known_of(" Red  Mug = 0.12, 3=0.3 ,") == {"red mug": 0.12, "3": 0.3}
