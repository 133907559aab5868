"""coarsen: fewer convex parts for a scene at rest, which come no nearer to other bodies and leave it at rest."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from f3sr.contact import compounds
from f3sr.contact.polytopes import Polytope
from f3sr.contact.undersides import FootingConfig
from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.core.transforms import Array, pose
from f3sr.metrics.contact_groups import SettledScene
from f3sr.metrics.measures import proxy_distances, visible_ious
from f3sr.physics.mujoco_model import body_of
from f3sr.proxies import Join, ProxyConfig, few_parts
from f3sr.proxies.collapse import UNBOUNDED, collapsed
from f3sr.proxies.few_parts import NEARER, THIN_M, PartLimits, with_few_parts
from f3sr.proxies.hulls import planes
from f3sr.proxies.joins import join_order
from f3sr.proxies.known_parts import KnownParts
from f3sr.proxies.pair_volumes import Pair, PairQueue, PairVolumes
from f3sr.proxies.parts import subject_of
from f3sr.runtime import scene_serialization
from f3sr.scene import Scene, SceneObject, Support
from f3sr.stages.coarsen import LOSS, LOSS_TO_REST, TRIES, CoarsenConfig, Rebalanced, coarsen
from f3sr.vision import rasterizer
from scenes import ball_mesh, box, scene_of

REST = 0.5 * CoarsenConfig().contact.clearance
CONFIG = CoarsenConfig(stand_off=1.0)
"""These scenes are about other bodies: their parts may stand off."""
LIMITS = CONFIG.limits()
FEW_SAMPLES = ProxyConfig(cuts=replace(ProxyConfig().cuts, samples=2000))


def cuboid(low: Sequence[float], high: Sequence[float]) -> ConvexPart:
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    return ConvexPart.hull_of(corners)


def mesh_of(*parts: ConvexPart) -> Mesh:
    """The parts' surfaces together."""
    starts = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
    faces = np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=True)])
    return Mesh(vertices=np.concatenate([p.vertices for p in parts]), faces=faces.astype(np.int32))


def made_of(id: int, parts: Sequence[ConvexPart], at: Sequence[float] = (0, 0, REST)) -> SceneObject:
    return replace(box(id), mesh=mesh_of(*parts), parts=tuple(parts), T_world_object=pose(t=np.array(at)))


def trough(id: int = 0) -> SceneObject:
    """Two walls on a base, 10 x 10 x 6 cm, open along y."""
    base = cuboid((-0.05, -0.05, 0), (0.05, 0.05, 0.02))
    walls = [cuboid((x, -0.05, 0.02), (x + 0.02, 0.05, 0.06)) for x in (-0.05, 0.03)]
    return made_of(id, [base, *walls])


FREE = (Join(first=0, second=1, loss=0.0), Join(first=2, second=3, loss=0.0))
"""Joins of three parts to one."""


def fewer(
    scene: Scene, joins: Sequence[Join], limits: PartLimits = LIMITS, known: dict[int, KnownParts] | None = None
) -> SceneObject:
    """The first object with fewer parts."""
    footing = FootingConfig()
    return with_few_parts(scene, scene, {0: joins}, {0: limits}, footing=footing, clearance=2.6e-4, known=known)[0]


def moved_to_world(o: SceneObject) -> list[Polytope]:
    return [Polytope.of(p).moved(o.T_world_asset) for p in o.solids]


def on_a_ball(count: int = 400) -> Array:
    """Points (count, 3) on a ball of radius .3."""
    points = np.random.default_rng(2).normal(size=(count, 3))
    return 0.3 * points / np.linalg.norm(points, axis=1, keepdims=True)


def can(around: int, radius: float = 0.3, height: float = 0.6) -> Array:
    angles = np.linspace(0, 2 * np.pi, around, endpoint=False)
    return np.array([(radius * np.cos(a), radius * np.sin(a), z) for a in angles for z in (0, height)])


def height_over(corners: Array, points: Array) -> Array:
    """Distance (n,) of points beyond the farthest plane of the hull of corners."""
    polytope = Polytope.of(ConvexPart.hull_of(corners))
    return (points @ polytope.normals.T - polytope.offsets).max(1)


SHAPES = {
    "ball": on_a_ball(),
    "ellipsoid": on_a_ball() * (1, 0.6, 0.3),
    "can": can(100),
    "cone": np.array([*can(100)[::2], (0, 0, 0.7)]),
    "rounded box": np.concatenate(
        [c + 0.2 * on_a_ball(60) for c in cuboid((-0.3, -0.2, -0.1), (0.3, 0.2, 0.1)).vertices]
    ),
}


@pytest.mark.parametrize("most", [16, 32, 64])
@pytest.mark.parametrize("shape", SHAPES)
def test_few_vertices_contain_all_points(shape: str, most: int):
    corners = collapsed(SHAPES[shape], most)
    assert len(corners) <= most
    assert height_over(corners, SHAPES[shape]).max() < 1e-9
    assert np.array_equal(corners, collapsed(SHAPES[shape], most))


@pytest.mark.parametrize("most", [32, 64])
def test_a_ball_of_few_vertices_has_no_spikes(most: int):
    """No polytope around a ball of radius 1 has all of its vertices within 3^.5 tan(pi n / (6 n - 12)) (Fejes Toth)."""
    farthest = np.linalg.norm(collapsed(on_a_ball(1000), most), axis=1).max() / 0.3 - 1
    least = np.sqrt(3) * np.tan(np.pi / 6 * most / (most - 2)) - 1
    assert farthest < 1.6 * least


@pytest.mark.parametrize(("most", "volume"), [(32, 1.018), (64, 1.005)])
def test_a_can_of_few_vertices_is_a_prism(most: int, volume: float):
    corners = collapsed(can(100), most)
    assert len(corners) == most
    assert np.abs(corners[:, 2] - 0.3) == pytest.approx(np.full(most, 0.3), abs=1e-9)
    assert ConvexPart.hull_of(corners).volume < volume * ConvexPart.hull_of(can(100)).volume


def test_new_vertices_stay_behind_planes_and_keep_others_in_place():
    points = np.concatenate([on_a_ball(1000), [(0, 0, -0.3)]])
    ground = replace(
        UNBOUNDED, normals=np.array([[0.0, 0, -1]]), offsets=np.array([0.3]), points=points[-1:], radius=0.05
    )
    kept = points[ground.keeps(points)]
    free, bounded = collapsed(points, 40), collapsed(points, 40, ground)
    assert len(kept) > 1 and len(bounded) <= 40 and bounded[:, 2].min() >= -0.3 - 1e-9 > free[:, 2].min()
    assert height_over(bounded, points).max() < 1e-9
    assert (np.linalg.norm(bounded[:, None] - kept, axis=2).min(0) < 1e-12).all()
    assert height_over(bounded, kept) == pytest.approx(np.zeros(len(kept)), abs=1e-9)


def test_no_new_vertex_is_farther_than_allowed():
    for farthest, is_enough in ((0.01, False), (0.05, True)):
        corners = collapsed(on_a_ball(), 32, replace(UNBOUNDED, farthest=farthest))
        assert height_over(on_a_ball(), corners).max() < farthest + 1e-9
        assert (len(corners) <= 32) is is_enough


def test_pairs_come_by_volume_and_no_bound_exceeds_it():
    rng = np.random.default_rng(3)
    parts = [ConvexPart.hull_of(rng.normal(size=(12, 3)) + 3 * rng.normal(size=3)) for _ in range(8)]
    volumes, pairs = PairVolumes(), list(combinations(parts, 2))
    exact = {pair: ConvexPart.hull_of(np.concatenate([p.vertices for p in pair])).volume for pair in pairs}
    exact = {pair: volume - pair[0].volume - pair[1].volume for pair, volume in exact.items()}
    bounds = np.array([volumes.least(*pair) for pair in pairs])
    assert (bounds <= np.array([*exact.values()]) * (1 + 1e-9)).all() and bounds.max() > 0
    most = float(np.median([*exact.values()]))
    queue = PairQueue(volumes, most)
    queue.push(pairs)
    among, found = parts[1:], list[Pair]()
    while one := queue.pop(among):
        assert one[0] == pytest.approx(exact[one[1]])
        found.append(one[1])
    wanted = sorted((p for p in pairs if parts[0] not in p and exact[p] <= most), key=lambda p: exact[p])
    assert found == wanted


def test_parts_of_a_box_are_joined_without_loss_and_a_cavity_is_bridged_last():
    size = trough().mesh.diagonal
    parts = [p.moved(np.diag([1 / size, 1 / size, 1 / size, 1.0])) for p in trough().parts]
    mesh = mesh_of(*parts)
    first, last = join_order(parts, subject_of(mesh.vertices, mesh.faces, mesh.hull, FEW_SAMPLES))
    assert first.loss < last.loss and last.loss > 0.1 and last.second == 3


def test_parts_are_joined_where_nothing_is_near():
    few = fewer(scene_of(trough()), FREE)
    assert len(few.parts) == 1
    assert few.parts[0].volume == pytest.approx(trough().mesh.hull.volume)


def test_parts_are_not_joined_over_another_body():
    """A box stands between the walls of a trough: a hull of both walls would hold it."""
    scene = scene_of(trough(), box(1, size=(0.03, 0.03, 0.03), at=(0, 0, 0.02 + 0.015 + 4 * REST)))
    few = fewer(scene, FREE)
    assert 1 < len(few.parts) < 4
    assert not compounds.collide(moved_to_world(few), moved_to_world(scene[1]))


def test_what_loses_too_much_is_not_joined_unless_there_are_too_many():
    dear = (FREE[0], replace(FREE[1], loss=0.05))
    assert len(fewer(scene_of(trough()), dear).parts) == 2
    assert len(fewer(scene_of(trough()), dear, replace(LIMITS, parts=1)).parts) == 1
    assert len(fewer(scene_of(trough()), (), replace(LIMITS, parts=1)).parts) == 1


def test_what_is_known_of_parts_changes_nothing_under_other_limits_or_beside_other_bodies():
    o, known = trough(), dict[int, KnownParts]()
    ball = ConvexPart.hull_of(on_a_ball(300) / 3)
    o = replace(o, mesh=mesh_of(*o.parts, ball), parts=(*o.parts, ball))
    for beside in ((), (box(1, at=(0, 0, 0.2)),)):
        for limits in (LIMITS, replace(LIMITS, parts=1), replace(LIMITS, vertices=32), LIMITS):
            few, again = (fewer(scene_of(o, *beside), FREE, limits, each).parts for each in (None, known))
            assert len(few) == len(again)
            assert all(np.array_equal(a.vertices, b.vertices) for a, b in zip(few, again, strict=True))


def test_a_part_of_few_vertices_is_known_by_how_many_are_allowed():
    ball = ConvexPart.hull_of(on_a_ball(120) / 3)
    known = KnownParts(mesh_of(ball))
    counts = [len(known.few(ball, most, UNBOUNDED).vertices) for most in (64, 32, 64)]
    assert counts[1] <= 32 < counts[0] == counts[2] <= 64


def test_a_whole_subtree_is_joined_where_that_is_worth_its_parts():
    """The first join alone loses more than a part is worth, both together less than two."""
    joins = (replace(FREE[0], loss=0.025), FREE[1])
    assert len(fewer(scene_of(trough()), joins).parts) == 1


def test_parts_that_no_join_names_are_joined_where_that_adds_hardly_a_volume():
    """A step of .5 mm on a cube of 10 cm; one of 3 cm stays."""
    cube = cuboid((-0.05, -0.05, 0), (0.05, 0.05, 0.1))
    steps = {height: cuboid((-0.05, -0.05, 0.1), (0, 0.05, 0.1 + height)) for height in (5e-4, 0.03)}
    parts = {height: fewer(scene_of(made_of(0, [cube, step])), ()).parts for height, step in steps.items()}
    assert {height: len(few) for height, few in parts.items()} == {5e-4: 1, 0.03: 2}


def test_too_many_parts_are_joined_where_fewer_are_worth_nothing():
    assert len(fewer(scene_of(trough()), FREE, replace(LIMITS, worth=0.0, parts=1)).parts) == 1


def test_joins_are_refused_while_parts_stand_off_farther_than_asked():
    """One hull fills a trough, and its walls alone stand off nothing."""
    scene = scene_of(trough(), replace(trough(1), T_world_object=pose(t=np.array([0.5, 0, REST]))))
    o, few = scene[0], fewer(scene, FREE, replace(LIMITS, stand_off=0.01))
    assert proxy_distances(fewer(scene, FREE))[1] > 0.01 > proxy_distances(few)[1]
    assert len(few.parts) == len(o.parts)
    assert len(fewer(scene, FREE, replace(LIMITS, stand_off=0.01, parts=1)).parts) == 1


def test_where_no_refusal_leads_near_enough_the_nearest_parts_are_taken(monkeypatch: pytest.MonkeyPatch):
    """One hull is first, what is left without it stands off more; before both, the parts stand off nothing."""
    means = iter([0.02, 0.0, 0.05])
    monkeypatch.setattr(few_parts, "REFUSALS", 1)
    monkeypatch.setattr(few_parts._Fewer, "_stand_off", lambda _, parts: [np.full(1, next(means))] * len(parts))
    assert len(fewer(scene_of(trough()), FREE, replace(LIMITS, stand_off=0.01)).parts) == 1
    assert next(means, None) is None


@pytest.mark.parametrize(("lower", "left"), [(0.5, 1), (2.5, 2)])
def test_a_join_comes_hardly_nearer_to_another_body(lower: float, left: int):
    """A plate lies over the lower of two bars: one hull for both comes nearer by the step between them."""
    step = lower * NEARER
    bars = [cuboid((-0.05, -0.05, 0), (0, 0.05, 0.1)), cuboid((0, -0.05, 0), (0.05, 0.05, 0.1 - step))]
    plate = box(1, size=(0.001, 0.1, 0.02), at=(0.003, 0, 0.11 + REST + 4 * NEARER - step))
    scene = scene_of(made_of(0, bars), plate)
    assert len(fewer(scene, ()).parts) == left
    assert len(fewer(scene, (), replace(LIMITS, parts=1)).parts) == 1


def test_a_wedge_of_a_footing_joins_a_part_where_it_adds_little_or_where_there_are_too_many():
    cube, flat = cuboid((-0.05, -0.05, 0.03), (0.05, 0.05, 0.13)), cuboid((-0.05, -0.05, 0.025), (0.05, 0.05, 0.03))
    leg = cuboid((0.03, 0.03, 0), (0.05, 0.05, 0.03))

    def left(wedge: ConvexPart, limits: PartLimits) -> tuple[int, int]:
        few = fewer(scene_of(replace(made_of(0, [cube]), footing=(wedge,))), (), limits)
        return len(few.parts), len(few.footing)

    assert [left(wedge, LIMITS) for wedge in (flat, leg)] == [(1, 0), (1, 1)]
    assert left(leg, replace(LIMITS, parts=1)) == (1, 0)


@pytest.mark.parametrize("gap", [10 * REST, 1.9 * REST])
def test_a_footing_is_made_anew_whatever_lies_on_the_object(gap: float):
    """It has a spur that ends below it, beside what carries it. A load in contact leaves the object no room to rise,
    and it need not."""
    slab = box(0, size=(0.3, 0.3, 0.1), at=(-0.1, 0, 0.05 + REST))
    corners = cuboid((-0.05, -0.05, 0.002), (0.05, 0.05, 0.1)).vertices
    body = ConvexPart.hull_of(np.where(corners[:, :1] + corners[:, 2:] < 0, corners - [0, 0, 0.002], corners))
    spur = cuboid((0.051, -0.01, -0.0004), (0.06, 0.01, 0.05))
    outdated = cuboid((-0.05, -0.05, 0.001), (0.0, 0.05, 0.002))
    o = made_of(1, [body, spur], at=(0, 0, 0.1 + 3 * REST))
    o = replace(o, footing=(outdated,), supports=(Support(id=0),), supported_by=0)
    load = replace(box(2, at=(0, 0, 0.25 + 3 * REST + gap)), supports=(Support(id=1),), supported_by=1)
    limits = {0: LIMITS, 1: replace(LIMITS, worth=0.0)}
    scene = scene_of(slab, o, load)
    few = with_few_parts(scene, scene, {}, limits, footing=FootingConfig(), clearance=2 * REST)
    corners = np.concatenate([p.vertices for p in few[1].solids])
    over = (corners[:, 0] > -0.01) & (corners[:, 0] < 0.05)
    assert corners[over, 2].min(initial=1.0) == pytest.approx(0, abs=1e-4)


def test_what_is_held_keeps_its_footing():
    """In a retry all but some objects are held, and the footing of what nothing moves is not made anew."""
    slab = box(0, size=(0.3, 0.3, 0.1), at=(0, 0, 0.05 + REST))
    wedge = cuboid((-0.05, -0.05, -0.001), (0.05, 0.05, 0))
    o = made_of(1, [cuboid((-0.05, -0.05, 0), (0.05, 0.05, 0.1))], at=(0, 0, 0.101 + 3 * REST))
    o = replace(o, footing=(wedge,), supports=(Support(id=0),), supported_by=0, mobility="fixed")
    scene = scene_of(slab, o)
    limits = dict.fromkeys((0, 1), LIMITS)
    few = with_few_parts(scene, scene, {}, limits, footing=FootingConfig(), clearance=2 * REST)[1]
    assert [p.volume for p in few.solids] == pytest.approx([1.01e-3])


@pytest.mark.parametrize("most", [32, 64])
def test_a_ball_gets_few_vertices_covers_its_mesh_and_stays_above_the_ground(most: int):
    mesh = ball_mesh(0.05)
    ball = replace(box(0), mesh=mesh, parts=(mesh.hull,), T_world_object=pose(t=[0, 0, 0.05 + REST]))
    few = fewer(scene_of(ball), (), replace(LIMITS, vertices=most))
    (part,) = few.parts
    normals, offsets = planes(part)
    assert len(part.vertices) <= most < len(mesh.hull.vertices)
    assert (mesh.vertices @ normals.T - offsets).max() < 1e-9
    assert part.vertices[:, 2].min() + 0.05 > -1.01 * NEARER


def test_a_thin_part_of_a_solid_reaches_into_it_and_a_thin_object_stays_thin():
    layers = [cuboid((-0.05, -0.05, 0), (0.05, 0.05, 0.0005)), cuboid((-0.03, -0.03, 0.0005), (0.03, 0.03, 0.1))]
    thin, solid = fewer(scene_of(made_of(0, layers)), ()).parts
    assert np.ptp(thin.vertices[:, 2]) >= THIN_M and solid is layers[1]
    assert thin.vertices[:, 2].min() == 0
    sheet = [layers[0]]
    assert fewer(scene_of(made_of(0, sheet)), ()).parts[0] is sheet[0]


def test_a_body_keeps_its_mass_where_its_parts_become_larger():
    o = trough()
    open_mesh = Mesh(vertices=o.mesh.vertices, faces=o.mesh.faces[2:])
    o = replace(o, mesh=open_mesh)
    few = fewer(scene_of(o), FREE)
    before, after = body_of(o), body_of(few)
    assert few.parts[0].volume > sum(p.volume for p in o.parts)
    assert after.mass == pytest.approx(before.mass) and after.center == pytest.approx(before.center)
    document, arrays = scene_serialization.pack(scene_of(few))
    again = scene_serialization.unpack(scene_of(o), document, arrays)[0]
    assert body_of(again).mass == after.mass and np.array_equal(body_of(again).inertia, after.inertia)


def not_in_balance(
    scene: Scene, moving: frozenset[int], *, finished: Callable[[Scene], Scene] = lambda scene: scene
) -> SettledScene:
    """No equilibrium is found: all that should move overlaps as it did, and does not rest."""
    return SettledScene(scene=scene, restless=moving)


def coarsened(scene: Scene, restless: Sequence[Collection[int]]) -> tuple[Scene, list[str], int]:
    """The scene, its decisions and how often it was settled; physics says which objects do not rest, in turn."""
    told = list(restless)

    def settled(tried: Scene) -> SettledScene:
        return SettledScene(scene=tried, restless=frozenset(told.pop(0)))

    result, outcome = coarsen(
        scene, CONFIG, made=scene, joins={0: FREE, 1: FREE}, settled=settled, balanced=not_in_balance
    )
    return result, [f"{d.about}: {d.choice}" for d in outcome.decisions], len(restless) - len(told)


@pytest.fixture
def two() -> Scene:
    far: Array = np.array([0.5, 0, REST])
    return scene_of(trough(), replace(trough(1), T_world_object=pose(t=far)))


def test_a_scene_that_rests_is_settled_once(two: Scene):
    scene, decisions, times = coarsened(two, [()])
    assert [len(o.parts) for o in scene] == [1, 1] and not decisions and times == 1


def test_only_the_group_that_moves_is_tried_again(two: Scene):
    scene, decisions, times = coarsened(two, [(1,), ()])
    assert [len(o.parts) for o in scene] == [1, 1] and not decisions and times == 2


def test_what_moves_however_fine_its_parts_keeps_them(two: Scene):
    scene, decisions, times = coarsened(two, [(1,)] * TRIES)
    assert scene[1].parts is two[1].parts and len(scene[0].parts) == 1
    assert decisions == ["1: keeps all its 3 convex parts"] and times == TRIES


LIMITED = replace(CONFIG, max_parts=2)


def slid(
    before: Scene,
    restless: Collection[int],
    slides: Sequence[float],
    *,
    balanced: Rebalanced = not_in_balance,
) -> tuple[Scene, list[str], list[list[int]]]:
    """The scene, its decisions, and the number of parts that were tried; object 1 slides a way [m] in each attempt."""
    ways, tried = list(slides), list[list[int]]()

    def settled(scene: Scene) -> SettledScene:
        tried.append([len(o.parts) for o in scene])
        o = scene[1]
        T = pose(t=o.T_world_object[:3, 3] + np.array([ways.pop(0), 0, 0]))
        return SettledScene(scene=scene.with_objects(replace(o, T_world_object=T)), restless=frozenset())

    found, outcome = coarsen(
        before,
        LIMITED,
        made=before,
        joins={0: FREE, 1: FREE},
        settled=settled,
        balanced=balanced,
        restless=restless,
    )
    assert not ways
    return found, [f"{d.about}: {d.choice}" for d in outcome.decisions], tried


@pytest.fixture
def seen(two: Scene) -> Scene:
    """The two with masks as they are seen, nearer to each other in the picture, and far apart all the same."""
    near = two.with_objects(replace(two[1], T_world_object=pose(t=np.array([0.2, 0, REST]))))
    ids = rasterizer.visible_ids(near.objects, near.camera)
    return near.with_objects(*(replace(o, mask=ids == o.id) for o in near))


def test_a_group_over_the_limits_that_always_moves_takes_what_loses_least(seen: Scene, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("f3sr.stages.coarsen.LOSS_TO_LIMIT", 0.9)
    scene, decisions, tried = slid(seen, (), [0.05, 0.03, 0.05])
    assert [len(o.parts) for o in scene] == [1, 1] and tried == [[1, 1], [1], [1]]
    assert scene[1].T_world_object[0, 3] == pytest.approx(0.23)
    assert decisions == [d for d in decisions if d.startswith("1: moves as its group")] and decisions


def test_a_group_over_the_limits_keeps_its_parts_where_fewer_show_another_scene(seen: Scene):
    scene, decisions, _ = slid(seen, (), [0.05] * TRIES)
    assert scene[1].parts is seen[1].parts and np.array_equal(scene[1].T_world_object, seen[1].T_world_object)
    assert decisions == ["1: keeps all its 3 convex parts"]


def test_what_others_keep_from_joining_within_the_limits_is_not_tried_again(seen: Scene):
    """A box stands between the walls of the first trough, which always moves."""
    between = replace(box(2, size=(0.03, 0.03, 0.03), at=(0, 0, 0.02 + 0.015 + 4 * REST)), supported_by=0)
    before, tried = replace(seen, objects=(seen[0], replace(between, mask=np.zeros_like(seen[0].mask)))), list[Scene]()

    def settled(scene: Scene) -> SettledScene:
        tried.append(scene)
        return SettledScene(scene=scene, restless=frozenset({0}))

    config = replace(CONFIG, max_parts=1)
    found, outcome = coarsen(
        before, config, made=before, joins={0: FREE, 2: ()}, settled=settled, balanced=not_in_balance
    )
    assert len(tried) == TRIES, "none with fewer parts of only what is over the limits"
    assert all(scene[0].parts is seen[0].parts for scene in (*tried[1:], found))
    decision = next(d for d in outcome.decisions if d.about == 0)
    assert decision.choice == "keeps all its 3 convex parts" and decision.fallback


def test_a_group_within_the_limits_keeps_its_parts_and_says_so_beside_one_that_cannot_have_few(
    seen: Scene, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("f3sr.stages.coarsen.LOSS_TO_LIMIT", 0.9)
    between = replace(box(2, size=(0.03, 0.03, 0.03), at=(0, 0, 0.02 + 0.015 + 4 * REST)), supported_by=0)
    alone = box(3, at=(0.4, 0, 0.05 + REST))
    objects = (seen[0], between, alone)
    ids = rasterizer.visible_ids(objects, seen.camera)
    before = replace(seen, objects=tuple(replace(o, mask=ids == o.id) for o in objects))

    def settled(scene: Scene) -> SettledScene:
        slid = scene[3].moved(pose(t=[-0.03, 0, 0]), stage="test", reason="")
        return SettledScene(scene=scene.with_objects(slid), restless=frozenset({0}))

    config = replace(CONFIG, max_parts=1)
    found, outcome = coarsen(
        before, config, made=before, joins={0: FREE, 2: (), 3: ()}, settled=settled, balanced=not_in_balance
    )
    assert np.array_equal(found[3].T_world_object, alone.T_world_object)
    told = {d.about: (d.choice, d.fallback) for d in outcome.decisions}
    assert told[3] == ("keeps all its 1 convex parts", False)


def test_what_is_over_the_limits_gets_fewer_parts_where_its_group_rests_with_them(seen: Scene):
    """What touches it is within them: it has its one part in the last attempt."""
    beside = made_of(2, [cuboid((0.15, 0.0502, 0), (0.18, 0.08, 0.03))])
    before = replace(seen, objects=(*seen, replace(beside, mask=np.zeros_like(seen[0].mask))))
    scene, decisions, tried = slid(before, (), [0.05, 0.05, 0.05, 0.0])
    assert [len(o.parts) for o in scene] == [1, 1, 1] and not decisions
    assert tried == [[1, 1, 1], [1, 1], [1, 1], [1, 1]]
    assert scene[1].T_world_object[0, 3] == pytest.approx(0.2)


def test_what_slides_on_fewer_parts_rests_on_them_in_another_equilibrium(seen: Scene):
    asked = list[frozenset[int]]()

    def balanced(scene: Scene, moving: frozenset[int], *, finished: Callable[[Scene], Scene]) -> SettledScene:
        asked.append(moving)
        o = replace(scene[1], T_world_object=pose(t=scene[1].T_world_object[:3, 3] + np.array([1e-4, 0, 0])))
        return SettledScene(scene=scene.with_objects(o), restless=frozenset())

    scene, decisions, tried = slid(seen, (), [0.05], balanced=balanced)
    assert asked == [frozenset({1})] and tried == [[1, 1]] and not decisions
    assert scene[1].T_world_object[0, 3] == pytest.approx(0.2001)


def test_footings_of_an_equilibrium_join_parts_and_count_for_the_limit(seen: Scene):
    """A plate of 2 mm under the object, of its outline: with it one box is a box."""

    def balanced(scene: Scene, moving: frozenset[int], *, finished: Callable[[Scene], Scene]) -> SettledScene:
        o = scene[1]
        low, high = o.mesh.bounds
        plate = cuboid((*low[:2], low[2] - 0.002), (*high[:2], low[2]))
        raised = o.moved(pose(t=np.array([0, 0, 0.002])), stage="refine", reason="")
        standing = finished(scene.with_objects(replace(raised, footing=(plate,))))
        return SettledScene(scene=standing, restless=frozenset())

    scene, _, _ = slid(seen, (), [0.05], balanced=balanced)
    assert len(scene[1].colliders) == 1 and not scene[1].footing
    assert scene[1].colliders_world[0].vertices[:, 2].min() == pytest.approx(seen[1].bounds_world[0, 2], abs=1e-6)


def test_what_settled_stays_so_while_another_group_goes_to_its_equilibrium(seen: Scene):
    """The group that stays showed a little more of its mask before it settled, and did not rest."""
    down = np.array([0.0, 0, -2e-4])

    def settled(scene: Scene) -> SettledScene:
        moved = (
            replace(o, T_world_object=pose(t=o.T_world_object[:3, 3] + by)) for o, by in zip(scene, ways, strict=True)
        )
        return SettledScene(scene=scene.with_objects(*moved), restless=frozenset({0}))

    def balanced(scene: Scene, moving: frozenset[int], *, finished: Callable[[Scene], Scene]) -> SettledScene:
        assert moving == {1} and np.array_equal(scene[1].T_world_object, seen[1].T_world_object)
        assert np.array_equal(scene[0].T_world_object[:3, 3], seen[0].T_world_object[:3, 3] + down)
        return SettledScene(scene=scene, restless=frozenset())

    ways = [down, np.array([0.05, 0, 0])]
    joins = {0: FREE, 1: FREE}
    found, _ = coarsen(seen, LIMITED, made=seen, joins=joins, settled=settled, balanced=balanced, restless=[0])
    assert found[0].T_world_object[2, 3] == pytest.approx(REST - 2e-4) and found[1].T_world_object[0, 3] == 0.2


def test_an_equilibrium_is_not_sought_again_where_it_was_no_better(seen: Scene):
    asked = list[frozenset[int]]()

    def balanced(scene: Scene, moving: frozenset[int], *, finished: Callable[[Scene], Scene]) -> SettledScene:
        asked.append(moving)
        return not_in_balance(scene, moving, finished=finished)

    scene, _, tried = slid(seen, (), [0.05] * TRIES, balanced=balanced)
    assert len(tried) == TRIES and asked == [frozenset({1})]
    assert scene[1].parts is seen[1].parts


@pytest.mark.parametrize(("restless", "attempts"), [([1], 1), ([], TRIES)])
def test_what_did_not_rest_before_may_move_a_little_to_come_to_rest(
    seen: Scene, restless: Collection[int], attempts: int
):
    mask = seen[1].mask.copy()
    mask[:4, :40] = True  # sky that it does not cover: few of the pixels are its own
    scene = seen.with_objects(replace(seen[1], mask=mask))
    moved = scene.with_objects(replace(scene[1], T_world_object=pose(t=np.array([0.205, 0, REST]))))
    assert LOSS < visible_ious(scene)[1] - visible_ious(moved)[1] < LOSS_TO_REST
    _, decisions, tried = slid(scene, restless, [0.005] * attempts)
    assert len(tried) == attempts and len(decisions) == 1
