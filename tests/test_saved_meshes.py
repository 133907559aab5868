"""Input folders with meshes and no agreed poses: what is missing, left over or broken is one clear error."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import f3sr
from f3sr.cli.main import main
from f3sr.errors import InputError
from f3sr.io.mesh_files import save_glb
from folders import FLAT, write_folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Boxes in the model's frame without poses, as a worker leaves them."""
    place = tmp_path / "in"
    write_folder(place)
    (place / "assets" / "poses.json").unlink()
    for id in (2, 5, 7):
        (place / "assets" / f"{id:02d}.json").write_text(json.dumps({"id": id, "mesh": f"{id:02d}.glb", "up": "+y"}))
    return place


def test_the_masks_place_them_and_the_report_says_so(folder: Path):
    given = f3sr.read_inputs(folder)
    assert set(given.assets) == {2, 5, 7} and given.fillers["assets"].startswith("saved")
    choices = [d.choice for d in given.decisions]
    assert any("assets: placed by assets back end saved" in c for c in choices)
    assert sum("pose by its mask" in c for c in choices) == 3
    assert str(folder) not in " ".join(given.fillers.values())


def test_poses_that_are_not_used_since_one_has_none_are_told(folder: Path):
    pose = {"convention": "sam3d", "rotation": [1, 0, 0, 0], "translation": [0, 0, 1], "scale": [1, 1, 1]}
    for id in (2, 7):
        answer = {"id": id, "mesh": f"{id:02d}.glb", "up": "+y", "pose": pose}
        (folder / "assets" / f"{id:02d}.json").write_text(json.dumps(answer))
    told = {
        d.about: d for d in f3sr.read_inputs(folder).decisions if "its pose is not used: object 5 told none" in d.choice
    }
    assert set(told) == {2, 7} and all(d.fallback for d in told.values())


def test_axes_of_the_user_are_refused_where_files_tell_them(folder: Path):
    with pytest.raises(InputError, match=r"--asset-frame: found opencv; accepted: nothing where a file NN\.json"):
        f3sr.read_inputs(folder, asset_frame="opencv")


def test_they_may_lie_elsewhere(folder: Path):
    elsewhere = folder.parent / "meshes"
    (folder / "assets").rename(elsewhere)
    fillers = f3sr.Fillers(assets=f3sr.ASSET_GENERATORS.find(f"saved:{elsewhere}"))
    assert set(f3sr.read_inputs(folder, fillers=fillers).assets) == {2, 5, 7}
    with pytest.raises(InputError, match="no folder; accepted: saved:DIR"):
        f3sr.read_inputs(folder, fillers=f3sr.Fillers(assets=f3sr.ASSET_GENERATORS.find("saved")))


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda a: (a / "05.json").unlink(), "05.glb: found a file of no mask|no 05.json"),
        (lambda a: (a / "05.glb").unlink(), "no 05.glb"),
        (lambda a: (a / "88.glb").write_bytes(b"x"), "88.glb: found a file of no mask"),
        (lambda a: (a / "05.json").write_text('{"mesh": "../../x.glb"}'), "GLB '../../x.glb'"),
        (lambda a: (a / "05.json").write_text('{"mesh": NaN}'), "no valid JSON"),
        (lambda a: (a / "05.glb").write_bytes(b"x"), "broken glTF"),
        (lambda a: save_glb(FLAT, a / "05.glb"), "05.glb: found a flat mesh without any thickness"),
    ],
)
def test_a_broken_one_is_one_clear_error(spoil, told: str, folder: Path):
    spoil(folder / "assets")
    with pytest.raises(InputError, match=told):
        f3sr.read_inputs(folder)
    assert main(["reconstruct", str(folder), "-o", str(folder.parent / "out")]) == 2
    assert not (folder.parent / "out").exists()
