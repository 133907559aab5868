"""Laws of the physics model: one box analytically, rest, and the release against a second writing."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import f3sr
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import rotation_about
from f3sr.files.bounds import MIN_MOMENT
from f3sr.physics import mujoco_model, settling
from f3sr.physics.mujoco_model import PhysicsConfig, body_of, build_spec
from f3sr.physics.near_pairs import NearPairs
from f3sr.physics.outlook import Outlook, Snapshot
from f3sr.physics.release import RELEASE_MARGIN, filling, release, release_pairs, released_pose
from f3sr.physics.settling import RestConfig, SettleConfig, settle
from f3sr.scene import SceneObject
from f3sr.stages.assemble import assemble
from scenes import box, box_mesh, box_stack_scene, scene_of

G = 9.81
TWO_MARGINS = 2 * PhysicsConfig().margin


def settled(objects: tuple[SceneObject, ...]) -> tuple[SceneObject, ...]:
    result = settle(objects)
    assert result.at_rest and not result.exploded
    return tuple(replace(o, T_world_object=result.T_world_object[o.id]) for o in objects)


def test_a_dropped_box_comes_to_rest_on_the_plane() -> None:
    result = settle([box(0, at=(0.2, -0.1, 0.055))])
    assert result.at_rest and result.seconds < 1 and max(result.drifts.values()) < 1e-6
    assert result.max_speed == pytest.approx(np.sqrt(2 * G * 0.005), rel=0.1)
    x, y, z = result.T_world_object[0][:3, 3]
    assert 0.05 - 1e-5 < z < 0.05 + TWO_MARGINS and abs(x - 0.2) < 1e-4 and abs(y + 0.1) < 1e-4


@pytest.mark.parametrize("size", [(5e-4, 5e-4, 1e-4), (8e-3, 2e-4, 2e-4)])
def test_grains_and_needles_are_simulated_with_the_least_moment_that_the_engine_takes(size: tuple[float, ...]) -> None:
    o = box(0, size=size)
    mass, expected = o.density * np.prod(size), [(np.dot(size, size) - a**2) / 12 for a in size]
    moments = np.linalg.eigvalsh(body_of(o).inertia)
    assert moments == pytest.approx(sorted(np.maximum(mass * np.array(expected), mujoco_model.LEAST_MOMENT)), rel=1e-9)
    assert moments[0] > MIN_MOMENT > mass * min(expected)
    mujoco_model.compiled(build_spec([o]))
    decision = next(d for d in assemble(scene_of(o))[1].decisions if "principal moment" in d.choice)
    assert decision.fallback and decision.about == 0


def test_the_engine_prints_nothing_and_writes_no_file(tmp_path: Path) -> None:
    """States that blow up, and models of numbers that it doubts."""
    program = """
import numpy as np
from f3sr.physics.mujoco_model import build_spec, compiled, engine
from scenes import box
model = compiled(build_spec([box(0)]))
data = engine().MjData(model)
for value in (np.nan, np.inf, 1e30):
    data.qpos[0] = data.qvel[0] = value
    engine().mj_step(model, data)
assert data.warning.number.sum() > 0
spec = build_spec([box(0)])
spec.bodies[1].mass = 1e300
compiled(spec)
told, data = [], engine().MjData(model)
engine().set_mju_user_warning(told.append)
data.qpos[0] = np.nan
engine().mj_step(model, data)
assert told
"""
    paths = os.pathsep.join([str(Path(f3sr.__file__).parents[1]), str(Path(__file__).parent)])
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert not list(tmp_path.iterdir())


def test_a_settled_stack_does_not_move_when_released() -> None:
    K_max, D_max = release(settled(box_stack_scene(4).objects))
    assert K_max < 6e-4 and D_max < 4.1 * (2 * RELEASE_MARGIN - TWO_MARGINS), "pushed apart to the protocol's margins"


def test_a_raw_gap_shows_in_the_release() -> None:
    K_max, D_max = release([box(0, at=(0, 0, 0.051))], seconds=1)
    assert K_max > 1e-3 and D_max == pytest.approx(0.001 - TWO_MARGINS, abs=3e-4)


def test_a_needle_too_light_for_the_engine_s_inertia_is_released() -> None:
    needle = box(0, size=(0.1, 5e-5, 5e-5), at=(0, 0, 2.5e-5 + 2.6e-4))
    assert np.linalg.eigvalsh(body_of(needle).inertia)[0] >= MIN_MOMENT
    K_max, D_max = release([needle], seconds=0.2)
    assert K_max < 1e-6 and D_max < 1e-3


def test_a_box_over_an_edge_falls() -> None:
    shelf = replace(box(0), mobility="fixed")
    result = settle([shelf, box(1, at=(0.07, 0, 0.15))])
    assert result.T_world_object[1][2, 3] < 0.1 and result.max_speed > 0.1
    assert np.array_equal(result.T_world_object[0], shelf.T_world_object)


def test_a_fixed_object_floats_and_does_not_move() -> None:
    lamp = replace(box(0, at=(0, 0, 1)), mobility="fixed")
    assert np.array_equal(settle([lamp]).T_world_object[0], lamp.T_world_object)
    assert release([lamp], seconds=0.1) == (0, 0)


def test_kinetic_energy_of_a_free_fall() -> None:
    K_max, D_max = release([box(0, at=(0, 0, 3))], seconds=0.5)
    fallen = 0.5 * G * 0.5**2
    assert K_max == pytest.approx(0.6 * G * fallen, rel=0.01)
    assert D_max == pytest.approx(fallen, rel=0.01)


def test_the_true_scale_scales_the_release() -> None:
    K_max, D_max = release([box(0, at=(0, 0, 3))], seconds=0.2, true_scale=2)
    once = release([box(0, at=(0, 0, 3))], seconds=0.2)
    assert K_max == pytest.approx(8 * once.K_max, rel=1e-5) and D_max == pytest.approx(once.D_max, rel=1e-5)


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_explicit_inertia_is_that_of_the_box(scale: float) -> None:
    a, b, c = 0.1, 0.2, 0.3
    o = replace(box(0, size=(a, b, c), scale=scale), density=800.0)
    body, m = body_of(o), 800 * a * b * c
    moments = m / 12 * np.array([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    assert body.from_mesh and body.mass == pytest.approx(m)
    assert np.allclose(body.inertia, np.diag(moments), atol=1e-12) and np.allclose(body.center, 0, atol=1e-12)
    model = build_spec([o]).compile()
    assert model.body_mass[1] == pytest.approx(m)
    assert np.allclose(np.sort(model.body_inertia[1]), np.sort(moments))


def test_mass_of_an_open_mesh_is_that_of_its_parts() -> None:
    o = box(0)
    open_mesh = replace(o.mesh, faces=o.mesh.faces[:-1], face_material=None)
    body = body_of(replace(o, mesh=open_mesh))
    assert not body.from_mesh and body.mass == pytest.approx(0.6, rel=1e-5)


def test_a_changed_set_of_parts_changes_the_mass_of_an_open_mesh() -> None:
    o = box(0)
    o = replace(o, mesh=replace(o.mesh, faces=o.mesh.faces[:-1], face_material=None))
    half = ConvexPart.hull_of(o.mesh.vertices * [1, 1, 0.5])
    assert body_of(o).mass == pytest.approx(2 * body_of(replace(o, parts=(half,))).mass, rel=1e-5)


def test_an_object_without_parts_collides_with_its_hull() -> None:
    (bare,) = settled((replace(box(0), parts=()),))
    assert bare.T_world_object[2, 3] == pytest.approx(0.05, abs=TWO_MARGINS)


@pytest.mark.parametrize(("friction", "slides"), [(0.2, True), (0.8, False)])
def test_friction_decides_whether_a_box_slides_down_a_slope(friction: float, slides: bool) -> None:
    R = rotation_about([0, 1, 0], np.radians(25))
    normal = R @ [0, 0, 1]
    slope = replace(
        box(0, size=(2, 1, 0.1), at=(0, 0, 1), R=R), mobility="fixed", friction=friction, rolling_friction=0.0
    )
    crate = replace(box(1, at=np.array([0, 0, 1]) + 0.1004 * normal, R=R), friction=friction)
    result = settle([slope, crate], settling=SettleConfig(time_limit=1.0, check_time=0.5, rounds=1))
    travel = np.linalg.norm(result.T_world_object[1][:3, 3] - crate.T_world_object[:3, 3])
    assert (travel > 0.1) == slides and result.at_rest != slides


def test_only_what_still_moves_at_the_end_of_a_check_does_not_rest() -> None:
    """What drifts little and has not stopped is told; what rests elsewhere in the scene is not spoilt by it."""
    scene = [box(0, at=(0, 0, 0.05)), box(1, at=(1, 0, 40))]
    rest = RestConfig(drift=10.0, as_measured=False)
    result = settle(scene, settling=SettleConfig(time_limit=0.2, check_time=0.2, rounds=1, rest=rest))
    assert not result.at_rest and max(result.drifts.values()) < rest.drift
    assert result.moving == {1}


def test_a_scene_without_rest_is_reported_within_the_time_limit() -> None:
    high = [box(0, at=(0, 0, 500))]
    result = settle(high, settling=SettleConfig(time_limit=0.3, check_time=0.1, rest=RestConfig(window=0.05)))
    assert not result.at_rest and not result.exploded and result.seconds == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize(
    ("drifts", "creeps"),
    [([4, 4, 4], False), ([4, 4, 4, 4], True), ([4, 3, 2, 1], False), ([9, 1, 1, 1], False), ([9, 1, 1, 1, 1], True)],
)
def test_what_drifts_as_far_in_every_round_creeps(drifts: list[float], creeps: bool) -> None:
    assert settling._creeps(drifts) is creeps


def outlook(way: Callable[[float], float], *, drift: float = 0.0, windows: int = 10) -> Outlook | None:
    """That of a body that moves along x by ``way`` [m] of the time [s] and has drifted so far, beside one that is
    still, with 15 windows of .2 s left."""
    seen = [
        Snapshot(np.array([[0.0, 0, 0], [0, 0, 0], [way(0.2 * k), 0, 0]]), np.zeros((3, 3, 3))) for k in range(windows)
    ]
    return Outlook.of(seen, np.array([0.0, drift]), 5e-4, left=15)


@pytest.mark.parametrize("rate", [2.0, 6.0])
def test_an_undamped_check_does_not_end_while_something_tips(rate: float) -> None:
    """A body that tips moves exponentially, ever faster, however slowly it begins."""
    tips, calms = outlook(lambda t: 1e-7 * np.exp(rate * t)), outlook(lambda t: -1e-7 * np.exp(-rate * t))
    assert tips and not tips.rests and not tips.creeps
    assert calms and calms.rests and not calms.creeps


@given(st.floats(0, 1e-3), st.floats(0, 4e-4))
def test_an_undamped_check_ends_where_a_steady_drift_stays_allowed_four_times_over(speed: float, drift: float) -> None:
    ahead = 15 * 0.2 * speed
    assume(abs(drift + 4 * ahead - 5e-4) > 1e-6)
    steady = outlook(lambda t: speed * t, drift=drift)
    assert steady and steady.rests == (drift + 4 * ahead < 5e-4)


@given(st.floats(1e-5, 5e-3), st.floats(0, 4e-4))
def test_an_undamped_check_ends_where_a_drift_that_slows_down_is_too_far_even_at_a_quarter(
    speed: float, drift: float
) -> None:
    """.999 per window: a steady drift is faster or slower from one window to the next by rounding alone.

    The travel of a window is the larger of two, so up to .2 % too much."""
    ahead = 0.2 * speed * (0.999 ** np.arange(10, 25)).sum()
    assume(abs(drift + ahead / 4 - 5e-4) > 3e-3 * ahead)
    slowing = outlook(lambda t: 0.2 * speed * (1 - 0.999 ** (t / 0.2)) / 0.001, drift=drift)
    assert slowing and slowing.creeps == (drift + ahead / 4 > 5e-4)
    assert slowing.foreseen[1] == pytest.approx(drift + ahead, rel=3e-3)


def test_an_undamped_check_does_not_end_on_less_than_a_second() -> None:
    assert outlook(lambda t: 0.0, windows=5) is None
    still = outlook(lambda t: 0.0, windows=6)
    assert still and still.rests


@pytest.fixture
def wild(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gravity at which a simulation blows up."""
    monkeypatch.setattr(mujoco_model, "GRAVITY", 1e200)


@pytest.mark.usefixtures("wild")
def test_a_blow_up_is_reported_with_the_initial_poses() -> None:
    result = settle([box(0)])
    assert result.exploded and not result.at_rest
    assert np.array_equal(result.T_world_object[0], box(0).T_world_object)


def test_two_runs_give_equal_bytes() -> None:
    objects = box_stack_scene(3).objects
    first, second = settle(objects), settle(objects)
    assert all(first.T_world_object[o.id].tobytes() == second.T_world_object[o.id].tobytes() for o in objects)
    assert release(objects, seconds=0.3) == release(objects, seconds=0.3)


def test_rest_holds_for_both_distributions_of_mass() -> None:
    """A slab over an edge: its mesh has its weight on the table, its one part most of it in the air."""
    table = replace(box(0, size=(0.4, 0.4, 0.1)), mobility="fixed")
    slab = box(1, size=(0.3, 0.1, 0.02), at=(0.23, 0, 0.1105))
    slab = replace(slab, mesh=slab.mesh.with_vertices(slab.mesh.vertices * [0.2, 1, 1] - [0.12, 0, 0]))
    lenient = settle([table, slab], settling=SettleConfig(rest=RestConfig(as_measured=False)))
    strict = settle([table, slab])
    assert lenient.at_rest and lenient.T_world_object[1][2, 3] > 0.1
    assert not (strict.at_rest and strict.T_world_object[1][2, 3] > 0.1)


def test_settling_carries_a_turned_frame_along() -> None:
    """The pose that comes back is that of the object frame, whatever its axes are."""
    R = rotation_about([1, 2, 3], 1.0)
    o = box(0, at=(0, 0, 0.051))
    turned = replace(
        o,
        T_world_object=o.T_world_object @ np.block([[R, np.zeros((3, 1))], [np.array([[0, 0, 0, 1]])]]),
        mesh=o.mesh.with_vertices(o.mesh.vertices @ R),
        parts=tuple(ConvexPart.hull_of(p.vertices @ R) for p in o.parts),
    )
    (a,), (b,) = settled((o,)), settled((turned,))
    assert np.allclose(a.vertices_world, b.vertices_world, atol=1e-6)


@pytest.mark.usefixtures("wild")
def test_no_log_file_is_left(tmp_path: object, monkeypatch: pytest.MonkeyPatch) -> None:
    from pathlib import Path

    monkeypatch.chdir(str(tmp_path))
    settle([box(0)])
    assert not list(Path.cwd().iterdir())


def test_solid_volume_counts_split_vertices_as_open() -> None:
    parts = (ConvexPart.hull_of(box_mesh().vertices),)
    half = (ConvexPart.hull_of(box_mesh().vertices * [1, 1, 0.5]),)
    for textured in (False, True):
        o = replace(box(0), mesh=box_mesh(textured=textured), scale=3.0)
        assert filling(replace(o, parts=(*parts, *parts))) == pytest.approx(0.5)
        assert filling(replace(o, parts=half)) == pytest.approx(1)


def test_release_agrees_with_an_independent_writing_of_the_protocol() -> None:
    """Differential: the protocol as a reader of design.md would write it down, on a stack that falls over."""
    stack = box_stack_scene(3).objects
    turned = rotation_about([0, 1, 0], 0.2)
    T = stack[2].T_world_object.copy()
    T[:3, :3], T[2, 3] = turned, T[2, 3] + 0.02
    objects = (*stack[:2], replace(stack[2], T_world_object=T))
    K_max, D_max = release(objects, seconds=2)
    expected_K, expected_D = reference_release(objects, seconds=2)
    assert K_max == pytest.approx(expected_K, rel=1e-3) and D_max == pytest.approx(expected_D, abs=1e-5)


def reference_release(objects: tuple[SceneObject, ...], seconds: float) -> tuple[float, float]:
    import mujoco
    import trimesh

    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.cone, spec.option.impratio = 0.002, mujoco.mjtCone.mjCONE_ELLIPTIC, 10
    contact = {
        "friction": [0.6, 0.005, 0.001],
        "condim": 6,
        "solref": [0.005, 1],
        "solimp": [0.95, 0.99, 0.0005, 0.5, 2],
        "margin": 2e-4,
    }
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[20, 20, 0.1], **contact)
    for i, o in enumerate(objects):
        body = spec.worldbody.add_body(name=f"o{i}")
        body.add_freejoint()
        mesh = trimesh.Trimesh(o.vertices_world, o.mesh.faces, process=False)
        hulls = [trimesh.Trimesh(p.vertices, p.faces, process=False).convex_hull for p in o.colliders_world]
        own = abs(mesh.volume) if mesh.is_watertight else np.inf
        total = sum(h.volume for h in hulls)
        density = 600 * min(own, mesh.convex_hull.volume, total) / total
        for k, h in enumerate(hulls):
            vertices, faces = np.asarray(h.vertices, np.float32), np.asarray(h.faces, np.int32)
            spec.add_mesh(name=f"m{i}_{k}", uservert=vertices.ravel(), userface=faces.ravel())
            kind = mujoco.mjtGeom.mjGEOM_MESH
            body.add_geom(type=kind, meshname=f"m{i}_{k}", density=density, **contact)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start, K, D = data.xipos[1:].copy(), 0.0, 0.0
    for step in range(int(seconds / 0.002)):
        mujoco.mj_step(model, data)
        if step < 500:
            mujoco.mj_energyVel(model, data)
            K = max(K, float(data.energy[1]))
        if step % 10 == 9:
            D = max(D, float(np.linalg.norm(data.xipos[1:] - start, axis=1).max()))
    return K, D


@pytest.fixture
def checks(monkeypatch: pytest.MonkeyPatch) -> list[tuple[list[SceneObject], NearPairs, settling.MjData]]:
    """Objects, model and state of every check in the model of the release protocol; states go on to their ends."""
    seen = list[tuple[list[SceneObject], NearPairs, settling.MjData]]()

    def recorded(objects: list[SceneObject]) -> NearPairs:
        near = release_pairs(objects)
        seen.append((objects, near, mujoco_model.engine().MjData(near.model)))
        monkeypatch.setattr(near, "step", partial(_step_both, near, seen[-1][2]))
        return near

    monkeypatch.setattr("f3sr.physics.settling.release_pairs", recorded)
    return seen


def _step_both(near: NearPairs, copy: settling.MjData, data: settling.MjData) -> None:
    NearPairs.step(near, data)
    copy.qpos[:] = data.qpos


def test_what_settles_is_checked_in_the_very_model_that_measures_it(
    checks: list[tuple[list[SceneObject], NearPairs, settling.MjData]],
) -> None:
    """Another model of the same scene finds other contacts: a plate that leaned on a toy rested in it, and slid by
    12 mm when it was measured."""
    low = replace(box(7, size=(0.4, 0.4, 0.1), at=(0, 0, 0.0502)), mask_name="b")
    turned = replace(box(3, R=rotation_about([1, 2, 3], 0.7), at=(0, 0, 0.25)), mask_name="a")
    result = settle([low, turned])
    assert result.at_rest
    measured = release_pairs([replace(o, T_world_object=result.T_world_object[o.id]) for o in (low, turned)]).model
    for name in ("mesh_vert", "geom_pos", "geom_quat", "body_mass", "body_ipos", "body_inertia", "geom_margin"):
        assert np.array_equal(getattr(checks[-1][1].model, name), getattr(measured, name)), name


def test_a_round_begins_where_the_check_before_it_ended(
    checks: list[tuple[list[SceneObject], NearPairs, settling.MjData]],
) -> None:
    """Positions come back from the model of the release, whose bodies have another order and other frames."""
    table = replace(box(5, size=(0.4, 0.4, 0.1)), mobility="fixed", mask_name="b")
    slab = box(1, size=(0.3, 0.1, 0.02), at=(0.23, 0, 0.1105), R=rotation_about([0, 0, 1], 0.2))
    slab = replace(slab, mesh=slab.mesh.with_vertices(slab.mesh.vertices * [0.2, 1, 1] - [0.12, 0, 0]), mask_name="c")
    beside = replace(box(9, at=(1, 0.5, 0.0502), R=rotation_about([0, 0, 1], 0.5)), mask_name="a")
    result = settle([table, slab, beside], settling=SettleConfig(rounds=1))
    assert result.moving == {1}
    (objects, near, end), travel = checks[0], 0.0
    for o in objects:
        T = released_pose(near.model, end, o)
        assert np.allclose(result.T_world_object[o.id], T, rtol=0, atol=1e-12)
        travel = max(travel, float(np.linalg.norm(T[:3, 3] - o.T_world_object[:3, 3])))
    assert len(checks) == 1 and travel > RestConfig.drift
