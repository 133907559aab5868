"""close: what floats on its colliders comes down until meshes meet; what touches, rolls away or falls is left alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import HalfspaceIntersection

from f3sr.contact.footing import flush, footing, plane_below
from f3sr.contact.polytopes import Polytope
from f3sr.contact.vertical_gap import meeting
from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.core.transforms import Array, pose, rotation_angle
from f3sr.metrics.contact_groups import IOU_OF_GAP, SettledScene
from f3sr.metrics.measures import visible_ious
from f3sr.scene import GROUND, Scene, SceneObject, Support
from f3sr.stages.close import CloseConfig, close, lowered
from f3sr.stages.settle import settle
from f3sr.vision import rasterizer
from scenes import ball_mesh, box, dish_mesh, scene_of

CONFIG = CloseConfig()
GAP = CONFIG.contact.clearance
RADIUS, DISH, WALL = 0.05, 0.5, 0.005
TURN = 0.3
"""By how much the ball's polytope is turned [rad]: a corner is below."""


def around_ball() -> ConvexPart:
    """A polytope of 14 facets that touch the ball."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3)
    normals = np.concatenate([np.eye(3), -np.eye(3), signs])
    c, s = np.cos(TURN), np.sin(TURN)
    normals = normals @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
    halfspaces = np.column_stack([normals, np.full(len(normals), -RADIUS)])
    return ConvexPart.hull_of(HalfspaceIntersection(halfspaces, np.zeros(3)).intersections)


def made(id: int, mesh: Mesh, parts: tuple[ConvexPart, ...], at: Array, on: int = GROUND) -> SceneObject:
    o = replace(box(id), mesh=mesh, parts=parts, T_world_object=pose(t=at))
    return replace(o, supports=(Support(id=on),), supported_by=on)


def on_colliders(o: SceneObject, height: float) -> SceneObject:
    """The object raised until its colliders stand over a height."""
    low = min(float(p.vertices[:, 2].min()) for p in o.colliders_world)
    return replace(o, T_world_object=pose(t=[0, 0, height + GAP - low]) @ o.T_world_object)


def ball_on_the_ground() -> SceneObject:
    return on_colliders(made(0, ball_mesh(RADIUS), (around_ball(),), np.zeros(3)), 0.0)


def ball_in_a_dish() -> Scene:
    """The dish is bridged by one hull; the ball lies on that."""
    mesh = dish_mesh(DISH, wall=WALL)
    dish = on_colliders(made(0, mesh, (ConvexPart.hull_of(mesh.vertices),), np.zeros(3)), 0.0)
    top = float(dish.bounds_world[1, 2])
    ball = on_colliders(made(1, ball_mesh(RADIUS), (around_ball(),), np.array([0.004, 0.003, 0]), on=0), top)
    return scene_of(dish, ball)


def gap(scene: Scene, id: int) -> float:
    return meeting(scene[id], [o for o in scene if o.id != id]).gap


def settled(scene: Scene) -> SettledScene:
    """Physics that leaves everything where it is."""
    return SettledScene(scene=scene, restless=frozenset())


def outside(o: SceneObject) -> float:
    facets = [Polytope.of(p) for p in o.parts]
    return float(np.min([(o.mesh.vertices @ p.normals.T - p.offsets).max(1) for p in facets], axis=0).max())


def test_a_ball_comes_down_to_the_ground():
    scene = scene_of(ball_on_the_ground())
    assert gap(scene, 0) > 0.002
    after = lowered(scene, CONFIG)
    allowed = GAP + 2 * CONFIG.cut.tolerance * scene[0].size
    assert GAP - 1e-7 < gap(after, 0) <= allowed + 1e-7
    assert outside(after[0]) < 1e-8
    assert min(float(p.vertices[:, 2].min()) for p in after[0].colliders_world) == pytest.approx(GAP)


@pytest.fixture(scope="module")
def dish() -> Scene:
    return ball_in_a_dish()


@pytest.fixture(scope="module")
def lowered_dish(dish: Scene) -> Scene:
    return lowered(dish, CONFIG)


@pytest.fixture(scope="module")
def closed_dish(dish: Scene) -> Scene:
    return close(dish, CONFIG, settled=settled)[0]


def test_a_ball_comes_down_into_a_dish(dish: Scene, closed_dish: Scene):
    scene, after = dish, closed_dish
    assert gap(scene, 1) > 0.008
    size = min(o.size for o in scene)
    # Off the middle the vertical gap of two concentric-like balls is a little more than the shortest.
    middle = after[1].T_world_object[:3, 3] - after[0].T_world_object[:3, 3] - [0, 0, DISH]
    shortest = DISH - RADIUS - float(np.linalg.norm(middle))
    assert 0 < shortest <= GAP + 2 * CONFIG.cut.tolerance * size + 2e-4
    assert all(outside(o) < 1e-8 for o in after)
    assert len(after[0].parts) <= 24 and len(after[1].parts) == 1


@pytest.mark.parametrize("added", [0, 3])
def test_splits_add_no_more_parts_than_allowed(added: int, dish: Scene, lowered_dish: Scene):
    after = lowered(dish, replace(CONFIG, cut=replace(CONFIG.cut, added=added)))
    assert all(len(b.parts) <= len(a.parts) + added for a, b in zip(dish, after, strict=True))
    assert len(lowered_dish[0].parts) > len(dish[0].parts) + added, "more of them would help"


def test_it_rests_there(dish: Scene):
    def physics(scene: Scene) -> SettledScene:
        return SettledScene(scene=settle(scene)[0], restless=frozenset())

    after, outcome = close(dish, replace(CONFIG, loss=1.0), settled=physics)
    assert settle(after)[1].at_rest
    assert gap(after, 1) < 0.1 * gap(dish, 1)
    assert any("accepted" in d.choice for d in outcome.decisions)


def ball_on_a_sloping_block(slope: float) -> Scene:
    """The block's collider has a flat top, over its mesh's sloping one."""
    rise = 0.1 * np.tan(slope)
    corners = [[x, y, z and 0.05 + rise * x / 0.1] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0, 1)]
    mesh = ConvexPart.hull_of(np.array(corners))
    hull = ConvexPart.hull_of(
        np.concatenate([mesh.vertices, mesh.vertices[:, [0, 1]] @ np.eye(2, 3) + [0, 0, 0.05 + rise]])
    )
    block = made(0, Mesh(vertices=mesh.vertices, faces=mesh.faces), (hull,), np.array([0, 0, GAP]))
    ball = on_colliders(made(1, ball_mesh(RADIUS), (around_ball(),), np.zeros(3), on=0), 0.05 + rise + GAP)
    plane = plane_below(ball, [block], CONFIG.footing)
    assert plane is not None and plane.normal[2] == pytest.approx(1)
    ball = replace(ball, parts=flush(ball, plane), footing=footing(ball, plane, CONFIG.footing))
    return scene_of(block, on_colliders(ball, 0.05 + rise + GAP))


@pytest.mark.parametrize("slope", [0.03, 0.08])
def test_a_round_object_gets_its_footing_anew_on_what_was_cut_back(slope: float):
    scene = ball_on_a_sloping_block(slope)
    after = lowered(scene, CONFIG)
    assert gap(after, 1) < 0.3 * gap(scene, 1)
    end = settle(after)[0][1].T_world_object
    turn = rotation_angle(end[:3, :3] @ after[1].T_world_object[:3, :3].T)
    assert turn < 0.75 * slope, "on the shaved footing it rolls by the slope"


def test_what_touches_stays_the_same_value():
    scene = scene_of(box(0, at=(-0.3, 0, 0.05 + GAP)), replace(ball_on_the_ground(), id=1))
    after, outcome = close(scene, CONFIG, settled=settled)
    assert after[0] is scene[0] and after[1] is not scene[1]
    assert [m.about for m in outcome.measures if m.name == "convex parts"] == [1]
    again, outcome = close(after, CONFIG, settled=settled)
    assert again is after and not outcome.decisions


def test_what_carries_something_comes_down_with_it():
    ball = ball_on_the_ground()
    top = float(np.concatenate([p.vertices[:, 2] for p in ball.colliders_world]).max())
    lid = made(1, box(1).mesh, box(1).parts, np.array([0, 0, top + GAP + 0.05]), on=0)
    scene = scene_of(ball, lid)
    after = lowered(scene, CONFIG)
    drops = [scene[id].T_world_object[2, 3] - after[id].T_world_object[2, 3] for id in (0, 1)]
    assert drops[0] > 0.002 and drops[1] > drops[0] + 0.002, "and then onto what carries it"
    assert gap(after, 1) <= GAP + 2 * CONFIG.cut.tolerance * scene[0].size + 1e-7


def test_a_footing_that_holds_the_mesh_up_is_shaved():
    o = box(0)
    layer = ConvexPart.hull_of(
        np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, -0.053)])
    )
    scene = scene_of(on_colliders(replace(o, footing=(layer,)), 0.0))
    after = lowered(scene, CONFIG)
    assert gap(scene, 0) == pytest.approx(0.003 + GAP)
    assert gap(after, 0) == pytest.approx(GAP, abs=1e-6)
    assert after[0].parts is scene[0].parts and not after[0].footing


def seen(scene: Scene) -> Scene:
    ids = rasterizer.render(scene.objects, scene.camera).ids
    return scene.with_objects(*(replace(o, mask=ids == o.id) for o in scene))


@pytest.mark.parametrize(
    ("end", "why"),
    [
        (lambda s: SettledScene(scene=s, restless=frozenset([0])), "not at rest: object 0"),
        (lambda s: settled(s.with_objects(s[0].moved(pose(t=[0.03, 0, 0]), stage="settle", reason=""))), "visible IoU"),
    ],
)
def test_what_does_not_rest_or_rolls_away_is_left_as_it_was(end: Callable[[Scene], SettledScene], why: str):
    scene = seen(scene_of(ball_on_the_ground()))
    after, outcome = close(scene, CONFIG, settled=end)
    assert after is scene
    (decision,) = outcome.decisions
    assert decision.choice.endswith("rolled back") and why in decision.reason


@pytest.mark.parametrize("much", [0.02, 1.0])
def test_what_shows_as_it_comes_down_comes_down_along_its_viewing_ray(much: float, monkeypatch: pytest.MonkeyPatch):
    """At once where it shows much, else once it is rolled back."""
    monkeypatch.setattr("f3sr.stages.close.SHOWN", much)
    scene = seen(scene_of(ball_on_the_ground()))
    after, outcome = close(scene, CONFIG, settled=settled)
    *down, along = (float(d.reason.removeprefix("visible IoU of the group ")) for d in outcome.decisions)
    assert -0.08 < along < 0 and len(down) == (much == 1)
    assert all(loss < -0.15 for loss in down), "straight down it would be off its mask"
    assert outcome.gaps[0][0] > 0.008 and outcome.gaps[0][1] < 0.001
    way, ray = scene[0].way_to(after[0]), scene[0].middle - scene.camera.center
    assert way @ ray > 0.9 * np.linalg.norm(way) * np.linalg.norm(ray), "away from the camera"


def test_what_lies_between_others_comes_straight_down():
    ball, post = ball_on_the_ground(), box(1, at=(0.3, 0, 0.05 + GAP))
    wedged = replace(ball, supports=(Support(id=GROUND), Support(id=1)))
    ways = [o.way_to(lowered(scene_of(o, post), CONFIG, along_rays=[0])[0]) for o in (ball, wedged)]
    assert [bool(np.linalg.norm(way[:2]) > 0.005) for way in ways] == [True, False]
    assert all(way[2] < -0.002 for way in ways)


def test_only_groups_that_change_are_settled_and_each_is_kept_for_itself():
    ball = ball_on_the_ground()
    apart = [
        replace(ball, id=id, T_world_object=pose(t=[x, 0, 0]) @ ball.T_world_object) for id, x in ((1, -0.3), (2, 0.3))
    ]
    scene = seen(scene_of(box(0, at=(0, 0, 0.05 + GAP)), *apart))
    given: list[list[int]] = []

    def physics(scene: Scene) -> SettledScene:
        given.append([o.id for o in scene])
        return SettledScene(scene=scene, restless=frozenset([2]))

    after, _ = close(scene, replace(CONFIG, loss=1.0), settled=physics)
    assert given == [[1, 2]], "what spoils its group is left alone"
    assert [after[id] is scene[id] for id in (0, 1, 2)] == [True, False, True]


def test_rounds_that_lose_little_each_may_not_lose_much_together():
    """Each round moves the ball aside, and it leaves half of its gap. What is lost counts from the beginning."""
    ball = ball_on_the_ground()
    scene = seen(scene_of(ball))
    start = ball.T_world_object

    def physics(scene: Scene) -> SettledScene:
        (o,) = scene.objects
        up = 0.5 * (start[2, 3] - o.T_world_object[2, 3])
        o = replace(o, T_world_object=pose(t=[0.004, 0, up]) @ o.T_world_object)
        return SettledScene(scene=scene.with_objects(o), restless=frozenset())

    def lost(after: Scene) -> float:
        return visible_ious(scene)[0] - visible_ious(after)[0]

    free, outcome = close(scene, replace(CONFIG, loss=1.0), settled=physics)
    accepted = sum("accepted" in d.choice for d in outcome.decisions)
    assert accepted >= 2
    limit = 0.6 * lost(free)
    after, told = close(scene, replace(CONFIG, loss=limit), settled=physics)
    allowed = max(limit, IOU_OF_GAP * (gap(scene, 0) - gap(after, 0)) / ball.size)
    assert lost(after) <= allowed and sum("accepted" in d.choice for d in told.decisions) <= accepted


def test_fixed_and_unsupported_things_are_not_lowered():
    ball = ball_on_the_ground()
    scene = scene_of(replace(ball, mobility="fixed"), replace(ball, id=1, supported_by=None, supports=()))
    assert all(lowered(scene, CONFIG)[o.id] is o for o in scene)


def test_the_same_scene_gives_the_same_bytes(closed_dish: Scene):
    again, _ = close(ball_in_a_dish(), CONFIG, settled=settled)
    for a, b in zip(closed_dish, again, strict=True):
        assert a.T_world_object.tobytes() == b.T_world_object.tobytes()
        assert [p.vertices.tobytes() for p in a.parts] == [p.vertices.tobytes() for p in b.parts]


def test_the_unit_of_an_asset_does_not_matter(dish: Scene, lowered_dish: Scene):
    other = dish[1]
    large = tuple(p.moved(np.diag([1000.0, 1000, 1000, 1])) for p in other.parts)
    scaled = replace(other, mesh=other.mesh.with_vertices(1000 * other.mesh.vertices), parts=large, scale=0.001)
    again = lowered(dish.with_objects(scaled), CONFIG)
    assert again[1].T_world_object[2, 3] == pytest.approx(lowered_dish[1].T_world_object[2, 3], abs=1e-6)


def test_others_of_its_group_come_down_without_what_rolls_away():
    ball = ball_on_the_ground()
    beside = replace(ball, id=1, T_world_object=pose(t=[2.02 * RADIUS, 0, 0]) @ ball.T_world_object)
    scene = seen(scene_of(ball, beside))

    def physics(scene: Scene) -> SettledScene:
        """The first rolls whenever it is lowered."""
        o = next(o for o in scene if o.id == 0)
        if o.T_world_object[2, 3] < ball.T_world_object[2, 3] - 1e-6:
            scene = scene.with_objects(o.moved(pose(t=[-0.03, 0, 0]), stage="settle", reason="rolls"))
        return SettledScene(scene=scene, restless=frozenset())

    after, outcome = close(scene, replace(CONFIG, loss=0.3), settled=physics)
    assert gap(after, 0) == gap(scene, 0) and gap(after, 1) < 0.2 * gap(scene, 1)
    assert [d.choice.split(": ")[1] for d in outcome.decisions] == ["rolled back", "accepted"]


def test_what_does_not_rest_is_left_alone_with_all_near_it():
    ball = ball_on_the_ground()
    far = replace(ball, id=1, T_world_object=pose(t=[0.4, 0, 0]) @ ball.T_world_object)
    scene = scene_of(ball, far)
    after, outcome = close(scene, CONFIG, settled=settled, restless=[0])
    assert after[0] is scene[0] and gap(after, 1) < gap(scene, 1) and len(outcome.decisions) == 1
