"""Back ends with a network: own processing against the library's, planted answers at the right pixels, hostile ones."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from f3sr.backends.model_choice import ModelChoice
from f3sr.backends.protocols import GeneratedAsset, KnownFocal, Prompt, PromptedImage
from f3sr.cli.main import main
from f3sr.errors import F3srError, InputError
from f3sr.io import inputs
from f3sr.lifting.generators import ASSET_GENERATORS
from f3sr.neural import class_maps, depth_maps, depth_pro, grounding_dino, lama, moge_points, owlv2, sam2, sam3
from f3sr.neural.photo_tensors import HALF, IMAGENET, at_photo, stretched
from f3sr.neural.relative_boxes import detections
from f3sr.scene import Photo
from f3sr.segmentation.ownership import bounds
from f3sr.segmentation.selection_json import read_selection
from folders import write_folder
from lazily import TORCHVISION, WITH_MODELS, Lazily

tiny = Lazily("tiny_models")
pytestmark = WITH_MODELS
W, H = 80, 60
oracle = pytest.mark.skipif(not TORCHVISION, reason="the library's processor needs torchvision==0.28.0")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("models")


def photo(width: int = W, height: int = H, seed: int = 0) -> Photo:
    return Photo(rgb=np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8))


def choice(path: Path, **more: Any) -> ModelChoice:
    return ModelChoice(model=str(path), **more)


@pytest.fixture(scope="module")
def segmenters(folder: Path) -> dict[str, sam2.PromptedMasks]:
    return {
        "sam2": sam2.Sam2Segmenter(choice(tiny.sam2(folder / "sam2"))),
        "sam3": sam3.Sam3Segmenter(choice(tiny.sam3_tracker(folder / "tracker"))),
    }


PROMPTS = (
    Prompt(box=(10, 12, 50, 44)),
    Prompt(box=(2, 3, 20, 22), inside=(((9, 9),),), outside=(((30, 30), (40, 40)),)),
    Prompt(inside=(((60, 30),),)),
    Prompt(box=(30, 30, 70, 55)),
    Prompt(inside=(tuple((float(x), 20.0) for x in range(10, 60)),)),
)


@pytest.mark.parametrize("name", ["sam2", "sam3"])
def test_prompts_are_answered_in_order_and_by_themselves(segmenters: dict[str, Any], name: str):
    segmenter = segmenters[name]
    together = segmenter.segment(photo(), PROMPTS)
    assert [m.shape for m in together] == [(H, W)] * 5 and {m.dtype for m in together} == {np.dtype(bool)}
    backwards = segmenter.segment(photo(), PROMPTS[::-1])[::-1]
    for k, prompt in enumerate(PROMPTS):
        (alone,) = segmenter.segment(photo(), [prompt])
        assert (alone != together[k]).mean() < 0.002 and (backwards[k] != together[k]).mean() < 0.002  # rounding
    assert any((together[0] != m).any() for m in together[1:])


@pytest.mark.parametrize("name", ["sam2", "sam3"])
def test_a_photo_is_embedded_once(segmenters: dict[str, Any], name: str, monkeypatch: pytest.MonkeyPatch):
    segmenter = segmenters[name]
    model, calls = segmenter.transformer(segmenter.model_class), []
    real = model.get_image_embeddings
    monkeypatch.setattr(model, "get_image_embeddings", lambda x: calls.append(1) or real(x), raising=False)
    other = photo(seed=5)
    for shown in (other, other, photo(seed=6)):
        segmenter.segment(shown, PROMPTS[:2])
    assert len(calls) == 2


@oracle
@pytest.mark.parametrize(("width", "height"), [(80, 60), (300, 500), (513, 77)])
@pytest.mark.parametrize("name", ["sam2", "sam3"])
def test_masks_are_those_of_the_librarys_processor(segmenters: dict[str, Any], name: str, width: int, height: int):
    segmenter, shown = segmenters[name], photo(width, height)
    model = segmenter.transformer(segmenter.model_class)
    side = model.config.prompt_encoder_config.image_size
    processor = {"sam2": tiny.t.Sam2Processor, "sam3": tiny.t.Sam3TrackerProcessor}[name]
    pictures = {"sam2": tiny.t.Sam2ImageProcessor, "sam3": tiny.t.Sam3ImageProcessor}[name]
    theirs = processor(pictures(size={"height": side, "width": side}))
    box = [0.1 * width, 0.2 * height, 0.6 * width, 0.7 * height]
    inputs = theirs(images=Image.fromarray(shown.rgb), input_boxes=[[box]], return_tensors="pt")
    ours = stretched(shown, side, segmenter.spread, antialias=True)
    assert (ours - inputs["pixel_values"]).abs().max() < 1e-5
    with tiny.torch.inference_mode():
        out = model(**inputs, multimask_output=False)
    (masks,) = theirs.post_process_masks(out.pred_masks, inputs["original_sizes"])
    (mine,) = segmenter.segment(shown, [Prompt(box=tuple(box))])
    np.testing.assert_array_equal(mine, masks[0, 0].numpy())


@pytest.mark.parametrize("name", ["sam2", "sam3"])
@pytest.mark.parametrize(("width", "height"), [(320, 240), (90, 200)])
def test_a_planted_square_lands_at_its_pixels(segmenters: dict[str, Any], name: str, width: int, height: int):
    """Half a cell of the network's grid is the largest error, and mirrored squares give mirrored masks."""
    segmenter, shown = segmenters[name], photo(width, height)
    n = 64
    square = np.zeros((n, n), bool)
    square[16:40, 8:24] = True
    masks = {}
    for way in ("as it is", "mirrored"):
        low = square if way == "as it is" else square[::-1, ::-1]

        def answer(inputs: Any, out: Any, low: NDArray[np.bool_] = low) -> Any:
            return tiny.changed(out, pred_masks=tiny.logits(low)[None, None, None])

        with tiny.planted(segmenter, segmenter.model_class, answer):
            (masks[way],) = segmenter.segment(shown, PROMPTS[:1])
    rows, columns = np.nonzero(masks["as it is"])
    assert abs(rows.min() - 16 * height / n) <= 0.5 * height / n
    assert abs(rows.max() + 1 - 40 * height / n) <= 0.5 * height / n
    assert abs(columns.min() - 8 * width / n) <= 0.5 * width / n
    assert abs(columns.max() + 1 - 24 * width / n) <= 0.5 * width / n
    np.testing.assert_array_equal(masks["as it is"], masks["mirrored"][::-1, ::-1])


def test_prompts_reach_the_network_in_its_own_pixels(segmenters: dict[str, Any]):
    segmenter, seen = segmenters["sam2"], []

    def answer(inputs: Any, out: Any) -> Any:
        seen.append(inputs)
        return out

    prompt = Prompt(box=(20, 15, 60, 45), inside=(((40, 30),),), outside=(((80, 60),),))
    with tiny.planted(segmenter, "Sam2Model", answer):
        segmenter.segment(photo(), [prompt])
    np.testing.assert_allclose(seen[0]["input_boxes"], [[[64, 64, 192, 192]]], rtol=1e-6)
    np.testing.assert_allclose(seen[0]["input_points"], [[[[128, 128], [256, 256]]]], rtol=1e-6)
    assert seen[0]["input_labels"].tolist() == [[[1, 0]]]


def test_weights_of_videos_are_read_too(folder: Path):
    """As the hub has them: SAM 2.1 and SAM 3 are stored with their trackers."""
    video = sam3.Sam3Segmenter(choice(tiny.sam3_video(folder / "sam3_video")))
    assert [m.shape for m in video.segment(photo(), PROMPTS)] == [(H, W)] * 5
    sam3.Sam3Detector(video.choice).detect(photo(), ["mug"])
    assert sam3.Sam3Ground(video.choice).ground(photo()).shape == (H, W)
    tracked = sam2.Sam2Segmenter(choice(tiny.sam2_video(folder / "sam2_video")))
    assert [m.shape for m in tracked.segment(photo(), PROMPTS)] == [(H, W)] * 5


@pytest.mark.parametrize("name", ["sam2", "sam3"])
def test_half_precision_runs_and_is_told(segmenters: dict[str, Any], name: str):
    """Masks of random weights have logits about 0, so that rounding decides them: nothing is compared."""
    full = segmenters[name]
    half = type(full)(choice(Path(full.name), precision="bfloat16"))
    assert half.provenance["precision"] == "bfloat16"
    assert [m.shape for m in half.segment(photo(), PROMPTS)] == [(H, W)] * 5
    assert half.transformer(half.model_class).dtype == tiny.torch.bfloat16


# --- detectors ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def worded(folder: Path) -> sam3.Sam3Detector:
    return sam3.Sam3Detector(choice(tiny.sam3(folder / "sam3")))


def instances(boxes: Sequence[Sequence[float]], scores: Sequence[float], masks: Sequence[NDArray[np.bool_]]) -> Any:
    """An output of SAM 3 with some instances."""
    odds = tiny.torch.logit(tiny.torch.tensor([list(scores)], dtype=tiny.torch.float32))
    return {
        "pred_logits": odds,
        "presence_logits": tiny.torch.full((1, 1), 50.0),
        "pred_boxes": tiny.torch.tensor([[list(box) for box in boxes]], dtype=tiny.torch.float32),
        "pred_masks": tiny.torch.stack([tiny.logits(m) for m in masks])[None],
    }


def test_sam3_gives_planted_instances_with_box_and_mask(worded: sam3.Sam3Detector):
    left, right, none = (np.zeros((32, 32), bool) for _ in range(3))
    left[8:16, 4:12], right[20:28, 20:30] = True, True
    asked: list[int] = []

    def answer(inputs: Any, out: Any) -> Any:
        asked.append(int(inputs["input_ids"].sum()))
        boxes = [(0.125, 0.25, 0.375, 0.5), (0.6, 0.6, 1.2, 0.9), (0, 0, 1, 1), (0, 0, 1, 1)]
        return tiny.changed(out, **instances(boxes, [0.9, 0.8, 0.9, 0.2], [left, right, none, left]))

    with tiny.planted(worded, "Sam3Model", answer):
        found = worded.detect(photo(), ["red mug", "plate"])
    assert [d.label for d in found] == ["red mug"] * 2 + ["plate"] * 2 and len(set(asked)) == 2
    assert found[0].score == pytest.approx(0.9) and found[0].box == pytest.approx((10, 15, 30, 30))
    assert found[1].box == pytest.approx((48, 36, 80, 54))  # clipped
    assert found[0].mask is not None and found[1].mask is not None
    rows, columns = np.nonzero(found[0].mask)
    cell = (H / 32, W / 32)
    assert abs(rows.min() - 8 * cell[0]) <= 0.5 * cell[0] and abs(rows.max() + 1 - 16 * cell[0]) <= 0.5 * cell[0]
    assert abs(columns.min() - 4 * cell[1]) <= 0.5 * cell[1] and abs(columns.max() + 1 - 12 * cell[1]) <= 0.5 * cell[1]


def test_sam3_sees_a_photo_once_whatever_is_asked(worded: sam3.Sam3Detector, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sam3, "SCORE", 0.0)
    model, calls = worded.transformer("Sam3Model"), []
    real = model.get_vision_features
    monkeypatch.setattr(model, "get_vision_features", lambda **k: calls.append(1) or real(**k), raising=False)
    both = worded.detect(photo(), ["red mug", "plate"])
    assert len(calls) == 1
    again = worded.detect(photo(), ["plate", "red mug"])
    assert {(d.label, d.box) for d in both} == {(d.label, d.box) for d in again} and both


@oracle
def test_sam3_finds_what_the_librarys_processor_finds(worded: sam3.Sam3Detector, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sam3, "SCORE", 0.001)
    shown = photo(130, 70)
    pictures = tiny.t.Sam3ImageProcessor(size={"height": 112, "width": 112})
    processor = tiny.t.Sam3Processor(pictures, tiny.clip_tokenizer())
    inputs = processor(images=Image.fromarray(shown.rgb), text="red mug", return_tensors="pt")
    with tiny.torch.inference_mode():
        out = worded.transformer("Sam3Model")(
            pixel_values=inputs["pixel_values"],
            input_ids=inputs["input_ids"],
            attention_mask=inputs["attention_mask"],
        )
    (theirs,) = processor.post_process_instance_segmentation(
        out, threshold=0.001, mask_threshold=0.5, target_sizes=[(70, 130)]
    )
    kept = [k for k in range(len(theirs["scores"])) if theirs["masks"][k].any()]
    ours = worded.detect(shown, ["red mug"])
    assert len(ours) == len(kept)
    for d, k in zip(ours, kept, strict=True):
        assert d.score == pytest.approx(float(theirs["scores"][k]), rel=1e-4)
        box = np.clip(theirs["boxes"][k].numpy(), 0, [130, 70, 130, 70])
        np.testing.assert_allclose(d.box, box, atol=1e-2)
        assert d.mask is not None and (d.mask != theirs["masks"][k].numpy().astype(bool)).mean() < 0.002


def test_the_ground_is_the_largest_surface(folder: Path, worded: sam3.Sam3Detector):
    ground = sam3.Sam3Ground(choice(Path(worded.name)))
    seen: list[int] = []

    def answer(inputs: Any, out: Any) -> Any:
        surface = np.zeros((16, 16), bool)
        surface[(12, 8, 14)[len(seen)] :] = True
        seen.append(1)
        return tiny.changed(out, semantic_seg=tiny.logits(surface)[None, None])

    with tiny.planted(ground, "Sam3Model", answer):
        mask = ground.ground(photo())
    assert len(seen) == len(sam3.SURFACES)
    assert np.flatnonzero(mask.any(1))[0] == H // 2 and mask[H // 2 :].all() and not mask[: H // 2].any()


def test_grounding_dino_gives_boxes_of_the_librarys_processor(folder: Path, monkeypatch: pytest.MonkeyPatch):
    detector = grounding_dino.GroundingDinoDetector(choice(tiny.grounding_dino(folder / "gd")))
    monkeypatch.setattr(grounding_dino, "SCORE", 0.0)
    processor = tiny.t.AutoProcessor.from_pretrained(folder / "gd", backend="pil")
    shown = photo(90, 50)
    inputs = processor(images=Image.fromarray(shown.rgb), text=[["Red mug"]], return_tensors="pt")
    with tiny.torch.inference_mode():
        out = detector.transformer("GroundingDinoForObjectDetection")(**inputs)
    (theirs,) = processor.post_process_grounded_object_detection(
        out, inputs["input_ids"], threshold=0.0, text_threshold=0.0, target_sizes=[(50, 90)]
    )
    ours = detector.detect(shown, ["Red mug", "plate"])
    mine = [d for d in ours if d.label == "Red mug"]
    boxes = np.clip(theirs["boxes"].numpy(), 0, [90, 50, 90, 50])
    assert len(mine) == len(boxes) == 20 and len(ours) == 40
    np.testing.assert_allclose([d.box for d in mine], boxes, atol=1e-2)
    np.testing.assert_allclose([d.score for d in mine], theirs["scores"].numpy(), atol=1e-4)


def test_owlv2_gives_boxes_of_the_padded_square(folder: Path, monkeypatch: pytest.MonkeyPatch):
    detector = owlv2.Owlv2Detector(choice(tiny.owlv2(folder / "owl")))
    monkeypatch.setattr(owlv2, "SCORE", 0.0)
    processor = tiny.t.AutoProcessor.from_pretrained(folder / "owl", backend="pil")
    shown = photo(90, 50)
    words = ["a photo of a mug", "a photo of a plate"]
    inputs = processor(images=Image.fromarray(shown.rgb), text=[words], return_tensors="pt", max_length=40)
    with tiny.torch.inference_mode():
        out = detector.transformer("Owlv2ForObjectDetection")(**inputs)
    (theirs,) = processor.post_process_grounded_object_detection(
        out, threshold=0.0, target_sizes=[(50, 90)], text_labels=[["mug", "plate"]]
    )
    ours = detector.detect(shown, ["mug", "plate"])
    clipped = np.clip(theirs["boxes"].numpy(), 0, [90, 50, 90, 50])
    inside = (clipped[:, 2] > clipped[:, 0]) & (clipped[:, 3] > clipped[:, 1])
    assert theirs["boxes"].max() > 50 and 0 < inside.sum() == len(ours)
    np.testing.assert_allclose([d.box for d in ours], clipped[inside], atol=1e-2)
    assert [d.label for d in ours] == [x for x, k in zip(theirs["text_labels"], inside, strict=True) if k]
    box = tiny.torch.tensor([[[0.25, 0.125, 0.5, 0.25]]])
    odds = tiny.torch.tensor([[[-5.0, 5.0]]])

    def answer(inputs: Any, out: Any) -> Any:
        return tiny.changed(out, pred_boxes=box, logits=odds)

    with tiny.planted(detector, "Owlv2ForObjectDetection", answer):
        (d,) = detector.detect(photo(80, 160), ["mug", "plate"])
    assert d.label == "plate" and d.box == (0, 0, 80, 40)


def test_a_box_outside_of_the_photo_is_none_and_one_across_its_border_is_clipped():
    boxes = np.array([[0.5, 0.5, 0.5, 0.5], [1.5, 0.5, 0.2, 0.2], [0.0, 0.0, 0.5, 0.5]])
    found = list(detections(photo(), ["a", "b", "c"], np.array([0.9, 0.8, 0.7]), boxes, (W, H)))
    assert [(d.label, d.box) for d in found] == [("a", (20, 15, 60, 45)), ("c", (0, 0, 20, 15))]


# --- ground by classes --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["mask2former", "eomt"])
def test_the_ground_is_the_largest_class_of_a_surface(folder: Path, name: str):
    made = {"mask2former": (class_maps.Mask2FormerGround, tiny.mask2former), "eomt": (class_maps.EomtGround, tiny.eomt)}
    kind, make = made[name]
    ground = kind(choice(make(folder / name)))
    model = ground.transformer(ground.model_class)
    n = 16
    assert ground.ground(photo()).shape == (H, W)

    def answer(inputs: Any, out: Any) -> Any:
        parts = inputs["pixel_values"].shape[0]
        maps = np.zeros((3, n, n), bool)
        maps[0, :8], maps[1, 8:, :4], maps[2, 8:, 4:] = True, True, True
        classes = tiny.torch.full((parts, 10, 4), -20.0)
        queries = tiny.torch.full((parts, 10, n, n), -20.0)
        for k in range(3):
            classes[:, k, k] = 20.0
            queries[:, k] = tiny.logits(maps[k], 20.0)
        classes[:, 3:, 3] = 20.0
        return tiny.changed(out, class_queries_logits=classes, masks_queries_logits=queries)

    with tiny.planted(ground, ground.model_class, answer):
        mask = ground.ground(photo(64, 64))
    expected = np.zeros((64, 64), bool)
    expected[32:, 16:] = True
    assert (mask != expected).mean() < 0.03
    assert model.config.id2label[2] == "floor-wood"


def test_classes_of_surfaces_are_known_by_their_words(folder: Path):
    names = {0: "wall", 1: "floor, flooring", 2: "dining table", 3: "floor-other-merged", 4: "tablecloth", 5: "rug"}
    assert class_maps.surface_classes(names) == [1, 2, 3, 5]
    bare = class_maps.Mask2FormerGround(choice(tiny.mask2former(folder / "bare", {0: "cup", 1: "tablet"})))
    with pytest.raises(InputError, match="2 classes, none of them a surface"):
        bare.ground(photo())


# --- geometry -----------------------------------------------------------------------------------------------------


def image(shown: Photo | None = None, focal: float | None = None) -> PromptedImage:
    known = KnownFocal(pixels=focal, sigma=0, source="--focal") if focal else None
    return PromptedImage(photo=shown or photo(), instances=(), focal=known)


@pytest.mark.parametrize("kind", ["relative", "metric"])
def test_depth_anything_is_that_of_the_librarys_processor(folder: Path, kind: str):
    network = depth_maps.DepthAnythingNetwork(choice(tiny.depth_anything(folder / kind, kind)))
    processor = tiny.t.AutoImageProcessor.from_pretrained(folder / kind, backend="pil")
    shown = photo(90, 50)
    inputs = processor(images=Image.fromarray(shown.rgb), return_tensors="pt")
    with tiny.torch.inference_mode():
        out = network.transformer("AutoModelForDepthEstimation")(**inputs)
    (theirs,) = processor.post_process_depth_estimation(out, target_sizes=[(50, 90)])
    ours = network.predict(shown)
    assert ours.metric == (kind == "metric") and ours.values.shape == (50, 90)
    np.testing.assert_allclose(ours.values, theirs["predicted_depth"].numpy(), rtol=1e-5, atol=1e-6)


def test_dpt_is_relative(folder: Path):
    found = depth_maps.DptNetwork(choice(tiny.dpt(folder / "dpt"))).predict(photo())
    assert not found.metric and found.values.shape == (H, W)


def test_a_map_is_resized_about_pixel_centres():
    """A ramp of a coarse grid is the same ramp at the photo's pixels, away from its border."""
    n = 16
    ramp = tiny.torch.from_numpy(np.tile((np.arange(n) + 0.5) / n, (n, 1)).astype(np.float32))
    for mode, error in (("bilinear", 1e-5), ("bicubic", 0.0031)):  # torch's cubic keeps no ramp exactly
        fine = at_photo(ramp, photo(), mode)
        inner = slice(W // 8, -W // 8)
        np.testing.assert_allclose(fine[0, inner], ((np.arange(W) + 0.5) / W)[inner], atol=error)


@pytest.fixture(scope="module")
def pro(folder: Path) -> depth_pro.DepthProGeometry:
    return depth_pro.DepthProGeometry(choice(tiny.depth_pro(folder / "dp")))


def plant_depth(fov: float, inverse: float = 0.5) -> Any:
    def answer(inputs: Any, out: Any) -> Any:
        assert inputs["pixel_values"].shape[-2:] == (tiny.DEPTH_PRO_SIDE,) * 2
        return tiny.changed(
            out, predicted_depth=tiny.torch.full((1, 32, 32), inverse), field_of_view=tiny.torch.tensor([fov])
        )

    return answer


def test_depth_pro_gives_planted_field_of_view_and_depth(pro: depth_pro.DepthProGeometry):
    with tiny.planted(pro, "DepthProForDepthEstimation", plant_depth(60.0)):
        found = pro.estimate(image())
    f = W / 2 / math.tan(math.radians(30))
    np.testing.assert_allclose(found.K, [[f, 0, W / 2], [0, f, H / 2], [0, 0, 1]], rtol=1e-6)
    z = f / W / 0.5
    np.testing.assert_allclose(found.points[..., 2], z, rtol=1e-5)
    assert found.valid.all() and not found.guessed_unit
    projected = found.points @ found.K.T
    y, x = np.mgrid[:H, :W] + 0.5
    np.testing.assert_allclose(projected[..., :2] / projected[..., 2:], np.stack([x, y], -1), atol=1e-3)


def test_depth_pro_takes_a_known_focal_length(pro: depth_pro.DepthProGeometry):
    with tiny.planted(pro, "DepthProForDepthEstimation", plant_depth(60.0)):
        found = pro.estimate(image(focal=2 * W))
    assert found.K[0, 0] == 2 * W and "--focal" in found.told
    np.testing.assert_allclose(found.points[..., 2], 2 / 0.5, rtol=1e-5)


@pytest.mark.parametrize("fov", [-0.7, 0.0, 180.0, math.nan])
def test_depth_pro_refuses_a_field_of_view_that_no_lens_has(pro: depth_pro.DepthProGeometry, fov: float):
    with (
        tiny.planted(pro, "DepthProForDepthEstimation", plant_depth(fov)),
        pytest.raises(InputError, match="field of view"),
    ):
        pro.estimate(image())


@oracle
def test_depth_pro_is_that_of_the_librarys_processor(pro: depth_pro.DepthProGeometry):
    side = tiny.DEPTH_PRO_SIDE
    processor = tiny.t.DepthProImageProcessor(size={"height": side, "width": side})
    shown = photo(90, 50)
    inputs = processor(images=Image.fromarray(shown.rgb), return_tensors="pt")
    assert (stretched(shown, side, HALF, antialias=False) - inputs["pixel_values"]).abs().max() < 1e-5
    model = pro.transformer("DepthProForDepthEstimation")
    with tiny.torch.inference_mode():
        out = model(**inputs)
    positive = out.predicted_depth.abs() + 0.1
    fixed = SimpleNamespace(predicted_depth=positive, field_of_view=tiny.torch.tensor([50.0]))
    (theirs,) = processor.post_process_depth_estimation(fixed, target_sizes=[(50, 90)])

    def answer(inputs: Any, out: Any) -> Any:
        return tiny.changed(out, predicted_depth=positive, field_of_view=tiny.torch.tensor([50.0]))

    with tiny.planted(pro, "DepthProForDepthEstimation", answer):
        ours = pro.estimate(image(shown))
    np.testing.assert_allclose(ours.points[..., 2], theirs["predicted_depth"].numpy(), rtol=1e-4)
    assert ours.K[0, 0] == pytest.approx(float(theirs["focal_length"]), rel=1e-5)


def test_moge_gives_points_intrinsics_and_mask(folder: Path):
    geometry = moge_points.MogeGeometry(choice(tiny.moge(folder / "moge.pt")))
    found = geometry.estimate(image(photo(84, 56), focal=100.0))
    assert found.points.shape == (56, 84, 3) and found.valid.shape == (56, 84) and "--focal" in found.told
    assert found.K[0, 0] == pytest.approx(100, rel=1e-4) and found.K[1, 1] == pytest.approx(100, rel=1e-4)
    assert found.K[0, 2] == pytest.approx(42) and found.K[1, 2] == pytest.approx(28)
    assert np.isfinite(found.points).all() and (found.points[found.valid][:, 2] > 0).all()
    (folder / "bad.pt").write_bytes(b"x")
    with pytest.raises(InputError, match="a checkpoint of MoGe-2"):
        moge_points.MogeGeometry(choice(folder / "bad.pt")).estimate(image())


def test_moge_points_project_to_their_pixels_and_normals_face_the_camera(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """Planted as upstream answers: K by the photo's size, infinity where masked."""
    f = 1.1
    y, x = np.mgrid[:H, :W] + 0.5
    rays = np.stack([(x / W - 0.5) / f, (y / H - 0.5) * H / W / f, np.ones((H, W))], -1)
    points = (2 * rays).astype(np.float32)
    points[:5] = np.inf
    normal = np.zeros((H, W, 3), np.float32)
    normal[..., 2] = 1
    mask = np.ones((H, W), bool)
    mask[:5] = False
    K = [[f, 0, 0.5], [0, f * W / H, 0.5], [0, 0, 1.0]]
    told: dict[str, Any] = {}

    def infer(pixels: Any, **more: Any) -> dict[str, Any]:
        told.update(more, shape=tuple(pixels.shape), most=float(pixels.max()))
        values = {"points": points, "normal": normal, "mask": mask, "intrinsics": np.array(K, np.float32)}
        return {k: tiny.torch.from_numpy(v) for k, v in values.items()}

    geometry = moge_points.MogeGeometry()
    monkeypatch.setattr(geometry, "loaded", lambda make: SimpleNamespace(infer=infer))
    found = geometry.estimate(image())
    assert told == {"use_fp16": False, "shape": (3, H, W), "most": pytest.approx(1, abs=0.01)}
    assert not found.valid[:5].any() and found.valid[5:].all() and found.normals is not None
    projected = found.points[5:] @ found.K.T
    np.testing.assert_allclose((projected / projected[..., 2:])[..., :2], np.stack([x, y], -1)[5:], atol=1e-3)
    np.testing.assert_array_equal(found.normals[5:], np.broadcast_to([0, 0, -1], (H - 5, W, 3)))
    geometry.estimate(image(focal=W / 2))
    assert told["fov_x"] == pytest.approx(90)


# --- background ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "height"), [(64, 48), (83, 61)])
def test_lama_changes_the_hole_only(folder: Path, width: int, height: int):
    completer = lama.LamaCompleter(choice(tiny.lama(folder / "lama.pt")))
    shown, hole = photo(width, height), np.zeros((height, width), bool)
    hole[10:30, 20:40] = True
    filled = completer.complete(shown, hole, None)
    assert filled.dtype == np.uint8 and filled.shape == shown.rgb.shape
    np.testing.assert_array_equal(filled[~hole], shown.rgb[~hole])
    assert (filled[hole] != shown.rgb[hole]).mean() > 0.9


def test_lama_with_another_answer_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch):
    completer = lama.LamaCompleter(choice(tiny.lama(folder / "lama.pt")))
    for answer in (tiny.torch.zeros(1, 3, 8, 8), tiny.torch.full((1, 3, 64, 80), math.nan), "no tensor"):
        monkeypatch.setattr(completer, "loaded", lambda make, answer=answer: lambda *a: answer)
        with pytest.raises(InputError, match="as LaMa gives it"):
            completer.complete(photo(), np.ones((H, W), bool), None)


def test_every_back_end_says_what_it_needs(monkeypatch: pytest.MonkeyPatch):
    for kind in (sam2.Sam2Segmenter, sam3.Sam3Detector, owlv2.Owlv2Detector, depth_pro.DepthProGeometry):
        needs = {need.what: need for need in kind().needs()}
        assert needs["package torch"].met and not needs["weights"].met and needs["weights"].remedy.startswith("hf ")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    needs = sam2.Sam2Segmenter().needs()
    assert [(n.what, n.met, n.remedy) for n in needs] == [
        ("package torch", False, "pip install 'f3sr[models]'"),
        ("package transformers", False, "pip install 'f3sr[models]'"),
    ]


def test_without_torch_one_line_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    with pytest.raises(F3srError, match=r"needs torch, which is not installed: pip install 'f3sr\[models\]'"):
        sam2.Sam2Segmenter().segment(photo(), [])


def test_pixels_are_spread_as_the_networks_expect():
    grey = Photo(rgb=np.full((20, 30, 3), 255, np.uint8))
    x = stretched(grey, 8, IMAGENET, antialias=True)
    np.testing.assert_allclose(x[0, :, 0, 0], [(1 - m) / s for m, s in zip(*IMAGENET, strict=True)], rtol=1e-5)


# --- a whole run --------------------------------------------------------------------------------------------------


class GivenAssets:
    """An AssetGenerator with the meshes of a folder, by label."""

    folder = Path()

    def generate(self, image: PromptedImage, geometry: Any, K: Any) -> dict[int, GeneratedAsset]:
        given = inputs.read(self.folder)
        posed = {i.label: given.assets[i.id] for i in given.instances}
        return {
            i.id: GeneratedAsset(mesh=a.mesh, T_camera_object=a.T_camera_object, scale=a.scale)
            for i in image.instances
            for a in [posed[i.label]]
        }


@pytest.mark.slow
def test_planted_masks_geometry_and_meshes_give_the_package_of_the_folder(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """The folder's own parts as the models' answers: the two packages agree in image and in what is known of them."""
    write_folder(tmp_path / "given", perturb=0.06, seed=3)
    given = inputs.read(tmp_path / "given")
    assert main(["reconstruct", str(tmp_path / "given"), "-o", str(tmp_path / "A"), "--json"]) == 0
    first = json.loads(capsys.readouterr().out)["f3sr"]
    monkeypatch.setattr(GivenAssets, "folder", tmp_path / "given")
    monkeypatch.setitem(cast(dict[str, str], ASSET_GENERATORS.built_in), "given", f"{__name__}:GivenAssets")
    masks = {i.label: i.mask for i in given.instances}
    ground = np.asarray(Image.open(tmp_path / "given" / "ground.png")) > 127
    place = tiny.sam3(folder / "sam3_run")
    detector = sam3.Sam3Detector(choice(place))
    size = np.array([given.photo.width, given.photo.height] * 2)
    words = {tuple(tiny.clip_tokenizer()(label)["input_ids"]): label for label in masks}

    def answer(asked: Any, out: Any) -> Any:
        tokens = asked["input_ids"][0][asked["attention_mask"][0].bool()].tolist()
        label = words.get(tuple(tokens))
        if label is None:
            return tiny.changed(out, semantic_seg=tiny.logits(ground)[None, None])
        box = np.array(bounds(masks[label])) / size
        return tiny.changed(out, **instances([box], [0.9], [masks[label]]))

    def infer(pixels: Any, **more: Any) -> dict[str, Any]:
        points, valid = given.geometry.points, given.geometry.valid
        normalised = given.K / [[given.photo.width], [given.photo.height], [1]]
        values = {"points": points, "mask": valid, "intrinsics": normalised}
        return {k: tiny.torch.from_numpy(np.array(v)) for k, v in values.items()}

    monkeypatch.setattr(moge_points.MogeGeometry, "loaded", lambda self, make: SimpleNamespace(infer=infer))
    monkeypatch.setattr(moge_points.MogeGeometry, "needs", lambda self: ())
    shown = tmp_path / "photo.png"
    shown.write_bytes((tmp_path / "given" / "image.png").read_bytes())
    arguments = ["photo", str(shown), "-o", str(tmp_path / "B"), "--no-open", "--json", "--geometry", "moge"]
    arguments += ["--assets", "given", "--ground-segmenter", f"sam3:{place}"]
    with tiny.planted(detector, "Sam3Model", answer):
        assert main([*arguments, "--segment", f"sam3:{place}", ", ".join(masks)]) == 0
    second = json.loads(capsys.readouterr().out)["f3sr"]
    assert abs(first["mIoU_visible"] - second["mIoU_visible"]) < 0.01
    written = tmp_path / "B_input"
    for i in inputs.read_instances(inputs.InputFolder(written), given.photo):
        np.testing.assert_array_equal(i.mask, masks[i.label])
    kept = read_selection(written / "prompts.json").made_by
    assert f"sam3:{place}" not in kept and str(place) in kept and "licence unknown" in kept
    report = (tmp_path / "B" / "report.json").read_text()
    assert "metric points of Ruicheng/moge-2-vitl-normal" in report
