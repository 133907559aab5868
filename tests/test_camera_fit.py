"""Laws of the camera that foreign scenes are measured by: found again, never worse, bounded, the same twice."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import rotation_about
from f3sr.io import inputs
from f3sr.metrics.camera_fit import ForeignCameraConfig, InstancesFit, fitted_camera, iou_loss, mean_iou
from f3sr.metrics.measures import IMAGE_MEASURES, Measures, measure
from f3sr.pipeline import SKIPPABLE, composed_directly, reconstruct
from f3sr.runtime.result_forms import PlainForm
from f3sr.runtime.result_store import Store
from f3sr.scene import Photo, Scene
from f3sr.stages.evaluate import DIRECT, Evaluation, direct_composition, evaluate
from f3sr.vision import rasterizer
from f3sr.vision.decimated import outlined
from f3sr.vision.motion_params import CameraFreedom
from f3sr.vision.silhouette import Surface, Target, iou
from folders import boxes, camera

EYE = camera().resized(640, 480)


def scene() -> Scene:
    """The boxes of the test folder with their own full silhouettes as masks: seen perfectly."""
    shown = [replace(o, mask=silhouette(o, EYE)) for o in boxes()]
    rgb = np.random.default_rng(0).integers(0, 256, (EYE.height, EYE.width, 3), np.uint8)
    return Scene(photo=Photo(rgb=rgb), camera=EYE, objects=tuple(shown))


def silhouette(o, eye: Camera) -> np.ndarray:
    return rasterizer.silhouette(eye.to_camera(o.vertices_world), o.mesh.faces, eye.K, eye.width, eye.height)


def freedom(s: Scene, *, turn: float, way: float) -> CameraFreedom:
    """That of ``fitted_camera`` around the scene's camera."""
    center = s.camera.to_camera(np.median([o.bounds_world.mean(0) for o in s], axis=0)[None])[0]
    return CameraFreedom(
        camera=s.camera, center=center, reach=np.array([turn] * 3 + [way * float(np.linalg.norm(center))] * 3)
    )


def disturbed(s: Scene, u: np.ndarray, *, turn: float = math.radians(8), way: float = 0.15) -> Scene:
    return replace(s, camera=freedom(s, turn=turn, way=way).at(u))


@pytest.mark.parametrize("seed", range(6))
def test_a_disturbed_camera_is_found_again(seed: int):
    start = disturbed(scene(), np.random.default_rng(seed).uniform(-1, 1, 6))
    before = mean_iou(start, start.camera)
    found, decision = fitted_camera(start)
    assert before < 0.7 and mean_iou(start, found) > 0.995
    assert decision.choice == "camera fitted" and f"mIoU {before:.4f} -> " in decision.reason


def test_what_fits_already_stays_as_it_is():
    s = scene()
    found, decision = fitted_camera(s)
    assert found is s.camera and decision.choice == "camera as given" and not decision.fallback


@pytest.mark.parametrize("seed", range(4))
def test_never_worse_however_wrong_the_scene(seed: int):
    """Objects thrown about, so that no camera sees them well, some outside the picture or behind the camera."""
    rng = np.random.default_rng(seed)
    s = scene()
    thrown = [replace(o, T_world_object=_shifted(o.T_world_object, rng.normal(0, 0.2 + 0.3 * seed, 3))) for o in s]
    s = s.with_objects(*thrown)
    found, decision = fitted_camera(s, ForeignCameraConfig(resolution=160))
    assert mean_iou(s, found) >= mean_iou(s, s.camera)
    assert np.isfinite(found.T_world_camera).all() and decision.reason


def _shifted(T: np.ndarray, by: np.ndarray) -> np.ndarray:
    T = T.copy()
    T[:3, 3] += by
    return T


def test_it_stays_inside_its_bounds():
    from scipy.spatial.transform import Rotation

    config = ForeignCameraConfig(max_rotation=math.radians(2), max_translation=0.03)
    s = disturbed(scene(), np.array([1, -1, 1, 1, -1, 1.0]), turn=math.radians(6), way=0.12)
    found, _ = fitted_camera(s, config)
    assert found is not s.camera
    R = found.T_camera_world[:3, :3] @ s.camera.T_world_camera[:3, :3]
    assert np.abs(Rotation.from_matrix(R).as_rotvec()).max() <= config.max_rotation + 1e-9
    middle = np.median([o.bounds_world.mean(0) for o in s], axis=0)[None]
    old, new = s.camera.to_camera(middle)[0], found.to_camera(middle)[0]
    assert np.abs(new - old).max() <= config.max_translation * np.linalg.norm(old) + 1e-9
    assert np.array_equal(found.K, s.camera.K) and (found.width, found.height) == (s.camera.width, s.camera.height)


def test_twice_the_same_and_whatever_world_it_stands_in():
    s = disturbed(scene(), np.array([0.5, -0.4, 0.3, -0.2, 0.6, -0.5]))
    a, b = fitted_camera(s)[0], fitted_camera(s)[0]
    assert np.array_equal(a.T_world_camera, b.T_world_camera)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_about([0.2, 0.4, 1], 0.9), [3, -2, 1]
    moved = replace(
        s.with_objects(*(replace(o, T_world_object=T @ o.T_world_object) for o in s)),
        camera=s.camera.moved(T @ s.camera.T_world_camera),
    )
    # Boxes around turned objects have other middles, so another point to turn about: the same optimum by another way.
    assert mean_iou(moved, fitted_camera(moved)[0]) == pytest.approx(mean_iou(s, a), abs=0.004)


def test_masks_without_a_pixel_are_left_out():
    s = disturbed(scene(), np.array([0.2, -0.2, 0.2, 0.1, 0.1, 0.1]))
    first, *others = s.objects
    speck = np.zeros_like(first.mask)
    speck[3, 5] = True  # between the pixels of a smaller picture
    partly = s.with_objects(replace(first, mask=speck))
    found, _ = fitted_camera(partly, ForeignCameraConfig(resolution=200))
    assert all(iou(silhouette(o, found), o.mask) > 0.98 for o in others)
    empty = s.with_objects(*(replace(o, mask=np.zeros_like(o.mask)) for o in s))
    kept, decision = fitted_camera(empty)
    assert kept is s.camera and decision.fallback


def test_heavy_meshes_are_searched_light_and_judged_whole():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.06)
    mesh = Mesh(vertices=np.asarray(ball.vertices), faces=np.asarray(ball.faces, np.int32))
    heavy = [replace(o, mesh=mesh, scale=1.0) for o in boxes()]
    shown = [replace(o, mask=silhouette(o, EYE)) for o in heavy]
    s = disturbed(replace(scene(), objects=tuple(shown)), np.array([0.3, -0.4, 0.2, -0.3, 0.2, 0.4]))
    light = outlined(s.objects[0], 1000)
    assert len(light.mesh.faces) <= 1000 < len(mesh.faces) and outlined(light, 1000) is light
    assert outlined(s.objects[1], 1000).mesh is light.mesh
    found, decision = fitted_camera(s, max_faces=1000)
    assert mean_iou(s, found) > 0.98 and f"-> {mean_iou(s, found):.4f}" in decision.reason


def test_the_loss_is_one_minus_iou_and_its_gradient_that_of_central_differences():
    s, u, h = scene(), np.array([0.3, -0.2, 0.25, 0.2, -0.3, 0.15]), 0.02
    fit = InstancesFit(
        surfaces=tuple(Surface.of([(o.vertices_world, o.mesh.faces)]) for o in s),
        targets=tuple(Target.of(o.mask) for o in s),
        freedom=freedom(s, turn=math.radians(8), way=0.15),
    ).without_distances()
    here = fit.objective(u, iou_loss)
    assert here.value == pytest.approx(1 - mean_iou(s, fit.freedom.at(u)), abs=2e-3)
    expected = [
        (fit.objective(u + h * e, iou_loss).value - fit.objective(u - h * e, iou_loss).value) / (2 * h)
        for e in np.eye(6)
    ]
    assert np.linalg.norm(here.gradient - expected) < 0.02 * np.linalg.norm(expected)
    assert np.linalg.eigvalsh(here.curvature).min() > 0


# --- in the table of measures ---------------------------------------------------------------------------------


def test_a_fitted_row_differs_only_in_the_picture(given: inputs.Inputs):
    composed = composed_directly(given)
    found = evaluate(composed, None, foreign=True)
    assert found.result_fitted is not None and found.direct is None and found.direct_fitted is None
    fitted = found.result_fitted.measures
    assert fitted.mIoU > found.result.mIoU
    for f in fields(Measures):
        if f.name not in IMAGE_MEASURES:
            assert getattr(fitted, f.name) == getattr(found.result, f.name), f.name
    camera = composed.camera.moved(np.array(found.result_fitted.T_world_camera))
    again = measure(replace(composed, camera=camera))
    assert {name: getattr(again, name) for name in IMAGE_MEASURES} == {
        name: getattr(fitted, name) for name in IMAGE_MEASURES
    }
    assert list(found.rows(DIRECT)) == [DIRECT, f"{DIRECT}, fitted camera"]


@pytest.mark.parametrize(("skip", "foreign"), [([], False), (["align-camera"], True), (["align"], True)])
def test_a_result_whose_camera_was_not_aligned_is_foreign(
    given: inputs.Inputs, stages: Store, skip: list[str], foreign: bool
):
    result = reconstruct(given, skip=["refine", "settle", "uncertainty", "inpaint", *skip], store=stages)
    found = result.evaluation
    assert found is not None and found.direct_fitted is not None
    assert (found.result_fitted is not None) == foreign == (not result.provenance["camera_aligned"])
    titles = [DIRECT, f"{DIRECT}, fitted camera", "f3sr", *(["f3sr, fitted camera"] if foreign else [])]
    assert list(found.rows()) == titles
    assert len(found.report.decisions) == 1 + foreign


def test_an_evaluation_comes_back_from_plain_json(given: inputs.Inputs):
    found = evaluate(composed_directly(given), None, foreign=True)
    both = replace(found, direct=found.result, direct_details=found.result_details, direct_fitted=found.result_fitted)
    form = PlainForm(Evaluation)
    for evaluation in (found, both, replace(found, result_fitted=None)):
        document, arrays = form.packed(evaluation)
        assert form.unpacked(json.loads(json.dumps(document)), arrays) == evaluation
        assert json.loads(json.dumps(asdict(evaluation))) == document


def test_direct_composition_alone_is_that_beside_a_result(given: inputs.Inputs, stages: Store):
    result = reconstruct(given, skip=["refine", "settle", "uncertainty", "inpaint"], store=stages)
    alone, beside = composed_directly(given), direct_composition(result.direct, result.scene)
    assert np.array_equal(alone.camera.T_world_camera, beside.camera.T_world_camera)
    for o in alone:
        assert np.array_equal(o.T_world_object, beside[o.id].T_world_object) and o.scale == beside[o.id].scale
    assert result.evaluation and evaluate(alone, None).result == result.evaluation.direct


@pytest.mark.parametrize("name", ["scenes/dev_01_contain", "real/ycb_table_1"])
def test_raw_scenes_gain_by_a_camera_of_their_own(shared_data: Path, name: str):
    """Equation 7's union of masks makes the first of them worse (.68 to .53): it looks at no instance."""
    s = reconstruct(inputs.read(shared_data / name), skip=[s for s in SKIPPABLE if s != "level"]).scene
    found, _ = fitted_camera(s)
    assert mean_iou(s, found) > mean_iou(s, s.camera) + 0.03
