"""The photo completed behind the objects, in pipeline and package: where the support is, and what depends on it."""

from __future__ import annotations

import io
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from f3sr.background import BackgroundConfig
from f3sr.background.support import faces_ground, hiding, support_of
from f3sr.cli.main import main
from f3sr.core.transforms import pose, rotation_about
from f3sr.errors import InputError
from f3sr.io import inputs
from f3sr.pipeline import SKIPPABLE, reconstruct
from f3sr.runtime.result_store import Store
from f3sr.scene import Geometry, Scene
from f3sr.scene_package.package import read_package
from f3sr.stages.inpaint import inpaint
from f3sr.vision import rasterizer
from folders import write_folder
from goal_scene import goal_package
from scenes import box, scene_of

GOAL = "knock over the cereal box"


def seen_scene(*, geometry: bool = True) -> Scene:
    """Two boxes, one of them a wall at the back, and what a depth camera says of them and the ground."""
    scene = scene_of(
        box(0, size=(0.1, 0.1, 0.1), at=(0, 0, 0.05)), box(1, size=(2.0, 0.1, 1.0), at=(0.0, 1.2, 0.5), label="wall")
    )
    fragments = rasterizer.render(scene.objects, scene.camera)
    y, x = np.mgrid[: scene.camera.height, : scene.camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(scene.camera.K).T
    up = scene.camera.T_world_camera[2, :3]
    with np.errstate(divide="ignore"):
        ground = -scene.camera.center[2] / (rays @ up)
    depth = np.where(np.isfinite(fragments.depth), fragments.depth, np.where(ground > 0, ground, np.inf))
    valid = np.isfinite(depth) & (depth < 50)
    points = rays * np.where(valid, depth, 0)[..., None]
    own = scene.with_objects(replace(scene[0], mask=fragments.ids == 0))
    own = replace(own, objects=own.objects[:1])
    return replace(own, geometry=Geometry(points=points, valid=valid) if geometry else None)


def test_the_support_is_the_ground_and_goes_on_behind_objects() -> None:
    scene = seen_scene()
    hole = scene[0].mask
    support = support_of(scene, hole)
    wall = rasterizer.render([box(1, size=(2.0, 0.1, 1.0), at=(0.0, 1.2, 0.5))], scene.camera).ids == 1
    assert hole.any() and support[hole].mean() > 0.95 and wall.sum() > 100
    assert support[wall & ~hole].mean() < 0.1, "a wall is no support but for its foot"
    assert support[~wall & ~hole & faces_ground(scene.camera)].mean() > 0.99


def test_a_ground_mask_counts_and_nothing_above_the_horizon_does() -> None:
    scene = seen_scene(geometry=False)
    assert np.array_equal(support_of(scene, scene[0].mask), faces_ground(scene.camera))
    ground = np.zeros_like(scene[0].mask)
    ground[:, : ground.shape[1] // 2] = True
    support = support_of(replace(scene, ground_mask=ground), scene[0].mask)
    expected = ground & faces_ground(scene.camera)
    assert (support != expected)[~scene[0].mask].mean() < 0.01, "but for specks at its border"
    assert support[scene[0].mask & ground].all() and not support[scene[0].mask & ~ground].any()


def ground_only(scene: Scene) -> Scene:
    """With no other geometry than the plane of the ground, drawn over all of the photo that it may be seen in."""
    assert scene.geometry is not None
    y, x = np.mgrid[: scene.camera.height, : scene.camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(scene.camera.K).T
    valid = faces_ground(scene.camera)
    depth = -scene.camera.center[2] / np.where(valid, rays @ scene.camera.T_world_camera[2, :3], -1)
    points = np.where(valid[..., None], rays * depth[..., None], 0)
    return replace(scene, geometry=Geometry(points=points, valid=valid, source="ground"))


def test_a_plane_drawn_over_the_photo_shows_no_edge_of_the_support_and_hides_nothing() -> None:
    scene, bare = ground_only(seen_scene()), seen_scene(geometry=False)
    hole = scene[0].mask
    ground = np.zeros_like(hole)
    ground[:, : ground.shape[1] // 2] = True
    masked = [replace(s, ground_mask=ground) for s in (scene, bare)]
    assert np.array_equal(support_of(masked[0], hole), support_of(masked[1], hole))
    assert np.isinf(hiding(scene, support_of(masked[0], hole), hole)).all()
    decisions = inpaint(scene, BackgroundConfig())[1].decisions
    assert any(d.fallback and "horizon" in d.choice for d in decisions)


def test_where_nothing_tells_the_support_that_is_told() -> None:
    scene = seen_scene(geometry=False)
    decisions = inpaint(scene, BackgroundConfig())[1].decisions
    assert any(d.fallback and "horizon" in d.choice for d in decisions)
    assert not inpaint(seen_scene(), BackgroundConfig())[1].report.fallbacks


def test_a_camera_that_looks_up_sees_no_support() -> None:
    camera = seen_scene().camera
    up = camera.moved(camera.T_world_camera @ pose(rotation_about([1, 0, 0], np.pi / 2)))
    assert faces_ground(camera).any() and not faces_ground(up).any()


def test_a_given_background_is_taken_and_one_of_another_size_refused(tmp_path: Path) -> None:
    folder = tmp_path / "input"
    write_folder(folder)
    given = np.full_like(inputs.read(folder).photo.rgb, 90)
    Image.fromarray(given).save(folder / "background.png")
    read = inputs.read(folder)
    assert read.background is not None and np.array_equal(read.background, given)
    assert inputs.read(folder, ignore=["background"]).background is None
    result = reconstruct(read, skip=[s for s in SKIPPABLE if s not in ("level", "inpaint")])
    assert result.inpainting is not None and np.array_equal(result.inpainting.rgb, given)
    assert any("as given" in d.choice for d in result.reports[-1].decisions)
    Image.fromarray(given[1:]).save(folder / "background.png")
    with pytest.raises(InputError, match=r"background\.png.*pixels"):
        inputs.read(folder)


def test_what_may_hide_objects_is_what_stands_beside_them() -> None:
    scene = seen_scene()
    hole = scene[0].mask
    support = support_of(scene, hole)
    depth = hiding(scene, support, hole)
    fragments = rasterizer.render([box(1, size=(2.0, 0.1, 1.0), at=(0.0, 1.2, 0.5))], scene.camera)
    wall = (fragments.ids == 1) & ~hole
    assert np.isfinite(depth[wall]).mean() > 0.8 and np.isinf(depth[hole | support]).all()
    seen = wall & np.isfinite(depth)
    assert np.allclose(depth[seen], fragments.depth[seen], rtol=1e-3)
    assert np.isinf(hiding(seen_scene(geometry=False), support, hole)).all()


def test_it_is_stored_whatever_comes_after(tmp_path: Path) -> None:
    folder = tmp_path / "input"
    write_folder(folder)
    read, store = inputs.read(folder), Store(tmp_path / "store")
    most = [s for s in SKIPPABLE if s not in ("level", "inpaint")]
    first = reconstruct(read, skip=most, store=store)
    again = reconstruct(read, skip=[s for s in most if s != "relate"], store=store)
    assert "inpaint" not in first.resumed and "inpaint" in again.resumed and "relate" not in again.resumed
    assert first.inpainting is not None and again.inpainting is not None
    assert np.array_equal(first.inpainting.rgb, again.inpainting.rgb)
    assert np.array_equal(first.inpainting.support, again.inpainting.support)
    assert np.array_equal(first.inpainting.kept, again.inpainting.kept)
    assert first.reports[-1] == again.reports[-1]


def test_a_package_has_it(tmp_path: Path) -> None:
    folder, out = tmp_path / "input", tmp_path / "out"
    write_folder(folder)
    assert main(["reconstruct", str(folder), "-o", str(out), "--skip", "align,refine,evaluate"]) == 0
    package = read_package(out)
    background, support = package.background(), package.support()
    assert background is not None and background.shape == package.scene.photo.rgb.shape
    assert support is not None and support.shape == background.shape[:2] and support.any()
    kept = package.kept_depth()
    assert kept is not None and kept.shape == support.shape and np.isinf(kept[support]).all()
    masks = np.any([o.mask for o in package.scene], axis=0)
    assert (background != package.scene.photo.rgb)[masks].any()


@pytest.mark.parametrize("change", ["deleted", "other", "broken"])
def test_no_plan_and_no_rollout_depends_on_it(tmp_path: Path, change: str) -> None:
    package = goal_package(tmp_path / "package")
    other = shutil.copytree(package.folder, tmp_path / "other")
    photo = Image.open(package.folder / "photo.png")
    photo.save(package.folder / "background.png")
    if change == "other":
        Image.new("RGB", photo.size, (9, 99, 9)).save(other / "background.png")
    elif change == "broken":
        (other / "background.png").write_bytes(b"no picture")
    for folder, out in ((package.folder, "one"), (other, "two")):
        assert main(["simulate", str(folder), GOAL, "-o", str(tmp_path / out), "--no-film"]) == 0
    for name in ("plan.json", "rollout.npz", "verdict.json"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def _too_large(file: Path) -> None:
    """A header that claims more than any photo has."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (10**6, 10**6)})
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("depth.npy", header.getvalue() + bytes(1000))


@pytest.mark.parametrize(
    "damage",
    [
        lambda file: file.write_bytes(b"PK nothing"),
        lambda file: file.write_bytes(b""),
        lambda file: np.savez(file, depth=np.ones((3, 4), np.float32)),
        lambda file: np.savez(file, other=np.ones((48, 64), np.float32)),
        lambda file: np.savez(file, depth=np.full((48, 64), np.nan, np.float32)),
        lambda file: np.savez(file, depth=np.full((48, 64), -1, np.float32)),
        lambda file: np.savez(file, depth=np.full((48, 64), 1e-30, np.float32)),
        lambda file: np.savez(file, depth=np.full((48, 64), "a")),
        _too_large,
    ],
)
def test_damaged_depths_are_told_in_one_line(tmp_path: Path, damage: Callable[[Path], object]) -> None:
    package = goal_package(tmp_path / "package")
    damage(package.folder / "kept_depth.npz")
    with pytest.raises(InputError, match=r"kept_depth\.npz.*accepted"):
        package.kept_depth()
