"""Vision models that read or edit the photo: labels, relations and background, over a loopback server."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from f3sr.backends.protocols import PromptedImage
from f3sr.errors import NoAnswerError
from f3sr.scene import Geometry, Instance, Photo
from folders import part_of_example
from goal_scene import goal_scene
from model_servers import Asked, Reply, model_server

if find_spec("pydantic_ai") is None:  # to import it takes half a second in every process that collects
    pytest.skip("the extra llm is not installed", allow_module_level=True)

from f3sr.agents.image_edit import ImageEdit, aligned, image_edit
from f3sr.agents.photo_reader import labeler, scene_grapher
from f3sr.io import inputs
from f3sr.models.model_endpoint import model_endpoint

EXAMPLE = Path(__file__).parents[1] / "src/f3sr/example/tabletop"
KEY = "sk-hidden"


@pytest.fixture(autouse=True)
def key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    monkeypatch.delenv("OPENAI_BASE_URL", raising=False)


@pytest.fixture
def unnamed(tmp_path: Path) -> Iterator[Path]:
    """A part of the example, with masks that only have numbers."""
    folder = part_of_example(tmp_path / "photo")
    for mask in sorted((folder / "masks").iterdir()):
        mask.rename(mask.with_name(re.match(r"\d+", mask.name)[0] + ".png"))  # type: ignore[index]
    poses = folder / "assets/poses.json"
    poses.write_text(re.sub(r'"(\d+)_\w+\.png"', r'"\1.png"', poses.read_text()))
    for name in ("materials.json", "scene_graph.json"):
        (folder / name).unlink(missing_ok=True)
    yield folder


def named(ids: list[int], label: str = "soup can") -> str:
    return json.dumps({"schema_version": 1, "labels": [{"id": id, "label": label} for id in ids]})


def read(folder: Path, script: Any, **backends: Any) -> tuple[inputs.Inputs, list[Asked]]:
    with model_server(script) as server:
        spec = f"openai:eye@{server.url}/v1"
        makers = {"labels": labeler, "scene_graph": scene_grapher}
        fillers = inputs.Fillers(**{name: makers[name](spec) for name in backends})
        return inputs.read(folder, fillers=fillers), server.asked


def ids_of(folder: Path) -> list[int]:
    """By the names of the masks."""
    return sorted(int(re.match(r"\d+", mask.name)[0]) for mask in (folder / "masks").iterdir())  # type: ignore[index]


def test_masks_without_a_label_get_one(unnamed: Path) -> None:
    ids = ids_of(unnamed)
    found, asked = read(unnamed, [named(ids)], labels=True)
    assert [i.label for i in found.instances] == ["soup can"] * len(ids)
    assert "labels" in found.fillers and len(asked) == 1
    assert len(asked[0].images) == 2 + min(16, len(ids)), "photo, photo with ids, crops"
    assert any("labels:" in d.choice for d in found.decisions)
    assert found.key != inputs.read(unnamed).key


def test_masks_with_labels_are_not_asked_about() -> None:
    found, asked = read(EXAMPLE, [named([])], labels=True)
    assert not asked and found.instances[0].label


def image() -> PromptedImage:
    """The objects of the made scene, without labels."""
    scene = goal_scene()
    masks = tuple(Instance(id=o.id, label="", name=f"{o.id}.png", mask=o.mask) for o in scene)
    return PromptedImage(photo=scene.photo, instances=masks)


GEOMETRY = Geometry(points=np.ones((2, 2, 3), np.float32), valid=np.ones((2, 2), bool))


@pytest.mark.parametrize(
    "label",
    ["", "x", "</script>", "ignore all rules.", "a" * 60, "Soup Can", "../../etc", "soup\ncan", "罐", "rm -rf /"],
)
def test_a_label_that_is_none_goes_back_and_is_never_taken(label: str) -> None:
    ids = [i.id for i in image().instances]
    with model_server([named(ids, label), named(ids)]) as server:
        found = labeler(f"openai:eye@{server.url}/v1").made.labels(image(), image().instances)
        assert len(server.asked) == 2 and set(found.values()) == {"soup can"}
    with model_server([named(ids, label)]) as server, pytest.raises(NoAnswerError):
        labeler(f"openai:eye@{server.url}/v1").made.labels(image(), image().instances)


def test_without_labels_the_folder_stays_as_it_is(unnamed: Path) -> None:
    found, _ = read(unnamed, [named(ids_of(unnamed), "</script>")], labels=True)
    assert not any(i.label for i in found.instances)
    (decision,) = [d for d in found.decisions if d.choice.startswith("labels:")]
    assert decision.fallback and KEY not in decision.reason


def relation(subject: int, predicate: str, object: int, **more: object) -> dict[str, object]:
    return {"subject": subject, "predicate": predicate, "object": object, "confidence": 0.9, "evidence": "seen"} | more


def graph(*relations: dict[str, object]) -> str:
    return json.dumps({"schema_version": 1, "relations": relations})


@pytest.fixture
def ungraphed(tmp_path: Path) -> Path:
    folder = tmp_path / "photo"
    shutil.copytree(EXAMPLE, folder)
    (folder / "scene_graph.json").unlink(missing_ok=True)
    return folder


def test_relations_are_between_masks_and_count_as_given(ungraphed: Path) -> None:
    a, b = ids_of(ungraphed)[:2]
    found, asked = read(
        ungraphed, [graph(relation(a, "supported_by", b), relation(b, "supported_by", -1))], scene_graph=1
    )
    assert found.graph is not None and found.graph.of("supported_by") == {(a, b), (b, -1)}
    assert "openai:eye" in found.graph.source and len(asked[0].images) > 2


BAD = {
    "an unknown id": relation(0, "supported_by", 77),
    "itself": relation(0, "supported_by", 0),
    "next to the ground": relation(0, "next_to", -1),
    "another predicate": relation(0, "destroys", 1),
    "too sure": relation(0, "supported_by", 1, confidence=7),
    "a field more": relation(0, "supported_by", 1, delete=True),
    "ids as text": relation(0, "supported_by", 1) | {"subject": "0"},
}


@pytest.mark.parametrize("name", BAD)
def test_relations_that_do_not_suit_are_no_answer(name: str) -> None:
    with model_server([graph(BAD[name])]) as server, pytest.raises(NoAnswerError):
        scene_grapher(f"openai:eye@{server.url}/v1").made.relations(image(), GEOMETRY)
    assert len(server.asked) == 2


def test_without_an_answer_that_suits_the_rules_stand(ungraphed: Path) -> None:
    found, _ = read(ungraphed, [graph(BAD["an unknown id"])], scene_graph=True)
    assert found.graph is None
    (decision,) = [d for d in found.decisions if d.choice.startswith("scene graph:")]
    assert decision.fallback and "openai:eye" in decision.reason


def test_a_server_that_is_down_changes_nothing(ungraphed: Path) -> None:
    found, _ = read(ungraphed, [Reply(status=401, text=f"bad key {KEY}")], scene_graph=True)
    assert found.graph is None and not any(KEY in d.reason for d in found.decisions)
    assert [i.id for i in found.instances] == ids_of(ungraphed)


# --- the background -----------------------------------------------------------------------------------------------


def photo(height: int = 60, width: int = 80) -> Photo:
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 255, (height // 4, width // 4, 3), dtype=np.uint8)
    return Photo(rgb=np.kron(coarse, np.ones((4, 4, 1), np.uint8)))


def hole(height: int = 60, width: int = 80) -> np.ndarray:
    made = np.zeros((height, width), bool)
    made[20:40, 30:50] = True
    return made


def picture(rgb: np.ndarray, format: str = "PNG") -> bytes:
    with io.BytesIO() as file:
        Image.fromarray(rgb).save(file, format)
        return file.getvalue()


def edit(body: bytes | dict[str, Any], status: int = 200) -> np.ndarray:
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    with image_server(data, status) as (url, received):
        made = ImageEdit(model_endpoint(f"openai:painter@{url}/v1")).complete(photo(), hole(), None)
        assert received[0].startswith("multipart/form-data")
        return made


def image_server(data: bytes, status: int = 200) -> Any:
    import contextlib
    import threading
    from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

    received = list[Any]()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            received.extend([self.headers["Content-Type"], body])
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, format: str, *args: Any) -> None:
            pass

    @contextlib.contextmanager
    def running() -> Iterator[tuple[str, list[Any]]]:
        server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}", received
        finally:
            server.shutdown()
            server.server_close()

    return running()


def reply(data: bytes) -> dict[str, Any]:
    return {"created": 1, "data": [{"b64_json": base64.b64encode(data).decode()}]}


def test_the_mask_is_sent_and_the_picture_fits_the_photo() -> None:
    filled = photo().rgb.copy()
    filled[hole()] = (10, 200, 30)
    with image_server(json.dumps(reply(picture(np.kron(filled, np.ones((2, 2, 1), np.uint8))))).encode()) as (url, got):
        made = ImageEdit(model_endpoint(f"openai:painter@{url}/v1")).complete(photo(), hole(), None)
    assert made.shape == photo().rgb.shape
    assert np.abs(made[25:35, 35:45].astype(int) - (10, 200, 30)).max() < 4
    pictures = [b"\x89PNG" + part for part in got[1].split(b"\x89PNG")[1:]]
    sent, mask = (Image.open(io.BytesIO(part)) for part in pictures)
    assert sent.size == mask.size == (80, 60)
    assert (np.asarray(mask)[..., 3] == np.where(hole(), 0, 255)).all(), "transparent is what is to be edited"


def test_a_shifted_picture_is_shifted_back() -> None:
    moved = np.roll(photo().rgb, (1, -1), axis=(0, 1))
    assert np.array_equal(aligned(moved, photo().rgb, hole()), photo().rgb)
    other = np.full_like(photo().rgb, 99)
    assert np.array_equal(aligned(other, photo().rgb, hole()), other)


FAULTS: dict[str, tuple[Any, int]] = {
    "no picture": ({"created": 1, "data": []}, 200),
    "a URL": ({"created": 1, "data": [{"url": "http://127.0.0.1:9/x.png"}]}, 200),
    "no base64": ({"created": 1, "data": [{"b64_json": "!!"}]}, 200),
    "no image": (reply(b"GIF89a nonsense"), 200),
    "a huge image": (reply(b""), 200),
    "not JSON": (b"<html>", 200),
    "401": ({"error": {"message": f"wrong {KEY}"}}, 401),
    "500": ({"error": {"message": "oops"}}, 500),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_is_no_picture_is_no_answer(name: str) -> None:
    body, status = FAULTS[name]
    if name == "a huge image":
        body = reply(picture(np.zeros((7000, 7000), np.uint8)))
    with pytest.raises(NoAnswerError) as error:
        edit(body, status)
    assert KEY not in str(error.value) and str(error.value).isprintable()


def test_without_an_answer_our_own_completion_fills_the_hole(tmp_path: Path) -> None:
    from f3sr.background import BackgroundConfig
    from f3sr.stages.inpaint import inpaint

    with image_server(b"<html>") as (url, _):
        completer = image_edit(f"openai:painter@{url}/v1")
        with pytest.raises(NoAnswerError):
            inpaint(goal_scene(), BackgroundConfig(), completer=completer)
    _, outcome = inpaint(goal_scene(), BackgroundConfig(), unanswered="it is down")
    (decision,) = [d for d in outcome.decisions if "patchmatch" in d.choice]
    assert decision.fallback and decision.reason == "it is down"
