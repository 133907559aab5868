"""Objects by words: phrases, duplicates, masks of the detector or of a segmenter, the ground by a back end."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from f3sr.backends.protocols import Detection, Prompt
from f3sr.backends.registry import Backend
from f3sr.cli.main import main
from f3sr.errors import InputError
from f3sr.io.input_folder import InputFolder
from f3sr.io.masks import read_instances
from f3sr.scene import Photo
from f3sr.segmentation import named_objects as words
from f3sr.segmentation.input_folder_writer import read_photo
from f3sr.segmentation.segmenters import DETECTORS, GROUND_SEGMENTERS, SEGMENTERS
from f3sr.segmentation.selection import Outlines
from f3sr.segmentation.selection_json import read_selection

W, H = 320, 200
RED, BLUE = (40, 50, 100, 120), (180, 60, 260, 150)


def rgb() -> NDArray[np.uint8]:
    pixels = np.full((H, W, 3), 200, np.uint8)
    pixels[50:120, 40:100], pixels[60:150, 180:260] = (220, 30, 30), (30, 30, 220)
    return pixels


def mask_of(box: Sequence[float]) -> NDArray[np.bool_]:
    mask = np.zeros((H, W), bool)
    mask[int(box[1]) : int(box[3]), int(box[0]) : int(box[2])] = True
    return mask


def found(label: str, box: Sequence[float], score: float = 0.9, *, masked: bool = True) -> Detection:
    left, top, right, bottom = map(float, box)
    return Detection(label=label, score=score, box=(left, top, right, bottom), mask=mask_of(box) if masked else None)


class Scripted:
    """A Detector, a Segmenter and a GroundSegmenter that answer as they are told."""

    provenance = {"weights": "scripted"}  # noqa: RUF012

    def __init__(self, answer: object = ()) -> None:
        self.answer = answer
        self.asked: list[Any] = []

    def detect(self, photo: Photo, phrases: Sequence[str]) -> Any:
        self.asked.append(tuple(phrases))
        return self.answer

    def segment(self, photo: Photo, prompts: Sequence[Prompt]) -> Any:
        self.asked.append(tuple(prompts))
        return [mask_of(p.box) for p in prompts if p.box]

    def ground(self, photo: Photo) -> Any:
        return self.answer


def backend(made: Any, kind: str = "detection") -> Backend[Any]:
    return Backend(kind=kind, name="scripted", version="1", made=made)


def named(answer: object, phrases: Sequence[str] = ("mug", "plate"), segmenter: Any = None) -> words.NamedObjects:
    chosen = backend(segmenter, "segmentation") if segmenter else None
    return words.named_objects(Photo(rgb=rgb()), phrases, backend(Scripted(answer)), chosen, SEGMENTERS.find("grabcut"))


@pytest.mark.parametrize(
    ("text", "phrases"),
    [
        ("red mug, plate ,, spoon,", ("red mug", "plate", "spoon")),
        ("  a\tgreen   cup\n", ("a green cup",)),
        ("mug,mug, mug ", ("mug",)),
        ("Tasse, テーブル", ("Tasse", "テーブル")),
    ],
)
def test_phrases_are_cleaned(text: str, phrases: tuple[str, ...]):
    assert words.phrases_of(text) == phrases


@pytest.mark.parametrize("text", ["", " , ,", ",".join(map(str, range(51))), "x" * 101, "a\x1bb"])
def test_too_few_too_many_and_odd_phrases_are_refused(text: str):
    with pytest.raises(InputError, match="1 to 50 phrases"):
        words.phrases_of(text)


def test_fifty_phrases_are_taken():
    assert len(words.phrases_of(",".join(map(str, range(50))))) == 50


@pytest.mark.parametrize(
    ("spec", "parts"),
    [
        ("sam3", ("sam3", None)),
        ("grounding-dino+sam2", ("grounding-dino", "sam2")),
        ("owlv2:/a+b/c+sam2:/d+e", ("owlv2:/a+b/c", "sam2:/d+e")),
        ("owlv2:/a+b/c", ("owlv2:/a+b/c", None)),
        ("grounding-dino+grabcut", ("grounding-dino", "grabcut")),
    ],
)
def test_a_detector_may_name_its_segmenter(spec: str, parts: tuple[str, str | None]):
    assert words.back_ends_of(spec, SEGMENTERS) == parts


def test_a_segmenter_that_is_none_is_named():
    with pytest.raises(InputError, match="segmentation back end: found 'sam9'"):
        words.back_ends_of("owlv2+sam9", SEGMENTERS)


def test_masks_of_the_detector_are_the_objects():
    result = named([found("plate", BLUE, 0.5), found("mug", RED), found("mug", (280, 10, 310, 40), 0.6)])
    assert [p.label for p in result.selection.prompts] == ["mug", "mug", "plate"]
    boxes = [tuple(map(int, p.box or ())) for p in result.selection.prompts]
    assert boxes == [RED, (280, 10, 310, 40), BLUE]
    for mask, box in zip(result.outlines.masks, boxes, strict=True):
        np.testing.assert_array_equal(mask, mask_of(box))
    assert result.told == ("boxes and masks by scripted 1 (weights scripted)",)


def test_boxes_alone_are_cut_out():
    result = named([found("mug", (30, 40, 110, 130), masked=False)])
    assert np.mean(result.outlines.masks[0] != mask_of(RED)) < 0.002
    assert result.told[0].startswith("boxes by scripted 1 (weights scripted); masks by grabcut")
    assert result.told[1:] == ("nothing found for 'plate'",)


def test_a_named_segmenter_cuts_even_where_the_detector_has_masks():
    segmenter = Scripted()
    result = named([found("mug", RED)], segmenter=segmenter)
    assert len(segmenter.asked) == 1 and "masks by scripted" in result.told[0]


def test_shared_pixels_go_to_one_object():
    result = named([found("mug", RED), found("plate", (80, 60, 260, 150))])
    assert not (result.outlines.masks[0] & result.outlines.masks[1]).any()


def test_duplicates_go_across_phrases_and_the_higher_score_stays():
    close = (41, 51, 101, 121)
    assert [d.label for d in words.distinct([found("cup", close, 0.6), found("mug", RED, 0.8)])] == ["mug"]
    for masked in (True, False):
        twice = [found("mug", RED, 0.8, masked=masked), found("cup", close, 0.81, masked=masked)]
        assert [d.label for d in words.distinct(twice)] == ["cup"]
    result = named([found("mug", RED), found("plate", close, 0.3)])
    assert len(result.selection.prompts) == 1
    assert result.told[1:] == ("nothing found for 'plate'", "duplicates left out: 1")


def test_neighbours_and_parts_are_no_duplicates():
    lid = (40, 50, 100, 70)
    assert len(words.distinct([found("mug", RED), found("lid", lid), found("plate", BLUE)])) == 3


def test_order_of_detections_decides_nothing():
    some = [found("mug", RED), found("mug", (45, 52, 103, 121), 0.9), found("plate", BLUE, 0.4)]
    keys = [{(d.label, d.box) for d in words.distinct(order)} for order in (some, some[::-1], some[1:] + some[:1])]
    assert keys[0] == keys[1] == keys[2]


def test_nothing_at_all_is_one_error():
    for answer in ([], [found("mug", (10, 10, 12, 12), masked=False)]):
        with pytest.raises(InputError, match="--segment: found nothing for mug, plate by scripted 1"):
            named(answer)


NOT_A_NUMBER = float("nan")


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ([found("fork", RED)], "the label 'fork'"),
        ([found("mug", RED, 1.2)], r"score 1\.2"),
        ([found("mug", RED, NOT_A_NUMBER)], "score nan"),
        ([found("mug", (5, 5, W + 1, 50), masked=False)], "the box"),
        ([found("mug", (50, 5, 5, 50), masked=False)], "the box"),
        ([found("mug", (NOT_A_NUMBER, 5, 50, 50), masked=False)], "the box"),
        ([Detection(label="mug", score=0.9, box=(1, 1, 50, 50), mask=np.zeros((H, W), bool))], "without a pixel"),
        ([Detection(label="mug", score=0.9, box=(1, 1, 50, 50), mask=np.ones((9, 9), bool))], "of shape"),
        ([("mug", RED)], "an answer with tuple"),
        (None, "an answer with NoneType"),
    ],
)
def test_hostile_detections_are_refused(answer: object, said: str):
    with pytest.raises(InputError, match=f"detection back end scripted 1.*{said}"):
        named(answer)


def test_the_ground_of_a_back_end_takes_the_place_of_the_colours():
    outlines = Outlines(masks=(mask_of(RED),), ground=mask_of((0, 0, 5, 5)))
    lower = mask_of((0, 100, W, H))
    shown = words.with_ground(Photo(rgb=rgb()), outlines, backend(Scripted(lower), "ground"))
    np.testing.assert_array_equal(shown.ground, lower & ~mask_of(RED))
    for bad, said in ((mask_of(RED), "0 pixels of ground"), (np.ones((3, 3), bool), "of shape"), (None, "NoneType")):
        with pytest.raises(InputError, match=said):
            words.with_ground(Photo(rgb=rgb()), outlines, backend(Scripted(bad), "ground"))


# --- the command --------------------------------------------------------------------------------------------------


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    Image.fromarray(rgb()).save(tmp_path / "table.png")
    return tmp_path / "table.png"


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    def script(detector: object, ground: object = None) -> None:
        for kind, answer in ((DETECTORS, detector), (GROUND_SEGMENTERS, ground)):
            real = type(kind).find
            monkeypatch.setattr(
                type(kind),
                "find",
                lambda self, spec, choice=None, *, real=real, kind=kind, answer=answer: (
                    backend(Scripted(answer), kind.name) if self is kind else real(self, spec, choice)
                ),
            )

    return script


def test_segment_by_words_writes_a_folder_that_tells_how(
    photo: Path, scripted: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    scripted([found("red mug", RED), found("red mug", BLUE)], mask_of((0, 100, W, H)))
    out = tmp_path / "in"
    arguments = ["segment", str(photo), "-o", str(out), "--ground-segmenter", "sam3", "--json"]
    assert main([*arguments, "--segment", "sam3", "red mug, spoon"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["told"][1] == "nothing found for 'spoon'" and "ground by scripted" in told["told"][-1]
    labels = [i.label for i in read_instances(InputFolder(out), read_photo(photo))]
    assert labels == ["red mug", "red mug"]
    assert "boxes and masks by scripted 1" in read_selection(out / "prompts.json").made_by
    ground = np.asarray(Image.open(out / "ground.png")) > 127
    np.testing.assert_array_equal(ground, mask_of((0, 100, W, H)) & ~mask_of(RED) & ~mask_of(BLUE))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--segment", "sam3", "mug", "--box", "1,1,50,50"], "one way to tell the objects"),
        (["--segment", "sam3", "mug", "--segmenter", "sam2"], "--segment DETECTOR+SEGMENTER WORDS"),
        (["--segment", "sam3", " , "], "1 to 50 phrases"),
        (["--segment", "magic", "mug"], "detection back end: found 'magic'"),
        (["--ground-segmenter", "sam3"], "boxes, strokes, masks or words beside it"),
        (["--box", "30,40,110,130", "--ground-segmenter", "magic"], "ground back end: found 'magic'"),
        (["--box", "30,40,110,130", "--ground-segmenter", "eomt", "--ground-stroke", "3,3"], "one of the two"),
    ],
)
def test_what_excludes_each_other_is_one_line(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
):
    for command in (["segment", str(photo), "-o", str(tmp_path / "in")], ["photo", str(photo), "--no-open"]):
        if "--ground-stroke" in arguments and command[0] == "photo":
            continue
        assert main([*command, *arguments]) == 2
        told = capsys.readouterr().err
        assert said in told and told.count("\n") == 1
        assert [p.name for p in tmp_path.iterdir()] == ["table.png"]


def test_folders_with_masks_take_no_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "x_input").mkdir()
    assert main(["photo", str(tmp_path / "x_input"), "--segment", "sam3", "mug"]) == 2
    assert "--segment: found the folder x_input, which has masks" in capsys.readouterr().err
