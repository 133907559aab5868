"""Objects brought to rest from other poses: what slides with a guessed friction, and what is told of it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from f3sr import contact_retries
from f3sr.contact_retries import ContactRetries, Retry
from f3sr.core.transforms import pose, rotation_about
from f3sr.metrics.contact_groups import SettledScene
from f3sr.pipeline_config import Config, with_shared_settings
from f3sr.scene import GROUND, Relation, Scene, SceneObject, Support
from f3sr.vision import rasterizer
from scenes import box, scene_of


def leaning(id: int, sign: int, *, degrees: float = 60.0) -> SceneObject:
    """One of two planks that lean on each other in the plane y = 0, with a label that tells wood's friction of .5."""
    long, thin = 0.18, 0.008
    R, a = rotation_about([0, 1, 0], sign * np.radians(degrees)), np.radians(degrees)
    at = [
        sign * (long * np.cos(a) / 2 + thin * np.sin(a) / 2 + 1e-4),
        0,
        (long * np.sin(a) + thin * np.cos(a)) / 2 + 2e-4,
    ]
    plank = box(id, size=(long, 0.05, thin), label="plank")
    on_ground = (Support(id=GROUND, share=1.0),)
    return replace(plank, T_world_object=pose(R, at), friction=0.5, supports=on_ground, supported_by=GROUND)


@pytest.fixture
def planks() -> Scene:
    scene = scene_of(leaning(0, -1), leaning(1, 1))
    ids = rasterizer.render(scene.objects, scene.camera).ids
    return scene.with_objects(*(replace(o, mask=ids == o.id) for o in scene))


def never(*_args: object, **_others: object) -> None:
    raise AssertionError("not to be called")


@pytest.fixture
def retries() -> ContactRetries:
    return ContactRetries(config=with_shared_settings(Config()))


@pytest.fixture
def resting() -> Scene:
    """A box at rest."""
    return photographed(scene_of(box(0, at=(0, 0, 0.05 + 2.6e-4))))


def photographed(scene: Scene, shift: tuple[float, float, float] = (0, 0, 0)) -> Scene:
    """A scene with a picture of 640 x 480 pixels of where it is after a shift [m]."""
    was, rgb = scene.camera, np.tile(scene.photo.rgb, (10, 10, 1))
    camera = replace(was, width=10 * was.width, height=10 * was.height, K=was.K * [[10], [10], [1]])
    seen = [o.moved(pose(t=np.array(shift)), stage="test", reason="") for o in scene]
    ids = rasterizer.render(seen, camera).ids
    objects = tuple(replace(o, mask=ids == o.id) for o in scene)
    return replace(scene, photo=replace(scene.photo, rgb=rgb), camera=camera, objects=objects)


def test_what_lost_in_balance_is_put_back_and_not_closed(
    resting: Scene, retries: ContactRetries, monkeypatch: pytest.MonkeyPatch
):
    """A loss of .01, which closing the gaps of separated objects might win back."""
    off = resting.with_objects(resting[0].moved(pose(t=[0.0006, 0, 0]), stage="test", reason=""))
    lost = SettledScene(scene=off, restless=frozenset())
    before = SettledScene(scene=resting, restless=frozenset())
    assert 0 < before.score - lost.score < contact_retries.WON_BACK

    def nearest_balance(*_args: object, **_others: object) -> SettledScene:
        return lost

    monkeypatch.setattr(ContactRetries, "_nearest_balance", nearest_balance)
    monkeypatch.setattr(contact_retries, "close", never)
    after = retries.balanced(resting, start=resting, moving=frozenset({0}))
    assert np.array_equal(after.scene[0].T_world_object, resting[0].T_world_object)


def test_what_is_held_is_as_restless_as_before_and_what_settles_with_it_as_physics_says():
    """Objects 0 and 1 stand far apart; object 2 comes to touch 1 and rests with it."""
    before = scene_of(*(box(k, at=(x, 0, 0.05)) for k, x in enumerate((-0.5, 0.0, 0.3))))
    contact = Config().refine.contact
    beside = before.with_objects(replace(before[2], T_world_object=pose(t=np.array([0.1 + 1e-4, 0, 0.05]))))
    asked = list[list[int]]()

    def settled(scene: Scene) -> SettledScene:
        asked.append([o.id for o in scene])
        return SettledScene(scene=scene, restless=frozenset())

    retry = Retry.of_moving(before, beside, frozenset({2}), restless=frozenset({0, 1, 2}))
    ended = retry.ended(SettledScene(scene=retry.scene, restless=frozenset()), contact, settled=settled)
    assert asked == [[1, 2]] and ended.restless == {0}
    assert all(o.mobility == before[o.id].mobility for o in ended.scene)


def test_footings_in_place_are_not_asked_where_physics_leaves_what_is_balanced(
    resting: Scene, retries: ContactRetries, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(contact_retries, "on_footings_in_place", never)
    after = retries.balanced(resting, start=resting, moving=frozenset({0}))
    assert not after.restless and after.seen > 0.999


@pytest.mark.parametrize("source", ["label", "given"])
def test_what_leans_in_the_photo_gets_the_friction_that_holds_it_unless_somebody_gave_one(
    planks: Scene, retries: ContactRetries, source: str
):
    scene = planks.with_objects(*(replace(o, material_source=source) for o in planks))
    after = retries.balanced(scene, start=scene, moving=frozenset({0, 1}))
    assert not after.restless and min(after.ious.values()) > 0.98
    raised = source == "label"
    assert [o.friction for o in after.scene] == [0.6 if raised else 0.5] * 2
    assert all(("would slide" in o.material_reason) == raised for o in after.scene)


def test_what_is_in_balance_is_sought_from_where_it_rests_once_it_is_aligned_again(
    planks: Scene, retries: ContactRetries, monkeypatch: pytest.MonkeyPatch
):
    """The photo shows both planks 6 mm beside where they rest."""
    before = photographed(retries.balanced(planks, start=planks, moving=frozenset({0, 1})).scene, (0.006, 0, 0))
    starts, sought = list[Scene | None](), contact_retries.balance

    def balance(*args: Any, start: Scene | None, **others: Any) -> Scene:
        starts.append(start)
        return sought(*args, start=start, **others)

    monkeypatch.setattr(contact_retries, "balance", balance)
    after = retries.realigned(before, [0, 1], balanced=frozenset({0, 1}))
    assert starts == [before]
    was = SettledScene(scene=before, restless=frozenset())
    assert not after.restless and after.seen > was.seen + 0.01


def test_of_a_stack_on_something_unseen_the_lowest_is_held_and_carries_the_others(retries: ContactRetries):
    """Two boxes that hang by .2 m where the photo shows them; at first they lie on the ground."""
    up = photographed(scene_of(box(0, at=(0, 0, 0.25)), box(1, at=(0.01, 0, 0.35 + 2.6e-4))))
    down = up.with_objects(*(replace(o, T_world_object=pose(t=[0.2 * o.id, 0, 0.05 + 2.6e-4])) for o in up))
    assert retries.held(down, start=up, moving=frozenset({0, 1}), most=0).scene is down
    after = retries.held(down, start=up, moving=frozenset({0, 1}), most=1)
    assert not after.restless and min(after.ious.values()) > 0.98
    assert [o.mobility for o in after.scene] == ["fixed", "dynamic"]
    assert [o.carriers for o in after.scene] == [[], [0]]


def test_what_is_held_off_its_mask_is_sought_where_nothing_overlaps_too(
    retries: ContactRetries, monkeypatch: pytest.MonkeyPatch
):
    """The search of objects as they are, as it were, ends with the upper one off its mask."""
    begun, sought = list[bool](), contact_retries.balance

    def balance(*args: Any, apart: bool = False, **others: Any) -> Scene:
        begun.append(apart)
        found = sought(*args, apart=apart, **others)
        return found if apart else found.with_objects(found[1].moved(pose(t=[0.04, 0, 0]), stage="test", reason=""))

    monkeypatch.setattr(contact_retries, "balance", balance)
    up = photographed(scene_of(box(0, at=(0, 0, 0.25)), box(1, at=(0.01, 0, 0.35 + 2.6e-4))))
    down = up.with_objects(*(replace(o, T_world_object=pose(t=[0.2 * o.id, 0, 0.05 + 2.6e-4])) for o in up))
    after = retries.held(down, start=up, moving=frozenset({0, 1}), most=1)
    assert not begun[0] and begun[-1] and min(after.ious.values()) > 0.98
    assert [o.mobility for o in after.scene] == ["fixed", "dynamic"]


@pytest.mark.parametrize("known", ["support", "mobility"])
def test_what_is_given_to_rest_on_something_or_to_move_is_not_held(retries: ContactRetries, known: str):
    up = photographed(scene_of(box(0, at=(0, 0, 0.25)), box(1, at=(0.3, 0, 0.25))))
    if known == "support":
        given = Relation(subject=0, predicate="supported_by", object=GROUND, confidence=1, evidence="", source="given")
        up = replace(up, graph=replace(up.graph, relations=(given,)))
    else:
        up = up.with_objects(replace(up[0], mobility_source="given"))
    down = up.with_objects(*(replace(o, T_world_object=pose(t=[0.3 * o.id, 0, 0.05 + 2.6e-4])) for o in up))
    after = retries.held(down, start=up, moving=frozenset({0, 1}), most=2)
    assert [o.mobility for o in after.scene] == ["dynamic", "fixed"]


def test_nothing_is_held_that_contact_can_carry(planks: Scene, retries: ContactRetries):
    assert retries.held(planks, start=planks, moving=frozenset({0, 1}), most=2).scene is planks


def pushed_by(
    monkeypatch: pytest.MonkeyPatch, pushed: Callable[[Scene], Collection[int]], way: Sequence[float] = (0, 0.05, 0)
) -> None:
    """Let physics, as it were, push away some of the objects of a scene at rest."""
    settled = ContactRetries._at_rest

    def at_rest(self: ContactRetries, scene: Scene) -> SettledScene:
        rested = settled(self, scene)
        moved = (rested.scene[id].moved(pose(t=way), stage="test", reason="") for id in pushed(rested.scene))
        return replace(rested, scene=rested.scene.with_objects(*moved))

    monkeypatch.setattr(ContactRetries, "_at_rest", at_rest)


@pytest.mark.slow
@pytest.mark.parametrize("way", [(0, 0.05, 0), (0, 0, -0.015)], ids=["far", "off its mask"])
def test_what_falls_although_forces_balance_is_held(
    planks: Scene, retries: ContactRetries, monkeypatch: pytest.MonkeyPatch, way: tuple[float, float, float]
):
    """Physics, as it were, pushes away whichever plank is free: the lower one in the scene's order first."""
    planks = photographed(planks)
    pushed_by(monkeypatch, lambda scene: [o.id for o in scene if o.mobility == "dynamic"], way)
    both = frozenset({0, 1})
    fell = planks.with_objects(*(o.moved(pose(t=way), stage="test", reason="") for o in planks))
    for most in (0, 1):
        assert retries.held(fell, start=planks, moving=both, most=most).scene is fell
    after = retries.held(fell, start=planks, moving=both, most=2).scene
    assert [o.mobility for o in after] == ["fixed", "fixed"]
    assert retries.held(planks, start=planks, moving=both, most=2).scene is planks, "nothing fell"
    only = fell.with_objects(replace(fell[0], mobility_source="given"))
    assert retries.held(only, start=planks, moving=both, most=2).scene[0].mobility == "dynamic"


@pytest.mark.parametrize(("most", "held"), [(1, [0]), (2, [0, 1])])
def test_what_falls_once_another_is_held_that_no_forces_balance_is_held_too(
    retries: ContactRetries, monkeypatch: pytest.MonkeyPatch, most: int, held: list[int]
):
    """Forces balance the second box on the ground. Where not both may be held, the one that hangs is."""
    up = photographed(scene_of(box(0, at=(0, 0, 0.25)), box(1, at=(0.3, 0, 0.05 + 2.6e-4))))
    down = up.with_objects(replace(up[0], T_world_object=pose(t=[0, 0, 0.05 + 2.6e-4])))
    pushed_by(monkeypatch, lambda scene: [1] if scene[1].mobility == "dynamic" else [])
    after = retries.held(down, start=up, moving=frozenset({0, 1}), most=most).scene
    assert [o.id for o in after if o.mobility == "fixed"] == held


def test_what_stays_once_others_are_held_is_free_again(
    planks: Scene, retries: ContactRetries, monkeypatch: pytest.MonkeyPatch
):
    """The lower plank is held first. It stays where it is as soon as the upper one does."""

    def is_free(scene: Scene) -> bool:
        return scene[1].mobility == "dynamic"

    planks, both = photographed(planks), frozenset({0, 1})
    pushed_by(monkeypatch, lambda scene: [o.id for o in scene if o.mobility == "dynamic"] if is_free(scene) else [])
    fell = planks.with_objects(*(o.moved(pose(t=(0, 0.05, 0)), stage="test", reason="") for o in planks))
    after = retries.held(fell, start=planks, moving=both, most=2).scene
    assert [o.mobility for o in after] == ["dynamic", "fixed"]
