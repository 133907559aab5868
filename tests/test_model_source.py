"""Weights on this machine: which are found, which are refused, and what is told of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from f3sr.backends.model_choice import ModelChoice
from f3sr.errors import F3srError, InputError
from f3sr.neural import model_loading
from f3sr.neural.depth_maps import DepthAnythingNetwork
from f3sr.neural.lama import LamaCompleter
from f3sr.neural.sam2 import Sam2Segmenter
from f3sr.scene import Photo
from lazily import WITH_MODELS, Lazily

tiny = Lazily("tiny_models")
pytestmark = WITH_MODELS


@pytest.fixture(autouse=True)
def cold(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """No model in memory, and an empty hub cache."""
    monkeypatch.setattr(model_loading, "_loaded", {})
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "hub"))


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    return tiny.depth_anything(tmp_path / "da")


def network(model: object, **more: object) -> DepthAnythingNetwork:
    return DepthAnythingNetwork(ModelChoice(model=str(model), **more))  # type: ignore[arg-type]


def photo(seed: int = 0) -> Photo:
    return Photo(rgb=np.random.default_rng(seed).integers(0, 255, (48, 64, 3), np.uint8))


def test_a_model_is_loaded_once_for_many_photos(weights: Path, monkeypatch: pytest.MonkeyPatch):
    calls: list[str] = []
    real = model_loading.transformers_model

    def counted(name: str, *more: object) -> object:
        calls.append(name)
        return real(name, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(model_loading, "transformers_model", counted)
    first, second = network(weights), network(weights)
    a = first.predict(photo(0)).values
    b = second.predict(photo(1)).values
    assert len(calls) == 1 and not np.array_equal(a, b)
    np.testing.assert_array_equal(a, first.predict(photo(0)).values)
    network(weights, precision="bfloat16").predict(photo(0))
    assert len(calls) == 2


def test_other_weights_in_the_same_folder_are_loaded_again(weights: Path):
    before = network(weights)
    a, revision = before.predict(photo()).values, before.provenance["revision"]
    tiny.torch.manual_seed(7)
    model = tiny.t.DepthAnythingForDepthEstimation.from_pretrained(weights)
    for p in model.parameters():
        p.data += 0.1 * tiny.torch.randn_like(p)
    model.save_pretrained(weights)
    after = network(weights)
    assert not np.array_equal(after.predict(photo()).values, a) and after.provenance["revision"] != revision


def test_provenance_tells_weights_revision_licence_device_and_precision(weights: Path):
    (weights / "README.md").write_text("---\nlicense: other\nlicense_name: my-terms\ntags: [x]\n---\nHello")
    told = network(weights, device="cpu").provenance
    assert told == {
        "weights": str(weights),
        "revision": told["revision"],
        "licence": "my-terms",
        "device": "cpu",
        "precision": "float32",
    }
    assert told["revision"].startswith("sha256:") and len(told["revision"]) == 23


def test_the_local_cache_of_the_hub_is_used_and_its_commit_told(tmp_path: Path):
    repo = tmp_path / "hub" / "models--depth-anything--Depth-Anything-V2-Small-hf"
    commit = "0123456789abcdef0123456789abcdef01234567"
    tiny.depth_anything(repo / "snapshots" / commit)
    (repo / "refs").mkdir()
    (repo / "refs" / "main").write_text(commit)
    found = DepthAnythingNetwork()
    assert found.predict(photo()).values.shape == (48, 64)
    assert found.provenance["revision"] == commit and found.provenance["licence"] == "apache-2.0"
    assert all(need.met for need in found.needs() if need.what != "memory")


def test_a_hub_name_without_weights_names_the_command_that_fetches_them():
    with pytest.raises(InputError, match="hf download depth-anything/Depth-Anything-V2-Small-hf, or --allow-downloads"):
        DepthAnythingNetwork().predict(photo())
    (need,) = [n for n in DepthAnythingNetwork().needs() if n.what == "weights"]
    assert not need.met and need.remedy == "hf download depth-anything/Depth-Anything-V2-Small-hf"
    assert DepthAnythingNetwork().provenance == {"weights": "depth-anything/Depth-Anything-V2-Small-hf"}


def test_wrong_folders_are_one_error_that_says_what_was_found(weights: Path, tmp_path: Path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match=r"no config\.json \(an empty folder\)"):
        network(tmp_path / "empty").predict(photo())
    with pytest.raises(InputError, match="a file"):
        network(tmp_path / "file").predict(photo())
    with pytest.raises(InputError, match="does not exist"):
        network(tmp_path / "absent").predict(photo())
    with pytest.raises(InputError, match=r"model_type 'depth_anything'; accepted: sam2 or sam2_video"):
        Sam2Segmenter(ModelChoice(model=str(weights))).segment(photo(), [])


def test_pickles_are_refused_before_they_are_read(weights: Path):
    state = tiny.torch.zeros(1)
    (weights / "model.safetensors").unlink()
    tiny.torch.save({"x": state}, weights / "pytorch_model.bin")
    with pytest.raises(InputError, match=r"pytorch_model\.bin, which may run code.*accepted: \*\.safetensors"):
        network(weights).predict(photo())


def test_damaged_and_incomplete_weights_are_refused(weights: Path):
    file = weights / "model.safetensors"
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="accepted: the weights of a AutoModelForDepthEstimation"):
        network(weights).predict(photo())
    from safetensors.torch import load, save_file

    tensors = load(whole)
    name = sorted(tensors)[0]
    del tensors[name]
    save_file(tensors, file, metadata={"format": "pt"})
    with pytest.raises(InputError, match=f"without 1 of the model's tensors, {name}"):
        network(weights).predict(photo())


def test_code_of_a_folder_is_never_run(weights: Path):
    config = json.loads((weights / "config.json").read_text())
    config["auto_map"] = {"AutoModelForDepthEstimation": "evil.Evil", "AutoConfig": "evil.Evil"}
    (weights / "config.json").write_text(json.dumps(config))
    (weights / "evil.py").write_text(f"open({str(weights / 'ran')!r}, 'w')\nclass Evil: pass\n")
    assert network(weights).predict(photo()).values.shape == (48, 64)
    assert not (weights / "ran").exists()


def test_a_device_that_is_not_there_is_an_error(weights: Path):
    if tiny.torch.cuda.is_available():
        pytest.skip("this machine has cuda")
    with pytest.raises(InputError, match="--device: found cuda; accepted: auto, "):
        network(weights, device="cuda").predict(photo())


def test_a_torchscript_file_is_taken_only_where_the_user_names_it(tmp_path: Path):
    none = np.zeros((48, 64), bool)
    for choice in (ModelChoice(), ModelChoice(model="somebody/lama")):
        with pytest.raises(InputError, match="lama:FILE, a local TorchScript file"):
            LamaCompleter(choice).complete(photo(), none, None)
    (tmp_path / "no.pt").write_bytes(b"no script")
    with pytest.raises(InputError, match="a TorchScript file of LaMa"):
        LamaCompleter(ModelChoice(model=str(tmp_path / "no.pt"))).complete(photo(), none, None)
    (need,) = [n for n in LamaCompleter().needs() if n.what == "weights"]
    assert not need.met and "NAME:FILE" in need.found


def test_a_torchvision_that_does_not_fit_is_named(weights: Path, monkeypatch: pytest.MonkeyPatch):
    """As its wheels for CUDA beside a torch for CPUs: every import of a model fails."""

    class Broken:
        def __getattr__(self, name: str) -> object:
            raise RuntimeError("operator torchvision::nms does not exist")

    monkeypatch.setattr(model_loading, "transformers_library", lambda title: Broken())
    with pytest.raises(F3srError, match=r"torchvision::nms does not exist.*pip uninstall torchvision"):
        network(weights).predict(photo())
