"""Footings: what stands as the photo shows it on an underside that is turned, and what is left to fall or roll."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import HalfspaceIntersection

from f3sr.contact.compounds import placed, smallest_shift
from f3sr.contact.footing import flush, footing, footing_again, support_plane
from f3sr.contact.polytopes import Polytope
from f3sr.contact.stability import stability
from f3sr.contact.stable_facets import stable_normals
from f3sr.contact.static_bodies import bodies_of, center_of
from f3sr.contact.tops import highest_points
from f3sr.contact.undersides import (
    GRAIN,
    GROUND_PLANE,
    FlatUnderside,
    FootingConfig,
    Outline,
    StandingBody,
    SupportPlane,
)
from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.core.transforms import UP, pose, rotation_about, rotation_angle
from f3sr.metrics.point_in_mesh import union_distance
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.physics.settling import settle
from f3sr.scene import GROUND, SceneObject, Support
from f3sr.stages.balance import balance
from f3sr.stages.separate import SeparateConfig, on_footings_in_place, on_own_footings, separate
from scenes import ball_mesh, box, scene_of

CONFIG = FootingConfig()


def slanted(angle: float, *, height: float = 0.15) -> SceneObject:
    """A box of .1 x .1 m that stands upright on an underside turned by ``angle`` about y, its lowest edge on z = 0."""
    rise = 0.05 * np.tan(angle)
    corners = [[x, y, -height / 2 + rise * (1 + x / 0.05) if z < 0 else height / 2]
               for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-1, 1)]  # fmt: skip
    return shaped(np.array(corners), at=(0, 0, height / 2))


def shaped(points: np.ndarray, *, at: tuple[float, float, float]) -> SceneObject:
    hull = ConvexPart.hull_of(points)
    mesh = Mesh(vertices=hull.vertices, faces=hull.faces)
    return replace(box(0), mesh=mesh, parts=(hull,), T_world_object=pose(t=at))


def turned_by_physics(o: SceneObject) -> float:
    after = settle([o]).T_world_object[o.id]
    return np.degrees(rotation_angle(after[:3, :3] @ o.T_world_object[:3, :3].T))


def test_what_stands_on_a_slanted_underside_keeps_its_pose_with_a_footing_and_tips_without():
    o = slanted(np.radians(5))
    wedges = footing(o, GROUND_PLANE, CONFIG)
    assert len(wedges) == 1
    assert turned_by_physics(o) == pytest.approx(5, abs=0.5)
    assert turned_by_physics(replace(o, footing=wedges)) < 0.2


def test_a_footing_reaches_the_plane_and_not_below():
    for plane in (GROUND_PLANE, SupportPlane(normal=rotation_about([0, 1, 0], -0.03)[:, 2], offset=-0.03)):
        o = slanted(np.radians(5))
        (wedge,) = footing(o, plane, CONFIG)
        heights = plane.heights(wedge.moved(o.T_world_asset).vertices)
        lowest = plane.heights(o.vertices_world).min()
        assert heights.min() == pytest.approx(lowest, abs=1e-9)
        assert np.sum(heights < lowest + 1e-9) >= 4, "it stands on a face, not on an edge"


@pytest.mark.parametrize(
    "o",
    [
        pytest.param(box(0), id="flat already"),
        pytest.param(slanted(np.radians(14)), id="turned too far"),
        pytest.param(slanted(np.radians(9), height=3.0), id="would fall upright"),
        pytest.param(shaped(0.05 * np.random.default_rng(0).normal(size=(400, 3)), at=(0, 0, 0.2)), id="a cloud"),
    ],
)
def test_none_where_none_helps(o: SceneObject):
    assert footing(o, GROUND_PLANE, CONFIG) == ()


def test_what_has_no_stable_underside_stands_on_a_footing_as_it_does_in_the_photo():
    """A tall thing whose weight is not above its turned underside: it would fall flat."""
    o = slanted(np.radians(9), height=1.0)
    assert turned_by_physics(o) > 45
    assert turned_by_physics(replace(o, footing=footing(o, GROUND_PLANE, CONFIG))) < 0.2


def test_parts_are_cut_flush_with_the_lowest_point_of_the_mesh_and_cover_as_before():
    o = slanted(np.radians(5))
    below = np.array([[0.0, 0, -0.08], [0.02, 0, -0.04], [-0.02, 0.02, -0.04], [0, -0.02, -0.04]])
    o = replace(o, parts=(*o.parts, ConvexPart.hull_of(below)))
    parts = flush(o, GROUND_PLANE)
    lowest = o.vertices_world[:, 2].min()
    world = [p.moved(o.T_world_asset) for p in parts]
    assert min(p.vertices[:, 2].min() for p in world) == pytest.approx(lowest, abs=1e-12)
    assert parts[0] is o.parts[0]
    assert 0 < parts[1].volume < o.parts[1].volume
    assert union_distance(o.mesh.vertices, parts).max() < 1e-9


def ball(seed: int, *, radius: float = 0.05, height: float = 0.05) -> SceneObject:
    """A ball turned at random whose proxy has few facets, a corner of which may be below."""
    directions = np.random.default_rng(seed).normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    facets = HalfspaceIntersection(np.column_stack([directions, np.full(40, -radius)]), np.zeros(3))
    around = ConvexPart.hull_of(facets.intersections)
    return replace(box(0), mesh=ball_mesh(radius), parts=(around,), T_world_object=pose(t=[0, 0, height]))


@pytest.mark.parametrize("seed", range(4))
def test_a_ball_rests_by_its_shape_and_rolls_once_it_is_tilted(seed: int):
    o = ball(seed)
    wedges = footing(o, GROUND_PLANE, CONFIG)
    stood = replace(o, parts=flush(o, GROUND_PLANE), footing=wedges, T_world_object=pose(t=[0, 0, 0.05 + 2.6e-4]))
    assert turned_by_physics(stood) < 0.1
    # The centre of the evenly filled proxy, which statics tries too, is off that of the ball.
    assert 0.8 * CONFIG.round_margin < stability(bodies_of([stood])).margin < 0.35
    assert sum(w.volume for w in wedges) < 1e-3 * o.mesh.hull.volume


def test_without_it_the_ball_rolls_onto_a_facet_of_its_proxy():
    turns = [turned_by_physics(on_its_proxy(ball(seed))) for seed in range(4)]
    assert max(turns) > 2


def on_its_proxy(o: SceneObject) -> SceneObject:
    low = min(p.vertices[:, 2].min() for p in o.colliders_world)
    return replace(o, T_world_object=pose(t=[0, 0, 2.6e-4 - low]) @ o.T_world_object)


@pytest.mark.parametrize("slope", [0.0, 0.03, 0.06])
def test_a_ball_stands_on_a_floor_whose_slope_is_as_uncertain_as_any(slope: float):
    """Its footing reaches as far as it must for the weight to be over it."""
    plane = SupportPlane(normal=rotation_about([0, 1, 0], slope)[:, 2], offset=0.0)
    (wedge,) = footing(ball(0), plane, CONFIG)
    # It lies around the contact, which is .05 slope beside the centre of mass.
    reach = np.hypot(*(wedge.vertices[:, :2] - 0.05 * np.array([-slope, 0])).T).max()
    least = 0.05 * (np.tan(CONFIG.round_margin) + slope)
    assert least <= reach <= 1.35 * max(least, 0.05 * np.sqrt(2 * GRAIN * np.sqrt(12)))


def test_no_ball_stands_on_a_steep_slope():
    steep = SupportPlane(normal=rotation_about([0, 1, 0], 0.3)[:, 2], offset=0.0)
    assert footing(ball(0), steep, CONFIG) == ()


def test_every_leg_gets_its_own_piece():
    """A stool whose legs differ in length by 2 %: nothing is filled in between them."""
    seat = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.18, 0.2)])
    parts = [ConvexPart.hull_of(seat)]
    for k, (x, y) in enumerate([(-0.08, -0.08), (-0.08, 0.08), (0.08, -0.08), (0.08, 0.08)]):
        leg = [[x + dx, y + dy, z] for dx in (-0.02, 0.02) for dy in (-0.02, 0.02) for z in (0.002 * (k == 3), 0.19)]
        parts.append(ConvexPart.hull_of(np.array(leg)))
    starts = np.cumsum([0, *(len(p.vertices) for p in parts)])
    mesh = Mesh(
        vertices=np.concatenate([p.vertices for p in parts]),
        faces=np.concatenate([p.faces + s for p, s in zip(parts, starts, strict=False)]),
    )
    stool = replace(box(0), mesh=mesh, parts=tuple(parts), T_world_object=pose())
    wedges = footing(stool, GROUND_PLANE, CONFIG)
    assert len(wedges) == 4
    assert all(np.ptp(w.vertices[:, :2], axis=0).max() < 0.06 for w in wedges)
    assert turned_by_physics(replace(stool, footing=wedges)) < 0.1


def test_the_plane_below_is_the_top_of_what_carries():
    tilt = rotation_about([0, 1, 0], 0.06)
    slab = box(1, size=(0.3, 0.3, 0.05), R=tilt, at=(0, 0, 0))
    plane = support_plane(box(0, at=(0, 0, 0.1)), slab.colliders_world, CONFIG)
    assert plane is not None
    assert plane.normal == pytest.approx(tilt[:, 2], abs=1e-5)
    assert plane.heights((tilt @ [[0.01], [0.02], [0.025]]).T)[0] == pytest.approx(0, abs=1e-5)


def test_a_ridge_thinner_than_any_cell_carries():
    """What stands on a slab with two sharp ridges stands on the ridges, where samples would see the slab."""
    slab = box(1, size=(0.3, 0.3, 0.05)).colliders_world
    ridges = [box(2, size=(1e-4, 0.3, 0.004 * k), at=(0.04 * (-1) ** k, 0, 0.075)).colliders_world[0] for k in (1, 2)]
    plane = support_plane(box(0, at=(0, 0, 0.2)), [*slab, *ridges], CONFIG)
    assert plane is not None
    assert plane.heights(np.array([[-0.04, 0, 0.077], [0.04, 0, 0.079]])) == pytest.approx([0, 0], abs=1e-5)


@given(seed=st.integers(0, 10_000))
def test_the_highest_points_span_the_upper_hull_over_a_region(seed: int):
    """Against heights of the parts at many points of the region: none is above the hull, which is exact at its ends."""
    rng = np.random.default_rng(seed)
    parts = [ConvexPart.hull_of(rng.normal(size=(12, 3)) * 0.3 + rng.normal(size=3) * 0.5) for _ in range(3)]
    region = Outline.of(rng.normal(size=(7, 3)) * 0.4)
    assert region is not None
    found = highest_points(parts, region)
    assert (found[:, :2] @ region.normals.T <= region.offsets + 1e-9).all()
    shares = rng.dirichlet(np.ones(len(region.corners)), size=200)
    sampled = [p for q in shares @ region.corners if (p := highest(parts, q)) is not None]
    assert bool(len(found)) >= bool(sampled)
    assert all(union_distance(found, parts) < 1e-9)
    for direction in rng.normal(size=(20, 3)) * [1, 1, 0] + [0, 0, 1]:
        assert (
            max((float(p @ direction) for p in sampled), default=-np.inf)
            <= (found @ direction).max(initial=-1e9) + 1e-9
        )


def highest(parts: list[ConvexPart], xy: np.ndarray) -> np.ndarray | None:
    """The highest point of the parts over (2,): a linear programme a part."""
    heights: list[float] = []
    for p in parts:
        facets = Polytope.of(p)
        up, down = facets.normals[:, 2] > 1e-9, facets.normals[:, 2] < -1e-9
        room = facets.offsets - facets.normals[:, :2] @ xy
        top, bottom = (room[up] / facets.normals[up, 2]).min(), (room[down] / facets.normals[down, 2]).max()
        if top >= bottom:
            heights.append(float(top))
    return np.array([*xy, max(heights)]) if heights else None


def test_an_object_stands_with_what_it_carries_and_not_with_what_others_carry_too():
    """A load over the edge takes a footing away; one that lies on the ground as well does not."""
    low = slanted(np.radians(4))
    load = box(1, size=(0.3, 0.04, 0.1), at=(0.18, 0, 0.2))
    alone = replace(load, supported_by=0, supports=(Support(id=0),))
    shared = replace(alone, supports=(Support(id=0), Support(id=GROUND)))
    footed = [
        [d.about for d in separate(scene_of(low, top), SeparateConfig(max_ray_scale=0.0))[1].decisions
         if d.choice == "given a footing"]
        for top in (alone, shared)
    ]  # fmt: skip
    assert 0 not in footed[0]
    assert 0 in footed[1]


@pytest.mark.parametrize("kind", ["flat", "round"])
def test_a_footing_is_made_anew_for_what_carries_it_now(kind: str):
    """The carrier's top is turned. The new footing lies on it, and the object need not rise from where it touches."""
    turned = rotation_about([0, 1, 0], 0.03)
    slab = box(1, size=(0.4, 0.4, 0.05), R=turned, at=(0, 0, 0))
    o = slanted(np.radians(5)) if kind == "flat" else ball(1)
    o = replace(o, parts=flush(o, GROUND_PLANE), footing=footing(o, GROUND_PLANE, CONFIG), supported_by=1)
    o = replace(o, supports=(Support(id=1),))
    plane = SupportPlane(normal=turned[:, 2], offset=0.025)
    low = float(plane.heights(o.vertices_world).min()) / turned[2, 2]
    o = replace(o, T_world_object=pose(t=[0, 0, 3e-4 - low]) @ o.T_world_object)
    o, around = replace(o, parts=flush(o, plane)), bodies_of([slab])[0].parts
    wedges, rise = footing_again(o, [slab], around, CONFIG, clearance=2.6e-4, center=center_of([o]))
    assert rise < 1e-4
    (heights,) = (plane.heights(w.moved(o.T_world_asset).vertices) for w in wedges)
    assert np.sum(heights < 3.1e-4) >= 4, "it lies on the top with a face"
    assert heights.min() > 2.5e-4


def dome(height: float) -> SceneObject:
    """A slab of .3 x .3 m with a top that falls by ``height`` at .06 m from the middle."""
    x, y = np.meshgrid(*2 * [np.linspace(-0.15, 0.15, 21)])
    top = np.column_stack([x.ravel(), y.ravel(), (-height * (x**2 + y**2) / 0.06**2).ravel()])
    return replace(shaped(np.concatenate([top, top * [1, 1, 0] - [0, 0, 0.1]]), at=(0, 0, 0.1)), id=1)


def upon(slab: SceneObject, o: SceneObject) -> tuple[SceneObject, SupportPlane]:
    """The object, its middle at x = y = 0, with a footing on a slab; and the plane that it was made for."""
    plane = support_plane(o, slab.colliders_world, CONFIG)
    assert plane is not None
    o = replace(o, supported_by=slab.id, supports=(Support(id=slab.id),))
    return replace(o, parts=flush(o, plane), footing=footing(o, plane, CONFIG)), plane


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.1])
def test_on_a_dome_it_stands_on_pads_whose_weight_may_be_anywhere(turn: float):
    """One plane would meet the dome in a facet, over whose edges the object rocks."""
    slab, R = dome(0.002), pose(rotation_about([0, 0, 1], turn))
    o, plane = upon(slab, replace(slanted(np.radians(4)), T_world_object=pose(t=[0, 0, 0.1755]) @ R))
    assert len(o.footing) == 4
    lowest = float(plane.heights(o.vertices_world).min())
    around = bodies_of([slab])[0].parts
    for pad in o.footing:
        gap = 0.02 - smallest_shift(placed([pad], pose(t=[0, 0, -0.02]) @ o.T_world_asset), around, UP, 0.0)
        assert gap == pytest.approx(lowest, abs=2e-5), "it meets the dome as the object does"
    stood = replace(o, T_world_object=pose(t=[0, 0, DEFAULT_MARGIN.clearance - lowest]) @ o.T_world_object)
    single = replace(stood, footing=footing(o, replace(plane, tops=()), CONFIG))
    margins = [stability(bodies_of([replace(slab, mobility="fixed"), one])).margin for one in (stood, single)]
    assert margins[0] > 0.45 and margins[1] < 0.25


def test_what_is_flat_stands_on_pads_on_a_dome_as_well():
    slab = dome(0.002)
    o, plane = upon(slab, box(0, at=(0, 0, 0.2)))
    assert len(o.footing) == 4
    lowest = float(plane.heights(o.vertices_world).min())
    stood = replace(o, T_world_object=pose(t=[0, 0, 0.2 + DEFAULT_MARGIN.clearance - lowest]))
    fixed = replace(slab, mobility="fixed")
    margins = [stability(bodies_of([fixed, one])).margin for one in (stood, replace(stood, footing=()))]
    assert margins[0] > 0.45 and margins[1] < 0.3
    assert footing(o, plane, CONFIG, below=-0.01) == (), "there is nothing to fill in under what ends higher"


def test_pads_do_not_fill_what_an_object_stands_over():
    """On the rim of a box without a lid there is one plane to stand on."""
    walls = [box(1, size=size, at=at).colliders_world[0]
             for size, at in [((0.1, 0.004, 0.08), (0, 0.048, 0.04)), ((0.1, 0.004, 0.08), (0, -0.048, 0.04)),
                              ((0.004, 0.1, 0.08), (0.048, 0, 0.04)), ((0.004, 0.1, 0.08), (-0.048, 0, 0.04)),
                              ((0.1, 0.1, 0.004), (0, 0, 0.002))]]  # fmt: skip
    o = replace(slanted(np.radians(4)), T_world_object=pose(t=[0, 0, 0.155]))
    plane = support_plane(o, walls, CONFIG)
    assert plane is not None
    (wedge,) = footing(o, plane, CONFIG)
    assert wedge.moved(o.T_world_asset).vertices[:, 2].min() > 0.08 - 1e-6


def test_a_plate_thinner_than_any_section_is_no_reason_to_fail():
    """Its load is beside it, so that it does not stand on its flat side, and it has no section to stand on."""
    plate = box(0, size=(0.3, 0.3, 5e-4), at=(0, 0, 0.2))
    assert support_plane(plate, box(1).colliders_world, CONFIG, center=np.array([0.4, 0, 0.3])) is None


def test_a_footing_stays_where_a_new_one_would_raise_the_object():
    """A slab that reaches into it, and one that stands over half of its underside."""
    o = replace(slanted(np.radians(5)), supported_by=1, supports=(Support(id=1),))
    o = replace(o, footing=footing(o, GROUND_PLANE, CONFIG))
    for size, x in ((0.4, 0.0), (0.1, 0.06)):
        slab = box(1, size=(size, 0.4, 0.05), at=(x, 0, 0.0))
        kept = footing_again(o, [slab], bodies_of([slab])[0].parts, CONFIG, clearance=2.6e-4, center=center_of([o]))
        assert kept == (o.footing, 0.0)


def test_a_stack_of_slanted_boxes_stands_as_it_is_seen():
    low = replace(slanted(np.radians(4)), id=0)
    top = replace(slanted(np.radians(-6)), id=1, supported_by=0, supports=(), T_world_object=pose(t=[0, 0, 0.24]))
    scene, outcome = separate(scene_of(low, top), SeparateConfig(max_ray_scale=0.0))
    assert outcome.report.value("overlapping pairs") == 0
    assert [d.about for d in outcome.decisions if d.choice == "given a footing"] == [0, 1]
    after = settle(scene.objects)
    assert after.at_rest
    for o in scene:
        turn = rotation_angle(after.T_world_object[o.id][:3, :3] @ o.T_world_object[:3, :3].T)
        assert np.degrees(turn) < 0.3
    again, _ = separate(scene, SeparateConfig(max_ray_scale=0.0))
    assert [len(o.footing) for o in again] == [1, 1], "footings are made anew, not added up"


@pytest.mark.parametrize("gap", [0.0, 0.0015])
def test_what_stands_on_a_footing_in_place_has_not_moved_and_does_not_move(gap: float):
    """A gap to the ground is filled. Without a footing physics would turn it by its underside's angle."""
    o = slanted(np.radians(4))
    o = replace(o, T_world_object=pose(t=[0, 0, DEFAULT_MARGIN.clearance + gap]) @ o.T_world_object)
    (stood,) = on_footings_in_place(scene_of(o), SeparateConfig())
    assert stood.footing and np.array_equal(stood.T_world_object, o.T_world_object)
    assert turned_by_physics(o) > 3 and turned_by_physics(stood) < 0.2
    after = settle([stood]).T_world_object[0]
    assert after[2, 3] == pytest.approx(o.T_world_object[2, 3], abs=2e-4)


def test_what_hangs_has_no_footing_in_place():
    ball_over = replace(ball(0), T_world_object=pose(t=[0, 0, 0.09]))
    high = replace(slanted(np.radians(4)), id=1, T_world_object=pose(t=[0.5, 0, 0.2]))
    assert not any(o.footing for o in on_footings_in_place(scene_of(ball_over, high), SeparateConfig()))


@pytest.mark.parametrize("gap", [0.02, 0.0, -0.004])
def test_an_own_footing_reaches_as_low_as_its_object_wherever_it_is(gap: float):
    """It closes no gap: the object is to come down with it."""
    o = slanted(np.radians(4))
    o = replace(o, T_world_object=pose(t=[0, 0, gap]) @ o.T_world_object)
    scene = scene_of(o, replace(o, id=1, T_world_object=pose(t=[0.5, 0, 0]) @ o.T_world_object))
    stood = on_own_footings(scene, [0], overlapping=True, config=SeparateConfig())
    lowest = min(p.moved(stood[0].T_world_asset).vertices[:, 2].min() for p in stood[0].footing)
    assert lowest == pytest.approx(gap, abs=1e-6)
    pairs = zip(scene, stood, strict=True)
    assert not stood[1].footing and all(np.array_equal(a.T_world_object, b.T_world_object) for a, b in pairs)


def test_an_own_footing_ends_over_what_carries_its_object():
    """Sunk 2 mm into a slab, an object has a footing inside it, or one that ends over it."""
    o = replace(slanted(np.radians(4)), supported_by=1, supports=(Support(id=1),))
    o = replace(o, T_world_object=pose(t=[0, 0, -0.002]) @ o.T_world_object)
    slab = replace(box(1, size=(0.4, 0.4, 0.1), at=(0, 0, -0.05)), mobility="fixed", supported_by=None, supports=())
    (below,) = bodies_of([slab])

    def inside(overlapping: bool) -> float:
        stood = on_own_footings(scene_of(o, slab), [0], overlapping=overlapping, config=SeparateConfig())[0]
        assert stood.footing
        return smallest_shift(placed(stood.footing, stood.T_world_asset), below.parts, UP)

    assert inside(overlapping=True) == pytest.approx(0.002, abs=1e-5) and inside(overlapping=False) < 1e-4


def test_a_stack_on_slanted_undersides_is_balanced_as_the_photo_shows_it_and_rests():
    low, up = slanted(np.radians(3)), replace(slanted(np.radians(4), height=0.08), id=1)
    up = replace(
        up, T_world_object=pose(t=[0, 0, 0.152]) @ up.T_world_object, supported_by=0, supports=(Support(id=0),)
    )
    scene = scene_of(low, up)
    even = 1e5 * np.eye(7)
    footed = partial(on_own_footings, config=SeparateConfig())
    placed = balance(scene, {0: even, 1: even}, DEFAULT_MARGIN, footed=footed)
    after = settle(list(placed))
    for was, now in zip(scene, placed, strict=True):
        assert now.footing and rotation_angle(now.T_world_object[:3, :3] @ was.T_world_object[:3, :3].T) < 5e-3
        end = after.T_world_object[was.id]
        assert rotation_angle(end[:3, :3] @ now.T_world_object[:3, :3].T) < np.radians(0.2)
        assert np.linalg.norm(end[:3, 3] - now.T_world_object[:3, 3]) < 1e-3
    assert after.at_rest


def test_without_footings_an_object_is_laid_down_in_its_place():
    o = slanted(np.radians(5))
    config = SeparateConfig(max_ray_scale=0.0, footing=FootingConfig(enabled=False))
    scene, outcome = separate(scene_of(o), config)
    assert [d.choice for d in outcome.decisions] == ["laid down by 5.0 degrees"]
    assert turned_by_physics(scene[0]) < 0.1
    assert np.linalg.norm(scene[0].bounds_world.mean(0)[:2] - o.bounds_world.mean(0)[:2]) < 0.01


def sheet(R: np.ndarray) -> SceneObject:
    """A flat square without thickness, turned by R: its proxy has a thickness, its mesh no hull."""
    corners = np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]]) @ R.T
    mesh = Mesh(vertices=corners, faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    thick = ConvexPart.hull_of(np.concatenate([corners + 1e-3 * R[:, 2], corners - 1e-3 * R[:, 2]]))
    return replace(box(0), mesh=mesh, parts=(thick,), T_world_object=pose(t=[0, 0, 0.15]))


@pytest.mark.parametrize("axis", [[0, 0, 1], [1, 0, 0], [1, 0.01, 0]])
def test_a_sheet_without_volume_is_no_reason_to_fail(axis: list[float]):
    o = sheet(rotation_about(axis, np.pi / 2))
    assert footing(o, GROUND_PLANE, CONFIG) == ()
    assert support_plane(o, box(1).colliders_world, CONFIG) is None
    scene, outcome = separate(scene_of(o, box(1, at=(1, 1, 0.05))))
    assert outcome.report.value("overlapping pairs") == 0
    assert np.isfinite(scene[0].T_world_object).all()


def test_what_is_held_keeps_its_footing():
    """refine holds what does not gain while others are separated again."""
    held, _ = separate(scene_of(slanted(np.radians(4))), SeparateConfig(max_ray_scale=0.0))
    assert held[0].footing
    other = replace(slanted(np.radians(4)), id=1, T_world_object=pose(t=[0.5, 0, 0.1]))
    scene = scene_of(replace(held[0], mobility="fixed"), other)
    again, _ = separate(scene, SeparateConfig(max_ray_scale=0.0))
    assert again[0].footing == held[0].footing and again[0].parts == held[0].parts


@pytest.mark.parametrize("angle", [0.0, 0.1])
def test_the_outline_of_an_underside_is_that_of_all_its_cells(angle: float):
    o = slanted(angle).moved(pose(rotation_about([0, 0, 1], 0.4)), stage="test", reason="")
    body = StandingBody.of(o)
    assert body
    flat = FlatUnderside.of(o, body, GROUND_PLANE, CONFIG)
    assert flat and flat.outline
    whole = Outline.of(flat.corners)
    assert whole and flat.outline.area == pytest.approx(whole.area, rel=1e-12)
    assert flat.outline.depth(body.center) == pytest.approx(whole.depth(body.center), rel=1e-9)


def test_what_decides_whether_a_body_stands_is_found_once_for_each_place_and_centre():
    o = slanted(0.1)
    body = StandingBody.of(o)
    assert body and body is StandingBody.of(o) and body is StandingBody.of(o, body.center)
    flat = FlatUnderside.of(o, body, GROUND_PLANE, CONFIG)
    assert flat and flat is FlatUnderside.of(o, body, GROUND_PLANE, CONFIG)
    other = StandingBody.of(o, body.center + np.array([0, 0, 0.01]))
    assert other and other is not body and FlatUnderside.of(o, other, GROUND_PLANE, CONFIG) is not flat
    assert StandingBody.of(o.moved(pose(t=[0, 0, 0.01]), stage="test", reason="")) is not body


@pytest.mark.parametrize("towards", [0.0, 0.05, 0.1])
def test_the_facet_below_is_the_stable_one_that_faces_the_plane_most(towards: float):
    """The box stands on a face that is turned by .1 rad."""
    o = slanted(0.1)
    plane = SupportPlane(normal=rotation_about([0, 1, 0], towards) @ np.array([0, 0, 1.0]), offset=0.0)
    body = StandingBody.of(o)
    assert body
    flat = FlatUnderside.of(o, body, plane, CONFIG)
    every = -stable_normals(body.hull, body.center)
    some = every[every @ plane.normal >= np.cos(CONFIG.max_turn)]
    assert flat and 0 < len(some) < len(every)
    np.testing.assert_array_equal(flat.facet.normal, some[np.argmax(some @ plane.normal)])
