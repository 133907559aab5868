"""How well poses are known, and samples of scenes: laws, analytic cases and differential checks."""

from __future__ import annotations

import itertools
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import f3sr
from f3sr.cli.main import main
from f3sr.contact_retries import ContactRetries
from f3sr.core.camera import Camera
from f3sr.core.pose_uncertainty import PoseUncertainty
from f3sr.core.transforms import Array, pose, rotation_from_vector, skew
from f3sr.errors import InputError
from f3sr.pipeline_config import Config, with_shared_settings
from f3sr.play.sample_rollouts import SuccessRate
from f3sr.scene import GROUND, Ground, Scene, Support
from f3sr.stages.uncertainty import uncertainty
from f3sr.uncertainty import sampling
from f3sr.uncertainty.config import UncertaintyConfig
from f3sr.uncertainty.pose_information import Information, of_depth, of_picture, precisions
from f3sr.uncertainty.sampling import Rejected, Sample, SamplingConfig, draw
from f3sr.vision import depth_prior, rasterizer
from f3sr.vision.motion_params import intrinsics_velocities, similarity_velocities
from scenes import ball_mesh, box, box_stack_scene, measured, scene_of, visible_iou


def large(scene: Scene) -> Scene:
    """The scene ten times as fine, with the masks that its objects show."""
    camera = replace(scene.camera.resized(640, 480), T_world_camera=scene.camera.T_world_camera)
    photo = replace(scene.photo, rgb=np.zeros((480, 640, 3), np.uint8))
    seen = rasterizer.render(scene.objects, camera)
    objects = tuple(replace(o, mask=seen.ids == o.id) for o in scene)
    return replace(scene, camera=camera, photo=photo, objects=objects)


@pytest.fixture(scope="module")
def pile() -> Scene:
    """Three boxes on each other."""
    return large(box_stack_scene(3))


# --- derivatives ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", range(7))
def test_a_velocity_is_the_derivative_of_a_similarity(k: int, pile: Scene):
    camera, middle, points = pile.camera, pile[1].bounds_world.mean(0), pile[1].vertices_world
    h, ends = 1e-6, list[Array]()
    for sign in (-1, 1):
        q = np.zeros(7)
        q[k] = sign * h
        moved = np.exp(q[6]) * (points - middle) @ rotation_from_vector(q[3:6]).T + middle + q[:3]
        ends.append(camera.to_camera(moved))
    field = similarity_velocities(middle, camera)[k]
    seen = np.column_stack([camera.to_camera(points), np.ones(len(points))])
    np.testing.assert_allclose(seen @ field.T, (ends[1] - ends[0]) / (2 * h), atol=1e-7)


@pytest.mark.parametrize("k", range(3))
def test_a_velocity_is_the_derivative_of_the_intrinsics(k: int, pile: Scene):
    camera, points = pile.camera, pile[1].vertices_world
    h = 1e-5
    K = camera.K.copy()
    if k < 2:
        K[k, 2] += h
    else:
        K[[0, 1], [0, 1]] *= np.exp(h)
    shifted = Camera(width=camera.width, height=camera.height, K=K, T_world_camera=camera.T_world_camera)
    seen = camera.to_camera(points)
    field = intrinsics_velocities(camera)[k]
    moved = seen + h * np.column_stack([seen, np.ones(len(seen))]) @ field.T
    there = moved @ camera.K.T
    np.testing.assert_allclose(there[:, :2] / there[:, 2:], shifted.project(points)[0], atol=1e-8)


def test_skew_is_the_cross_product():
    a, b = np.random.default_rng(0).normal(size=(2, 3))
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b))


# --- information ------------------------------------------------------------------------------------------------------


def test_every_part_of_the_information_is_a_covariance_inverse(pile: Scene):
    found = Information.of(pile, UncertaintyConfig())
    np.testing.assert_allclose(found.matrix, found.matrix.T, rtol=1e-9, atol=1e-6 * np.abs(found.matrix).max())
    for joint, alone in zip(found.covariance().values(), found.conditional().values(), strict=True):
        assert np.linalg.eigvalsh(joint)[0] > 0
        # To know all else exactly cannot make a pose less certain.
        assert np.linalg.eigvalsh(joint - alone)[0] > -1e-9 * np.trace(joint)


def test_a_silhouette_says_nothing_of_the_distance_that_a_scale_undoes(pile: Scene):
    o, C = pile[0], pile.camera.center
    picture = of_picture(o, pile, np.ones_like(o.mask), UncertaintyConfig(stretch=0.2))
    middle = o.bounds_world.mean(0)
    homothety = np.concatenate([middle - C, np.zeros(3), [1], np.zeros(3)])
    across = np.concatenate([[0, 0, 1], np.zeros(7)])
    shown, felt = (v @ picture @ v / (v[:3] @ v[:3]) for v in (homothety, across))
    assert shown < 1e-6 * felt


def test_depth_tells_the_distance_to_its_sigma(pile: Scene):
    o, C = pile[0], pile.camera.center
    row = of_depth(o, pile.camera, 0.02)
    ray = o.bounds_world.mean(0) - C
    assert np.sqrt(ray @ row[:3, :3] @ ray) == pytest.approx(1 / 0.02)
    assert np.linalg.matrix_rank(row) == 1


def test_nothing_shows_the_yaw_of_a_ball():
    mesh = ball_mesh(0.05)
    o = replace(box(0), mesh=mesh, T_world_object=pose(t=np.array([0, 0, 0.05])), supported_by=GROUND)
    scene = measured(scene_of(replace(o, supports=(Support(id=GROUND),))), "estimate")
    known = uncertainty(scene)[1].poses[0]
    assert known.yaw > np.pi / 2
    assert known.size < 0.2


def test_a_scale_costs_what_it_takes_from_the_picture():
    """A shift of a ball moves its outline by its cosine, a scale all of it: that costs twice as much. Were a stretched
    shape allowed for, as in the covariance, a scale that takes a tenth of the mask would cost next to nothing."""
    ball = replace(box(0), mesh=ball_mesh(0.1), T_world_object=pose(t=np.array([0, 0, 0.1])))
    scene = large(scene_of(ball))
    cost = precisions(scene, [0], UncertaintyConfig())[0]
    across = scene.camera.T_world_camera[:3, 0]
    assert cost[6, 6] / 0.1**2 == pytest.approx(2 * across @ cost[:3, :3] @ across, rel=0.15)


def test_a_sensor_makes_distances_certain(pile: Scene):
    estimate, sensor = (uncertainty(measured(pile, source))[1].poses for source in ("estimate", "sensor"))
    unknown = uncertainty(pile)[1].poses
    for id in estimate:
        assert sensor[id].along_ray < estimate[id].along_ray <= unknown[id].along_ray * 1.001


def test_an_unsure_focal_length_makes_sizes_uncertain(pile: Scene):
    known = measured(pile, "estimate")
    assert known.geometry is not None
    unsure = replace(known, geometry=replace(known.geometry, focal_error=0.1))
    one, other = uncertainty(known)[1].poses, uncertainty(unsure)[1].poses
    assert all(other[id].size > 1.03 * one[id].size for id in one)


def test_contact_makes_heights_certain(pile: Scene):
    """A box that hangs in the air is known less than one that stands."""
    flat = replace(pile, ground=Ground(height_error=1e-4, tilt_error=1e-4))
    up = pose(t=np.array([0, 0, 0.05]))
    floating = replace(flat, objects=tuple(o.moved(up, stage="test", reason="") for o in flat))
    heights = [
        np.sqrt(Information.of(s, UncertaintyConfig()).covariance()[0][2, 2]) for s in (flat, floating)
    ]  # fmt: skip
    assert heights[0] < 0.7 * heights[1]


def test_a_fixed_object_has_no_uncertainty(pile: Scene):
    fixed = pile.with_objects(replace(pile[0], mobility="fixed"))
    assert set(uncertainty(fixed)[1].poses) == {1, 2}


def test_intervals_are_those_of_the_covariance():
    known = PoseUncertainty.of(np.diag([4.0, 1, 1, 0.01, 0.01, 0.04, 0.09]), np.eye(7), np.array([1.0, 0, 0]))
    assert known.along_ray == pytest.approx(1.645 * 2)
    # 90 % of the length of two equal normal variables: the square root of chi2(2) at .9, 4.605.
    assert known.across_ray == pytest.approx(np.sqrt(4.605), rel=1e-3)
    assert known.yaw == pytest.approx(1.645 * 0.2)
    assert known.tilt == pytest.approx(np.sqrt(4.605) * 0.1, rel=1e-3)
    assert known.size == pytest.approx(1.645 * 0.3)


def test_a_given_noise_of_the_geometry_holds(pile: Scene):
    seen = measured(pile, "estimate")
    assert seen.geometry

    def known(noise: float | None) -> dict[int, float]:
        return depth_prior.sigmas(replace(seen, geometry=replace(seen.geometry, noise=noise)))

    assert set(known(None).values()) == {depth_prior.GEOMETRY_SIGMA}
    assert set(known(0.04).values()) == {0.04}
    assert set(known(0.002).values()) == {0.002}
    precise, coarse = (replace(seen, geometry=replace(seen.geometry, noise=n)) for n in (0.002, 0.04))
    assert precise.has_measured_depth
    assert not coarse.has_measured_depth
    along = [uncertainty(s)[1].poses[0].along_ray for s in (precise, coarse)]
    assert along[0] < along[1]


@pytest.mark.parametrize("noise", [0.0, -0.1, 0.6, float("nan"), float("inf")])
def test_a_noise_that_no_geometry_has_is_refused(folder: Path, noise: float):
    with pytest.raises(InputError, match="--geometry-noise"):
        f3sr.read_inputs(folder, geometry_noise=noise)


def test_a_given_noise_is_told_and_makes_other_results(folder: Path):
    given, told = f3sr.read_inputs(folder), f3sr.read_inputs(folder, geometry_noise=0.02)
    assert given.key != told.key
    assert any("2 % of the distance" in d.choice for d in told.decisions)


# --- samples ----------------------------------------------------------------------------------------------------------


def test_slice_sampling_draws_from_a_normal_distribution_that_is_cut_off():
    rng = np.random.default_rng(1)
    x, drawn = np.array([1.0, 0.0]), list[Array]()
    for _ in range(6000):
        x = sampling._slice(x, lambda x: x[0] > 0, rng)  # pyright: ignore[reportPrivateUsage]
        drawn.append(x)
    half, free = np.array(drawn).T
    assert half.min() > 0
    # The mean of a half-normal variable is the square root of 2 / pi, its mean square is 1.
    assert half.mean() == pytest.approx(np.sqrt(2 / np.pi), abs=0.05)
    assert np.mean(half**2) == pytest.approx(1, abs=0.1)
    assert (free.mean(), free.std()) == (pytest.approx(0, abs=0.08), pytest.approx(1, abs=0.08))


def test_drawn_poses_keep_their_masks_and_their_contacts(pile: Scene):
    covariances = Information.of(pile, UncertaintyConfig()).conditional()
    config = SamplingConfig()
    poses = sampling._Poses(pile, covariances, config)  # pyright: ignore[reportPrivateUsage]
    rng = np.random.default_rng(0)
    for _ in range(5):
        poses.sweep(rng)
        drawn = poses.scene()
        assert visible_iou(drawn) > visible_iou(pile) - 3 * config.loss
        assert drawn[0].bounds_world[0, 2] == pytest.approx(pile[0].bounds_world[0, 2], abs=1e-6)
        for upper, lower in itertools.pairwise(reversed(list(drawn))):
            assert upper.bounds_world[0, 2] == pytest.approx(lower.bounds_world[1, 2], abs=2e-3)
        assert drawn[2].scale != pile[2].scale


def test_a_group_that_moves_as_one_keeps_its_contacts(pile: Scene):
    covariances = Information.of(pile, UncertaintyConfig()).conditional()
    poses = sampling._Poses(pile, covariances, SamplingConfig())  # pyright: ignore[reportPrivateUsage]
    moved = poses.as_one([0, 1, 2], np.random.default_rng(0))
    scales = [o.scale / pile[o.id].scale for o in moved]
    assert scales == [pytest.approx(scales[0])] * 3
    assert scales[0] != 1
    relative = [np.linalg.inv(moved[0].T_world_asset) @ o.T_world_asset for o in moved]
    before = [np.linalg.inv(pile[0].T_world_asset) @ o.T_world_asset for o in pile]
    np.testing.assert_allclose(relative, before, atol=1e-9)
    assert min(o.bounds_world[0, 2] for o in moved) == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
def test_samples_rest_and_meet_the_masks_and_repeat(pile: Scene):
    covariances = Information.of(pile, UncertaintyConfig()).conditional()
    settle = ContactRetries(config=with_shared_settings(Config())).settled

    def drawn(seed: int, tries: int) -> list[Sample]:
        scenes = draw(pile, covariances, settle, SamplingConfig(), seed=seed)
        return [s for s in itertools.islice(scenes, tries) if isinstance(s, Sample)]

    samples = drawn(0, 3)
    assert len(samples) >= 2
    best = visible_iou(pile)
    for s in samples:
        assert s.measures.mIoU_visible >= best - 0.01
        assert s.measures.N_cross == 0
        assert s.measures.D_max_cm <= 0.1
    places = [[o.T_world_object for o in s.scene] for s in samples]
    assert np.ptp(np.array(places), axis=0).max() > 1e-5
    again = [[o.T_world_object for o in s.scene] for s in drawn(0, 2)]
    np.testing.assert_array_equal(places[: len(again)], again)
    assert again and not np.array_equal(places[0], [o.T_world_object for o in drawn(1, 1)[0].scene])


def test_what_falls_is_no_sample(pile: Scene):
    """A settling that lets all fall: no sample, whatever is drawn; nor is the scene itself."""
    covariances = Information.of(pile, UncertaintyConfig()).conditional()
    away = pose(t=np.array([1.0, 0, 0]))

    def falls(before: Scene, /, *, start: Scene, moving: frozenset[int]) -> sampling.SettledScene:
        gone = start.with_objects(*(start[id].moved(away, stage="test", reason="") for id in sorted(moving)))
        return sampling.SettledScene(scene=gone, restless=frozenset())

    found = next(draw(pile, covariances, falls, SamplingConfig(halvings=1, sweeps=2)))
    if isinstance(found, Sample):
        # All groups moved as one body instead, and the sample says so.
        assert found.as_one == {0, 1, 2}
        assert found.measures.mIoU_visible >= visible_iou(pile) - 0.01
    else:
        assert isinstance(found, Rejected)


@pytest.mark.parametrize(("met", "count"), [(3, 5), (0, 7), (20, 20), (17, 20)])
def test_the_interval_of_a_success_rate_is_wilsons(met: int, count: int):
    rate = SuccessRate(met=met, count=count, missed={})
    from scipy.stats import binomtest

    low, high = binomtest(met, count).proportion_ci(0.9, method="wilson")
    assert rate.interval == (pytest.approx(low, abs=1e-4), pytest.approx(high, abs=1e-4))


# --- packages and commands --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def package(whole: f3sr.Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return f3sr.deliver(whole, tmp_path_factory.mktemp("uncertain") / "out")


def test_a_package_tells_how_well_its_poses_are_known(package: Path, whole: f3sr.Reconstruction):
    assert f3sr.read_package(package).uncertainty == dict(whole.uncertainty)
    assert set(whole.uncertainty) == {o.id for o in whole.scene}


@pytest.mark.parametrize("name", ["covariance", "conditional"])
@pytest.mark.parametrize("broken", ["lopsided", "negative", "short", "infinite"])
def test_what_is_no_covariance_is_refused(package: Path, tmp_path: Path, name: str, broken: str):
    tree = json.loads((package / "scene.json").read_text())
    matrix = tree["objects"][0]["uncertainty"][name]
    if broken == "lopsided":
        matrix[0][1] += 1.0
    elif broken == "negative":
        matrix[0][0] = -1.0
    elif broken == "short":
        matrix.pop()
    else:
        matrix[0][0] = 1e300
    copy = shutil.copytree(package, tmp_path / "copy")
    (copy / "scene.json").write_text(json.dumps(tree))
    with pytest.raises(InputError, match=r"scene\.json"):
        f3sr.read_package(copy)


def test_sample_writes_packages_that_can_be_read(package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    package, out = shutil.copytree(package, tmp_path / "package"), tmp_path / "samples"
    tree = json.loads((package / "scene.json").read_text())
    tree["objects"][0] |= {"mobility": "fixed", "mobility_source": "found"}
    (package / "scene.json").write_text(json.dumps(tree))
    assert main(["sample", str(package), "-n", "2", "-o", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["held"] == [tree["objects"][0]["id"]]
    assert [row["folder"] for row in told["samples"]] == ["001", "002"]
    original = f3sr.read_package(package)
    for row in told["samples"]:
        content = f3sr.read_package(out / row["folder"])
        assert [o.label for o in content.scene] == [o.label for o in original.scene]
        assert content.document.provenance["sample"]["of"] == told["scene"]
        assert row["mIoU_visible"] >= visible_iou(original.scene) - 0.01
    assert json.loads((out / "samples.json").read_text())["samples"] == told["samples"]
    assert json.loads((out / "samples.json").read_text())["held"] == told["held"]
    assert main(["sample", str(package), "-n", "2", "-o", str(out)]) == 1
    assert "is there already" in capsys.readouterr().err


def test_what_cannot_be_sampled_is_one_clear_error(package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for count in ("0", "-3", "100000"):
        assert main(["sample", str(package), "-n", count, "-o", str(tmp_path / "out")]) == 2
        assert f"-n: found {count}; accepted: from 1 to 10,000" in capsys.readouterr().err
    assert main(["simulate", str(package), "knock over box 2", "--samples", "-3", "--no-film"]) == 2
    assert "--samples: found -3; accepted: from 1 to" in capsys.readouterr().err
    assert main(["sample", str(package), "--seed", "-1", "-o", str(tmp_path / "out")]) == 2
    assert "seed: found -1" in capsys.readouterr().err
    tree = json.loads((package / "scene.json").read_text())
    for o in tree["objects"]:
        del o["uncertainty"]
    old = shutil.copytree(package, tmp_path / "old")
    (old / "scene.json").write_text(json.dumps(tree))
    assert main(["sample", str(old), "-o", str(tmp_path / "out")]) == 2
    assert "no uncertainty of any pose" in capsys.readouterr().err
    assert main(["simulate", str(old), "knock over box 2", "--samples", "3", "--no-film"]) == 2
    for o in tree["objects"]:
        o["mobility"] = "fixed"
    (old / "scene.json").write_text(json.dumps(tree))
    assert main(["sample", str(old), "-o", str(tmp_path / "out")]) == 2
    assert "found only fixed objects: objects 2, 5 and 7" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_plan_is_played_in_samples(package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    goals = f3sr.read_package(package)
    active = goals.scene.objects[-1].label
    arguments = ["simulate", str(package), f"knock over the {active}", "--samples", "2", "--no-film", "--json"]
    code = main([*arguments, "-o", str(tmp_path / "rollout")])
    told = json.loads(capsys.readouterr().out)["goals"][0]
    if told["state"] == "refused":
        pytest.fail(f"refused: {told}")
    assert code in (0, 4)
    rate = told["samples"]
    assert rate["wanted"] == rate["count"] == 2
    assert rate["met"] == 2 - len(rate["missed"])
    assert rate["interval"][0] <= rate["rate"] <= rate["interval"][1]


def test_rises_of_a_carrier_lift_what_it_carries(pile: Scene):
    covariances = {0: np.diag([0.0, 0, 0, 0, 0, 0, 1e-3])}
    poses = sampling._Poses(pile, covariances, SamplingConfig())  # pyright: ignore[reportPrivateUsage]
    poses.x[0] = np.array([0.0, 0, 0, 0, 0, 0, 1])
    drawn = poses.scene()
    top = drawn[0].bounds_world[1, 2]
    assert top > pile[0].bounds_world[1, 2]
    assert drawn[1].bounds_world[0, 2] == pytest.approx(top, abs=1e-9)
    np.testing.assert_allclose(drawn[1].T_world_object[:2, 3], pile[1].T_world_object[:2, 3])
