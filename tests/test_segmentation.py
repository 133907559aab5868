"""Masks from boxes, strokes and other programs: laws, a disc found to the pixel, hostile files, whole folders."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import f3sr
from f3sr.backends.protocols import Prompt
from f3sr.backends.registry import Backend
from f3sr.cli.main import main
from f3sr.errors import F3srWarning, InputError, OutputError
from f3sr.io.input_folder import InputFolder
from f3sr.io.masks import read_instances
from f3sr.runtime import atomic_folder
from f3sr.scene import Photo
from f3sr.segmentation.coco_document import RunLengthCode
from f3sr.segmentation.coco_masks import decoded, read_coco
from f3sr.segmentation.colour_mixture import colour_mixture, lab
from f3sr.segmentation.grabcut import GrabCut
from f3sr.segmentation.grid_cut import pixel_grid
from f3sr.segmentation.input_folder_writer import OutlinedObject, mask_name, read_photo, write_input_folder
from f3sr.segmentation.label_masks import read_cutouts, read_label_map
from f3sr.segmentation.ownership import disjoint, none_vanished
from f3sr.segmentation.segmenters import DEFAULT_SEGMENTER, SEGMENTERS
from f3sr.segmentation.selection import Selection, outlined
from f3sr.segmentation.selection_json import read_selection, selection_bytes

Mask = NDArray[np.bool_]
H, W = 120, 160
GREY, RED, BLUE, GREEN = (150, 145, 140), (190, 40, 40), (40, 60, 190), (40, 150, 60)


def disc(x: float, y: float, radius: float) -> Mask:
    return np.hypot(np.arange(W)[None] + 0.5 - x, np.arange(H)[:, None] + 0.5 - y) < radius


def painted(*parts: tuple[Mask, tuple[int, int, int]], noise: float = 3.0, seed: int = 0) -> Photo:
    """Parts on grey ground, the later ones on top, with noise of a sensor."""
    rgb = np.full((H, W, 3), GREY, float)
    for mask, colour in parts:
        rgb[mask] = colour
    rgb += np.random.default_rng(seed).normal(scale=noise, size=rgb.shape)
    return Photo(rgb=rgb.clip(0, 255).astype(np.uint8))


def box_of(mask: Mask, loose: float = 5) -> tuple[float, float, float, float]:
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    low = max(0.0, columns[0] - loose), max(0.0, rows[0] - loose)
    return *low, min(float(W), columns[-1] + 1 + loose), min(float(H), rows[-1] + 1 + loose)


def iou(a: Mask, b: Mask) -> float:
    return float((a & b).sum() / (a | b).sum())


@pytest.fixture
def grabcut() -> Backend:
    return SEGMENTERS.find(DEFAULT_SEGMENTER)


# --- cuts and colours -------------------------------------------------------------------------------------------------


def test_a_cut_is_the_cheapest_of_all_masks():
    """Against every mask of a tiny grid."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        grid = pixel_grid(rng.normal(size=(3, 4, 3)), weight=2.0, floor=0.01)
        cost = rng.normal(scale=3.0, size=(3, 4))
        cost[0, 0], cost[2, 3] = -np.inf, np.inf
        finite = np.nan_to_num(cost, posinf=0, neginf=0)
        masks = [((k >> np.arange(12)) & 1).astype(bool).reshape(3, 4) for k in range(2**12)]
        prices = [finite[m].sum() + grid.price(m) for m in masks if m[0, 0] and not m[2, 3]]
        found = grid.cut(cost)
        assert found[0, 0] and not found[2, 3]
        assert finite[found].sum() + grid.price(found) == pytest.approx(min(prices), abs=0.02)


def test_lab_of_known_colours():
    known = lab(np.array([[255, 255, 255], [0, 0, 0], [255, 0, 0]], np.uint8))
    assert known == pytest.approx(np.array([[100, 0, 0], [0, 0, 0], [53.24, 80.09, 67.20]]), abs=0.05)


def test_colours_cost_least_where_they_are_frequent():
    rng = np.random.default_rng(0)
    mixture = colour_mixture(np.concatenate([rng.normal([50, 20, 0], 2, (500, 3)), rng.normal([80, 0, 9], 2, (99, 3))]))
    frequent, rare, never = mixture.cost(np.array([[50.0, 20, 0], [80, 0, 9], [10, -60, 50]]))
    assert frequent < rare < never < 14


# --- the segmenter ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("radius", [8, 20, 40])
def test_a_disc_is_found_to_a_pixel(radius: int):
    true = disc(83.3, 61.2, radius)
    found = GrabCut().segment(painted((true, RED)), [Prompt(box=box_of(true))])[0]
    assert disc(83.3, 61.2, radius - 1.5)[~found].sum() == 0
    assert found[~disc(83.3, 61.2, radius + 1.5)].sum() == 0


def test_a_thin_rod_across_its_box_is_found():
    x, y = np.arange(W)[None] + 0.5, np.arange(H)[:, None] + 0.5
    rod = (np.abs((x - 80) * 0.6 - (y - 60) * 0.8) < 3) & (np.abs((x - 80) * 0.8 + (y - 60) * 0.6) < 55)
    found = GrabCut().segment(painted((rod, BLUE)), [Prompt(box=box_of(rod))])[0]
    assert iou(found, rod) > 0.9


def scene() -> tuple[Photo, list[Mask]]:
    """A disc before a plate, and one by itself."""
    plate, ball, other = disc(60, 70, 38), disc(65, 62, 14), disc(130, 40, 16)
    return painted((plate, BLUE), (ball, RED), (other, GREEN)), [plate & ~ball, ball, other]


def test_objects_before_others_are_told_apart():
    photo, true = scene()
    found = GrabCut().segment(photo, [Prompt(box=box_of(m)) for m in true])
    assert min(iou(f, t) for f, t in zip(found, true, strict=True)) > 0.95
    assert np.sum(found, axis=0).max() == 1


def test_the_order_of_prompts_changes_no_mask():
    photo, true = scene()
    prompts = [Prompt(box=box_of(m)) for m in true]
    forward, back = GrabCut().segment(photo, prompts), GrabCut().segment(photo, prompts[::-1])
    for a, b in zip(forward, back[::-1], strict=True):
        assert np.array_equal(a, b)


def test_what_was_kept_is_what_would_be_found():
    photo, true = scene()
    prompts = [Prompt(box=box_of(m)) for m in true]
    stroked = [prompts[0], prompts[1], Prompt(box=prompts[2].box, outside=(((118.0, 30.0),),))]
    kept = GrabCut()
    kept.segment(photo, prompts)
    for a, b in zip(kept.segment(photo, stroked), GrabCut().segment(photo, stroked), strict=True):
        assert np.array_equal(a, b)


def test_strokes_are_obeyed():
    true = disc(80, 60, 25)
    half = true & (np.arange(W)[None] > 80)
    photo = painted((true, RED), (half, GREEN))
    stroke = ((85.0, 60.0), (100.0, 60.0))
    without = GrabCut().segment(photo, [Prompt(box=box_of(true), outside=(stroke,))])[0]
    assert not without[60, 85:100].any() and iou(without, true & ~half) > 0.85
    within = GrabCut().segment(photo, [Prompt(box=box_of(true), inside=(stroke,))])[0]
    assert within[60, 85:100].all() and iou(within, true) > 0.95


def test_a_stroke_inside_one_object_is_in_no_other():
    photo, true = scene()
    click = ((40.0, 75.0),)
    prompts = [Prompt(box=box_of(true[0])), Prompt(box=box_of(true[0]), inside=(click,))]
    found = GrabCut().segment(photo, prompts)
    assert found[1][75, 40] and not found[0][75, 40]


def test_a_click_alone_finds_its_object():
    photo, true = scene()
    found = GrabCut().segment(photo, [Prompt(inside=(((130.0, 40.0),),))])[0]
    assert iou(found, true[2]) > 0.9


def test_flat_photos_and_odd_boxes_give_masks():
    flat = Photo(rgb=np.full((H, W, 3), 90, np.uint8))
    prompts = [Prompt(box=b) for b in ((0, 0, W, H), (0, 0, 4, 4), (155.5, 115.5, 160, 120), (10, 10, 14.2, 100))]
    assert all(mask.any() for mask in GrabCut().segment(flat, prompts[:1]))
    assert all(mask.any() for mask in GrabCut().segment(flat, prompts[1:]))


# --- masks told apart, and the ground -------------------------------------------------------------------------------


def test_shared_pixels_go_to_the_mask_with_their_colour():
    left, right = disc(60, 60, 30), disc(100, 60, 30) & ~disc(60, 60, 30)
    photo = painted((left, RED), (right, BLUE))
    claimed = [left | (right & (np.arange(W)[None] < 95)), right | (left & (np.arange(W)[None] > 70))]
    apart = disjoint(photo.rgb, claimed, [box_of(m) for m in claimed])
    assert not (apart[0] & apart[1]).any()
    assert iou(apart[0], left) > 0.97 and iou(apart[1], right) > 0.97


def test_no_mask_vanishes():
    a, b = disc(60, 60, 20), disc(60, 60, 20)
    apart = none_vanished(disjoint(painted((a, RED)).rgb, [a, b], [box_of(a), box_of(b)]), [a, b])
    assert all(m.any() for m in none_vanished([np.zeros_like(a), a], [disc(60, 60, 5), a]))
    assert not (apart[0] & apart[1]).any()


def test_the_ground_is_what_things_stand_on(grabcut: Backend):
    wall = np.zeros((H, W), bool)
    wall[:45] = True
    ball = disc(80, 70, 20)
    photo = painted((wall, GREEN), (ball, RED))
    ground = outlined(photo, Selection(prompts=(Prompt(box=box_of(ball)),)), grabcut).ground
    assert iou(ground, ~wall & ~ball) > 0.97
    stroke = Prompt(inside=(((20.0, 20.0), (140.0, 22.0)),))
    told = outlined(photo, Selection(prompts=(Prompt(box=box_of(ball)),), ground=stroke), grabcut)
    assert iou(told.ground, wall & ~ball) > 0.97
    assert not (told.ground & told.masks[0]).any()


# --- prompts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("prompt", "found"),
    [
        (Prompt(), "neither a box nor a stroke"),
        (Prompt(box=(0, 0, W + 1, 9)), "the box 0, 0, 161, 9"),
        (Prompt(box=(0, 0, float("nan"), 9)), "nan"),
        (Prompt(box=(9, 9, 9, 20)), "the box 9, 9, 9, 20"),
        (Prompt(inside=(((1, -1),),)), "a stroke through 1, -1"),
        (Prompt(inside=((),)), "a stroke without a point"),
        (Prompt(box=(0, 0, 9, 9), label="a\nb"), "the label"),
    ],
)
def test_prompts_that_the_photo_cannot_have_are_refused(prompt: Prompt, found: str, grabcut: Backend):
    with pytest.raises(InputError, match=found):
        outlined(painted(), Selection(prompts=(prompt,)), grabcut)


def test_answers_are_checked():
    class Blind:
        def segment(self, photo: Photo, prompts: object) -> list[Mask]:
            return [np.zeros((H, W), bool)]

    backend = Backend(kind="segmentation", name="blind", version="1", made=Blind())
    with pytest.raises(InputError, match="mask 0 without a pixel"):
        outlined(painted(), Selection(prompts=(Prompt(box=(0, 0, 9, 9)),)), backend)


def test_a_selection_survives_its_file(tmp_path: Path):
    strokes = (((1.0, 2.5), (3.0, 4.0)),)
    selection = Selection(
        prompts=(Prompt(label="Löffel", box=(1, 2, 30, 40.5)), Prompt(inside=strokes)), ground=Prompt(outside=strokes)
    )
    (tmp_path / "prompts.json").write_bytes(selection_bytes(selection))
    again = read_selection(tmp_path / "prompts.json")
    assert asdict(again) == asdict(selection)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"format": "f3sr prompts", "version": 2, "prompts": []}',
        '{"format": "f3sr prompts", "version": 1, "prompts": [], "more": 1}',
        '{"format": "f3sr prompts", "version": 1, "prompts": [{"box": [1, 2, 3]}]}',
        '{"format": "f3sr prompts", "version": 1, "prompts": [{"inside": [[]]}]}',
        '{"format": "f3sr prompts", "version": 1, "prompts": [{"inside": [[[1, NaN]]]}]}',
    ],
)
def test_other_documents_are_no_selection(text: str, tmp_path: Path):
    (tmp_path / "prompts.json").write_text(text)
    with pytest.raises(InputError):
        read_selection(tmp_path / "prompts.json")


# --- masks of other programs ------------------------------------------------------------------------------------------


def encoded(mask: Mask) -> list[int]:
    """Runs of 0 and 1 in turn down the columns."""
    flat = mask.T.ravel().astype(int)
    changes = np.flatnonzero(np.diff(flat)) + 1
    runs = np.diff([0, *changes, len(flat)]).tolist()
    return [0, *runs] if flat[0] else runs


def compressed(runs: list[int]) -> str:
    """The same as text: differences to the run before the last, five bits a character."""
    text = ""
    for k, run in enumerate(runs):
        value, more = run - (runs[k - 2] if k > 2 else 0), True
        while more:
            bits, value = value & 31, value >> 5
            more = value != (-1 if bits & 16 else 0)
            text += chr(48 + (bits | 32 if more else bits))
    return text


def test_run_length_codes_are_read_back():
    rng = np.random.default_rng(1)
    masks = [scene()[1][0], rng.random((7, 13)) < 0.5, np.ones((5, 4), bool), np.zeros((5, 4), bool)]
    for mask in masks:
        for counts in (encoded(mask), compressed(encoded(mask))):
            assert np.array_equal(decoded(RunLengthCode(size=mask.shape, counts=counts)), mask)


def test_a_code_worked_out_by_hand():
    """Of 3 rows and 2 columns: the runs 2, 2, 2 are 0 0 1 / 1 0 0 down the columns, and '222' in text."""
    true = [[False, True], [False, False], [True, False]]
    assert decoded(RunLengthCode(size=(3, 2), counts=[2, 2, 2])).tolist() == true
    assert decoded(RunLengthCode(size=(3, 2), counts="222")).tolist() == true


@pytest.mark.parametrize("counts", [[5], [7], [-1, 7], [2**62, 2**62], "", "2", "é", "P" * 40, "O", "oooooooooo"])
def test_codes_that_do_not_fill_their_mask_are_refused(counts: list[int] | str):
    with pytest.raises(ValueError):
        decoded(RunLengthCode(size=(3, 2), counts=counts))


def coco(file: Path, *segmentations: object, **more: object) -> Path:
    annotations = [{"image_id": 1, "category_id": 7, "segmentation": s} for s in segmentations]
    tree = {"images": [{"id": 1, "file_name": "a.png"}], "annotations": annotations, **more}
    file.write_text(json.dumps(tree))
    return file


def test_a_category_is_called_by_what_a_terminal_can_show(tmp_path: Path):
    square = [[10, 20, 30, 20, 30, 50, 10, 50]]
    file = coco(tmp_path / "a.json", square, categories=[{"id": 7, "name": "cu\x1b[31mp"}])
    with pytest.raises(InputError, match="not printable"):
        read_coco(file, painted())


def test_coco_files(tmp_path: Path):
    mask = disc(50, 50, 20)
    rle = {"size": [H, W], "counts": compressed(encoded(mask))}
    square = [[10, 20, 30, 20, 30, 50, 10, 50]]
    file = coco(tmp_path / "a.json", rle, square, categories=[{"id": 7, "name": "cup"}])
    found = read_coco(file, painted())
    assert [o.label for o in found.values()] == ["cup", "cup"]
    assert np.array_equal(found[0].mask, mask)
    true = np.zeros((H, W), bool)
    true[20:50, 10:30] = True
    assert np.array_equal(found[1].mask, true)
    file.write_text(json.dumps([{"segmentation": rle}]))
    assert np.array_equal(read_coco(file, painted())[0].mask, mask)


@pytest.mark.parametrize(
    "segmentation",
    [
        {"size": [9, 9], "counts": [81]},
        {"size": [H, W], "counts": [H * W]},
        {"size": [10**9, 10**9], "counts": [10**18]},
        {"size": [H, W], "counts": [10**30, 5]},
        {"size": [H, W], "counts": "not a code"},
        [[1, 2, 3, 4]],
        [[1, 2, 3, 4, 5, 6, 7]],
        [[1e300, 2, 3, 4, 5, 6]],
        [[-900, -900, -800, -900, -800, -800]],
        [],
        "text",
    ],
)
def test_hostile_coco_files_are_refused(segmentation: object, tmp_path: Path):
    with pytest.raises(InputError):
        read_coco(coco(tmp_path / "a.json", segmentation), painted())


SQUARE = [[10, 20, 30, 20, 30, 50, 10, 50]]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"categories": [{"id": 8, "name": "cup"}]}, "annotation 0: category_id 7; accepted: an id of categories: 8"),
        ({"categories": [{"id": 7, "name": "cup"}, {"id": 7, "name": "jug"}]}, "categories: 2 with the id 7"),
        ({"images": [{"id": 5}, {"id": 5}]}, "images: 2 with the id 5"),
        ({"images": [{"id": 5}]}, "annotation 0: image_id 1; accepted: an id of images: 5"),
        (
            {"images": [{"id": 1, "width": W, "height": 99}]},
            f"an image of {W}x99 pixels; accepted: the photo's {W}x{H}",
        ),
        ({"annotations": [{"segmentation": SQUARE, "iscrowd": 1}]}, "annotation 0: iscrowd 1, a group of objects"),
        ({"annotations": [{"segmentation": SQUARE, "iscrowd": 7}]}, "annotation 0: iscrowd = 7"),
    ],
)
def test_what_a_coco_file_cannot_mean_is_refused_by_name(more: dict[str, object], said: str, tmp_path: Path):
    with pytest.raises(InputError, match=re.escape(said)):
        read_coco(coco(tmp_path / "a.json", SQUARE, **more), painted(), name="a.png")


def test_annotations_of_several_images_without_a_list_of_them_are_refused(tmp_path: Path):
    (tmp_path / "a.json").write_text(json.dumps([{"image_id": k, "segmentation": SQUARE} for k in (3, 4)]))
    with pytest.raises(InputError, match=r"annotations of the images 3, 4; accepted: annotations of one image"):
        read_coco(tmp_path / "a.json", painted())


def test_one_image_of_another_name_is_told(tmp_path: Path):
    file = coco(tmp_path / "a.json", SQUARE)
    with pytest.warns(F3srWarning, match=r"a\.json: its image is a\.png, the photo b\.png"):
        assert len(read_coco(file, painted(), name="b.png")) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_coco(file, painted(), name="a.png")
        read_coco(file, painted())


@pytest.mark.parametrize(
    ("segmentation", "said"),
    [
        ({"size": [H, W], "counts": [0, -1]}, "annotation 0: segmentation.code.counts.runs.1 = -1; accepted: greater"),
        ({"size": [H, W], "counts": None}, "annotation 0: segmentation.code.counts = None; accepted: text or a list"),
        ({"size": [H, W]}, "annotation 0: no segmentation.code.counts"),
        ([], "annotation 0: segmentation.polygons = []; accepted: at least 1 item"),
        ([[1, 2, 3, 4]], "annotation 0: segmentation.polygons.0 = [1, 2, 3, 4]; accepted: at least 6 items"),
        ("text", "annotation 0: segmentation = 'text'; accepted: a run-length code or a list of polygons"),
    ],
)
def test_a_wrong_segmentation_is_told_by_its_own_part(segmentation: object, said: str, tmp_path: Path):
    with pytest.raises(InputError, match=re.escape(said)):
        read_coco(coco(tmp_path / "a.json", segmentation), painted())


def test_the_photo_is_found_among_images_by_name(tmp_path: Path):
    square, images = [[10, 20, 30, 20, 30, 50, 10, 50]], [{"id": 1, "file_name": "x/a.png"}, {"id": 2}]
    file = coco(tmp_path / "a.json", square, images=images)
    assert len(read_coco(file, painted(), name="a.png")) == 1
    with pytest.raises(InputError, match="2 images, 0 of them"):
        read_coco(file, painted(), name="b.png")


@pytest.mark.parametrize("mode", ["L", "P", "I;16"])
def test_label_maps(mode: str, tmp_path: Path):
    photo, true = scene()
    numbers = true[0] * 3 + true[1] * (700 if mode == "I;16" else 200)
    picture = Image.fromarray(numbers.astype(np.uint16 if mode == "I;16" else np.uint8))
    if mode == "P":
        picture.putpalette(list(range(256)) * 3)
    picture.save(tmp_path / "map.png")
    found = read_label_map(tmp_path / "map.png", photo)
    assert list(found) == [3, 700 if mode == "I;16" else 200]
    assert np.array_equal(found[3].mask, true[0])


def test_pictures_that_are_no_label_map_are_refused(tmp_path: Path):
    photo, true = scene()
    tiny = np.zeros((H, W), np.uint8)
    tiny[5, 5] = 1
    pictures = {
        "rgb.png": Image.fromarray(photo.rgb),
        "small.png": Image.fromarray(np.ones((20, 20), np.uint8)),
        "empty.png": Image.fromarray(np.zeros((H, W), np.uint8)),
        "tiny.png": Image.fromarray(tiny),
        "lossy.jpg": Image.fromarray(true[0].astype(np.uint8)),
        "many.png": Image.fromarray(np.arange(H * W).reshape(H, W).astype(np.uint16)),
    }
    for name, picture in pictures.items():
        picture.save(tmp_path / name)
        with pytest.raises(InputError, match=name):
            read_label_map(tmp_path / name, photo)


def test_cutouts(tmp_path: Path):
    photo, true = scene()
    for name, mask in (("04_plate.png", true[0]), ("07_red_ball.png", true[1])):
        Image.fromarray(np.dstack([photo.rgb, mask.astype(np.uint8) * 255])).save(tmp_path / name)
    found = read_cutouts(tmp_path, photo)
    assert {id: o.label for id, o in found.items()} == {4: "plate", 7: "red ball"}
    assert np.array_equal(found[7].mask, true[1])
    Image.fromarray(photo.rgb).save(tmp_path / "09.png")
    with pytest.raises(InputError, match=r"09\.png.*without alpha"):
        read_cutouts(tmp_path, photo)


# --- the folder -------------------------------------------------------------------------------------------------------


def photo_file(folder: Path, photo: Photo, name: str = "my photo.png", **more: object) -> Path:
    Image.fromarray(photo.rgb).save(folder / name, **more)
    return folder / name


def test_a_folder_is_read_as_it_was_written(tmp_path: Path):
    photo, true = scene()
    labels = ["big plate", "../etc/passwd", ""]
    objects = {k: OutlinedObject(label=label, mask=m) for k, (label, m) in enumerate(zip(labels, true, strict=True))}
    file = photo_file(tmp_path, photo)
    out = write_input_folder(tmp_path / "out", photo=file, objects=objects, ground=~np.any(true, axis=0))
    assert (out / "image.png").read_bytes() == file.read_bytes()
    instances = read_instances(InputFolder(out), photo)
    assert [(i.id, i.label) for i in instances] == [(0, "big plate"), (1, "etc passwd"), (2, "")]
    assert all(np.array_equal(i.mask, m) for i, m in zip(instances, true, strict=True))
    write_input_folder(out, photo=file, objects={5: objects[0]}, ground=np.zeros((H, W), bool))
    assert sorted(p.name for p in out.rglob("*")) == ["05_big_plate.png", "image.png", "masks", "prompts.json"]


@pytest.mark.parametrize("content", ["notes.txt", "masks/00.png", "prompts.json"])
def test_what_f3sr_did_not_write_is_not_replaced(content: str, tmp_path: Path):
    out = tmp_path / "out"
    (out / content).parent.mkdir(parents=True)
    (out / content).write_text("{}")
    objects = {0: OutlinedObject(label="", mask=disc(60, 60, 20))}
    photo = photo_file(tmp_path, painted())
    with pytest.raises(OutputError):
        write_input_folder(out, photo=photo, objects=objects, ground=np.zeros((H, W), bool))
    assert [p.name for p in out.rglob("*") if p.is_file()] == [Path(content).name]
    assert (out / content).read_text() == "{}"


def test_a_folder_that_was_added_to_is_not_replaced(tmp_path: Path):
    photo, nothing = photo_file(tmp_path, painted()), np.zeros((H, W), bool)
    objects = {0: OutlinedObject(label="", mask=disc(60, 60, 20))}
    out = write_input_folder(tmp_path / "out", photo=photo, objects=objects, ground=nothing)
    (out / "geometry.npz").write_bytes(b"mine")
    with pytest.raises(OutputError, match=r"geometry\.npz"):
        write_input_folder(out, photo=photo, objects=objects, ground=nothing)


@pytest.mark.parametrize("file", ["masks/00.png", "masks/01_new.png", "image.png", "prompts.json"])
def test_a_folder_that_was_changed_is_not_replaced(file: str, tmp_path: Path):
    photo, nothing = photo_file(tmp_path, painted()), np.zeros((H, W), bool)
    objects = {0: OutlinedObject(label="", mask=disc(60, 60, 20))}
    out = write_input_folder(tmp_path / "out", photo=photo, objects=objects, ground=nothing)
    mended = selection_bytes(Selection(prompts=()))  # of no hashes
    (out / file).write_bytes(mended)
    with pytest.raises(OutputError, match=file):
        write_input_folder(out, photo=photo, objects=objects, ground=nothing)
    assert (out / file).read_bytes() == mended and not atomic_folder.being_written(tmp_path)


def test_the_command_refuses_a_mended_folder_before_it_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file, box = photo_file(tmp_path, painted((disc(60, 60, 20), (200, 30, 30)))), "--box=35,35,85,85"
    command = ["segment", str(file), "-o", str(tmp_path / "out"), box]
    assert main(command) == 0 and main(command) == 0
    (tmp_path / "out/masks/00.png").write_bytes(b"mended")
    assert main([*command, "--segmenter", "nosuch"]) == 2 and main(command) == 1
    told = capsys.readouterr().err
    assert "masks/00.png was changed or removed since f3sr segment wrote it; give another folder" in told
    assert (tmp_path / "out/masks/00.png").read_bytes() == b"mended"


def test_names_of_masks_are_safe():
    names = [mask_name(3, label) for label in ("Red mug!", "a/b\\c", "..", "x" * 400, "Löffel", "\u202e\n", "7up")]
    assert names[:3] == ["03_Red_mug.png", "03_a_b_c.png", "03.png"]
    assert names[4:] == ["03_Löffel.png", "03.png", "03_7up.png"]
    assert max(len(name.encode()) for name in names) < 255


# --- the command ------------------------------------------------------------------------------------------------------


def test_the_command_writes_an_input_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    photo, true = scene()
    exif = Image.Exif()
    exif[0x0112] = 3  # upside down
    turned = Photo(rgb=photo.rgb[::-1, ::-1])
    file = photo_file(tmp_path, turned, "p.jpg", quality=95, exif=exif)
    boxes = [f"--box={','.join(map(str, box_of(m)))}:{label}" for m, label in zip(true, "abc", strict=True)]
    command = ["segment", str(file), "-o", str(tmp_path / "out"), *boxes, "--inside", "1:65,62;66,62"]
    assert main([*command, "--ground-stroke", "10,110;100,115", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["folder"].endswith("out")
    instances = read_instances(InputFolder(tmp_path / "out"), read_photo(tmp_path / "out/image.jpg"))
    assert min(iou(i.mask, m) for i, m in zip(instances, true, strict=True)) > 0.95
    again = ["segment", str(file), "-o", str(tmp_path / "out"), "--prompts", str(tmp_path / "out/prompts.json")]
    assert main(again) == 0
    assert f3sr.SEGMENTERS.names()[0] == "grabcut"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--box", "1,2,3"], "--box: found 1,2,3; accepted: X0,Y0,X1,Y1"),
        (["--box", "a,b,c,d"], "--box: found a,b,c,d; accepted: X0,Y0,X1,Y1"),
        (["--box", "1,2,30,1e9"], "prompt 0: found the box 1, 2, 30, 1e+09; accepted: left, top"),
        (["--box", "1,2,30,40", "--outside", "1:3,3"], "--outside: found object 1; accepted: K below 1"),
        (["--outside", "0:3,3"], "--outside: found object 0; accepted: an object of --box, --inside or --prompts"),
        (["--box", "1,2,30,40", "--inside", "9:3,3"], "--inside: found object 9; accepted: 0 to 1"),
        (["--box", "1,2,30,40", "--inside", "3,3"], "--inside: found 3,3; accepted: K:X,Y"),
        (["--box", "1,2,30,40", "--coco", "x.json"], "segment: found --coco and boxes and strokes; accepted: one way"),
        (["--ground-stroke", "3,3"], "--ground-stroke: found no object; accepted:"),
        (["--label-map", "nowhere.png"], "nowhere.png: found no such file or directory; accepted: a PNG of 1, 8"),
        (["--cutouts", "nosuch"], "nosuch: found nothing there; accepted: a folder of photo-sized *.png"),
        (["--coco", "x.json", "--segmenter", "grabcut"], "--segmenter: found --coco, which has masks; accepted: boxes"),
    ],
)
def test_wrong_options_are_one_line(options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = photo_file(tmp_path, painted())
    assert main(["segment", str(file), "-o", str(tmp_path / "out"), *options]) == 2
    told = capsys.readouterr().err
    assert said in told and told.count("\n") == 1
    assert not (tmp_path / "out").exists()
