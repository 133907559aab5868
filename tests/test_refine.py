"""refine: groups that do not touch are kept or undone each for itself."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from f3sr.contact_retries import Retry
from f3sr.core.transforms import pose, rotation_about
from f3sr.metrics import contact_groups
from f3sr.metrics.contact_groups import SettledScene
from f3sr.metrics.measures import visible_ious
from f3sr.scene import GROUND, GeometrySource, Scene
from f3sr.stages.refine import HOPELESS, RETURNS, UNSEEN, RefineConfig, Refined, Retries, refine
from f3sr.vision import rasterizer
from scenes import box, measured, scene_of

ONCE, NO_ROUND = RefineConfig(rounds=1), RefineConfig(rounds=0)
FAR, NEAR = (0.03, 0.03), (0.01, 0.0)
"""How far two boxes have slid [m]."""


@pytest.fixture
def seen() -> Scene:
    """Two boxes far apart, the masks what the camera sees."""
    return as_shown(scene_of(box(0, at=(-0.25, 0, 0.05)), box(1, at=(0.25, 0, 0.05))))


def as_shown(scene: Scene) -> Scene:
    """The scene with masks that are what the camera sees."""
    ids = rasterizer.render(scene.objects, scene.camera).ids
    return scene.with_objects(*(replace(o, mask=ids == o.id) for o in scene))


def shifted(scene: Scene, shifts: Mapping[int, float]) -> Scene:
    moved = [scene[id].moved(pose(t=[x, 0, 0]), stage="test", reason="") for id, x in shifts.items()]
    return scene.with_objects(*moved)


def in_vain(before: Scene, *_: object, **_others: object) -> SettledScene:
    return SettledScene(scene=before, restless=frozenset())


def unasked(_: Scene) -> SettledScene:
    raise AssertionError("nothing is to be settled")


def retried(
    start: Scene,
    config: RefineConfig,
    *,
    aligned: Scene,
    parted: Scene,
    restless: Collection[int] = (),
    **retries: Callable[..., SettledScene],
) -> tuple[Scene, Refined]:
    """``refine`` with some retries; the others are in vain."""
    methods = dict.fromkeys(("stood_up", "balanced", "replaced", "realigned", "held"), in_vain)
    given = cast(Retries, SimpleNamespace(**methods | retries))
    return refine(start, config, aligned=aligned, parted=parted, retries=given, restless=restless)


def refined(start: Scene, tried: Scene, *, restless: Collection[int] = (), before: Collection[int] = ()) -> Scene:
    def again(_: Scene, ids: Collection[int], **_others: object) -> SettledScene:
        kept = [tried[o.id] if o.id in ids else o for o in start]
        return SettledScene(scene=start.with_objects(*kept), restless=frozenset(restless))

    return retried(start, ONCE, aligned=start, parted=start, realigned=again, restless=before)[0]


def test_the_one_that_gains_is_kept_and_the_one_that_loses_undone(seen: Scene):
    start = shifted(seen, {0: 0.03})
    after = refined(start, shifted(seen, {0: 0.0, 1: 0.03}))
    assert np.array_equal(after[0].T_world_object, seen[0].T_world_object)
    assert np.array_equal(after[1].T_world_object, seen[1].T_world_object)


def test_what_would_not_rest_is_not_kept_unless_it_did_not_before(seen: Scene):
    start = shifted(seen, {0: 0.03, 1: 0.03})
    after = refined(start, seen, restless=[1])
    assert np.array_equal(after[0].T_world_object, seen[0].T_world_object)
    assert np.array_equal(after[1].T_world_object, start[1].T_world_object)
    after = refined(start, seen, restless=[1], before=[1])
    assert np.array_equal(after[1].T_world_object, seen[1].T_world_object)


def test_one_that_hides_another_moves_with_it(seen: Scene):
    """The one in front gains nothing, but without its move the other gains nothing either."""
    scene = scene_of(box(0, at=(0, 0.3, 0.05)), box(1, size=(0.1, 0.1, 0.3), at=(0, -0.3, 0.15)))
    start, tried = (shifted(scene, {0: -0.003 * k, 1: 0.06 + 0.035 * k}) for k in (-1, 1))
    front, behind = (rasterizer.render(s.objects, s.camera).ids for s in (shifted(scene, {1: 0.06}), tried))
    masks = {0: behind == 0, 1: front == 1}
    start, tried = (s.with_objects(*(replace(o, mask=masks[o.id]) for o in s)) for s in (start, tried))
    was, now = (visible_ious(s) for s in (start, tried))
    assert now[0] > was[0] + 0.05 and abs(now[1] - was[1]) < 5e-4
    after = refined(start, tried)
    assert all(np.array_equal(after[id].T_world_object, tried[id].T_world_object) for id in (0, 1))


def test_one_that_spoils_its_group_is_left_out_and_the_other_tried_alone(seen: Scene):
    """The second goes where the first was, so that both share their fate, until the first is tried alone."""
    start = shifted(seen, {0: 0.03})
    calls: list[list[int]] = []

    def again(scene: Scene, ids: Collection[int], **_others: object) -> SettledScene:
        calls.append(list(ids))
        tried = shifted(seen, {0: 0.0, 1: -0.42})
        return SettledScene(scene=scene.with_objects(*(tried[id] for id in ids)), restless=frozenset())

    after, outcome = retried(start, ONCE, aligned=start, parted=start, realigned=again)
    assert calls == [[0, 1], [0]]
    assert [d.choice.rsplit(": ")[-1] for d in outcome.decisions] == ["rolled back", "accepted"]
    assert np.array_equal(after[0].T_world_object, seen[0].T_world_object)
    assert np.array_equal(after[1].T_world_object, seen[1].T_world_object)


def test_of_two_scenes_each_group_is_taken_where_it_rests_and_then_where_it_shows_more_of_its_masks(seen: Scene):
    first, second = shifted(seen, {0: 0.03}), shifted(seen, {1: 0.03})

    def best(a: Collection[int] = (), b: Collection[int] = ()) -> SettledScene:
        one, other = (SettledScene(scene=s, restless=frozenset(r)) for s, r in ((first, a), (second, b)))
        return one.or_better(other, ONCE.contact.apart)

    assert [np.array_equal(best().scene[id].T_world_object, seen[id].T_world_object) for id in (0, 1)] == [True, True]
    kept = best(b=[0])
    assert np.array_equal(kept.scene[0].T_world_object, first[0].T_world_object) and not kept.restless
    rested = best(a=[1])
    assert np.array_equal(rested.scene[1].T_world_object, second[1].T_world_object) and not rested.restless
    assert best(a=[0, 1], b=[0, 1]).restless == {0, 1}


@pytest.mark.parametrize("first", [True, False])
def test_of_two_scenes_a_group_is_taken_where_nothing_overlaps_whatever_it_shows(touching: Scene, first: bool):
    deep = touching.with_objects(touching[1].moved(pose(t=[-0.01, 0, 0]), stage="test", reason=""))
    ids = rasterizer.visible_ids(deep.objects, deep.camera)
    seen = deep.with_objects(*(replace(o, mask=ids == o.id) for o in deep))
    overlaps, apart = (SettledScene(scene=s, restless=frozenset()) for s in (seen, shifted(seen, {0: -0.05})))
    assert overlaps.score > apart.score + 0.1
    one, other = (overlaps, apart) if first else (apart, overlaps)
    best = one.or_better(other, ONCE.contact.apart)
    assert np.array_equal(best.scene[0].T_world_object, apart.scene[0].T_world_object)


def test_only_what_toppled_and_what_is_near_it_goes_back_to_before_physics(seen: Scene):
    fell = seen[0].moved(pose(rotation_about([1, 0, 0], np.pi / 2)), stage="test", reason="")
    start = seen.with_objects(fell, seen[1].moved(pose(t=[0.003, 0, 0]), stage="test", reason=""))
    asked: list[tuple[Scene, Collection[int], Collection[int]]] = []

    def stood_up(
        before: Scene, ids: Collection[int], *, start: Scene = start, moving: frozenset[int] = frozenset()
    ) -> SettledScene:
        asked.append((start, ids, moving))
        return SettledScene(scene=start, restless=frozenset())

    retried(start, NO_ROUND, aligned=start, parted=seen, stood_up=stood_up, replaced=stood_up, realigned=in_vain)
    [(scene, ids, moving)] = asked
    assert list(ids) == [0] and moving == {0} and scene[0] is seen[0] and scene[1] is start[1]


@pytest.mark.parametrize("degrees", [15, 30])
def test_what_toppled_and_still_lies_is_told(degrees: float):
    """But not where it came toppled already."""
    seen = side_by_side()
    tip = pose(rotation_about([1, 0, 0], np.radians(degrees)))
    fallen = seen.with_objects(seen[2].moved(tip, stage="test", reason=""))
    for parted, told in ((seen, [2] if degrees == 30 else []), (fallen, [])):
        _, outcome = retried(fallen, NO_ROUND, aligned=seen, parted=parted)
        assert [d.about for d in outcome.decisions if d.choice == "is not turned as the photo shows it"] == told


def test_what_an_equilibrium_shows_where_it_was_seen_is_not_stood_up():
    """Boxes side by side; one of them toppled, and the search leads both back."""
    seen = side_by_side()
    fell = seen[0].moved(pose(rotation_about([1, 0, 0], np.pi / 2), [0, 0.05, 0]), stage="test", reason="")
    start = seen.with_objects(fell)

    def balanced(before: Scene, *, start: Scene, moving: frozenset[int]) -> SettledScene:
        return SettledScene(scene=before.with_objects(*(seen[id] for id in moving)), restless=frozenset())

    parted = seen.with_objects(seen[0].moved(pose(rotation_about([0, 0, 1], 0.5)), stage="test", reason=""))
    after, _ = retried(
        start, NO_ROUND, aligned=seen, parted=parted, balanced=balanced, stood_up=lambda *_, **__: pytest.fail("asked")
    )
    assert after[0] is seen[0]


@pytest.fixture
def touching() -> Scene:
    """Two boxes side by side, the masks what the camera sees."""
    scene = scene_of(box(0, at=(-0.05, 0, 0.05)), box(1, at=(0.05, 0, 0.05)))
    ids = rasterizer.render(scene.objects, scene.camera).ids
    return scene.with_objects(*(replace(o, mask=ids == o.id) for o in scene))


@pytest.mark.parametrize("helps", [1, 2, None])
def test_a_group_that_contact_moved_off_its_masks_is_placed_again_until_it_meets_them(
    touching: Scene, helps: int | None
):
    """Once more only where the first place is a better one."""
    start, halved = (shifted(touching, {0: x, 1: x}) for x in (0.06, 0.03))
    asked: list[Scene] = []

    def replaced(before: Scene, *, start: Scene, moving: frozenset[int]) -> SettledScene:
        assert moving == {0, 1}
        asked.append(start)
        found = touching if len(asked) == helps else halved if helps else before
        return SettledScene(scene=found, restless=frozenset())

    def realigned(scene: Scene, _: Collection[int], **_others: object) -> SettledScene:
        return SettledScene(scene=scene, restless=frozenset())

    after, _ = retried(start, NO_ROUND, aligned=touching, parted=start, replaced=replaced, realigned=realigned)
    assert len(asked) == (helps or 1) <= RETURNS
    assert np.array_equal(after[0].T_world_object, (touching if helps else start)[0].T_world_object)
    eye = touching.camera.center
    for k, scene in enumerate(asked):
        for o in scene:
            there = touching[o.id]
            assert (o.scale == there.scale) == (k == 0)
            # Other distances, on the same viewing rays.
            assert o.bounds_world.mean(0) - eye == pytest.approx(o.scale * (there.bounds_world.mean(0) - eye))


def test_what_fell_away_is_placed_again_with_its_group(touching: Scene):
    start = shifted(touching, {1: 0.5})  # it touches nothing any more
    asked: list[Collection[int]] = []

    def replaced(_: Scene, *, moving: frozenset[int], **_others: object) -> SettledScene:
        asked.append(moving)
        return SettledScene(scene=touching, restless=frozenset())

    def realigned(scene: Scene, _: Collection[int], **_others: object) -> SettledScene:
        return SettledScene(scene=scene, restless=frozenset())

    after, _ = retried(start, NO_ROUND, aligned=touching, parted=start, replaced=replaced, realigned=realigned)
    assert asked == [{0, 1}]
    assert np.array_equal(after[1].T_world_object, touching[1].T_world_object)


def test_what_is_off_its_mask_is_at_last_re_aligned_alone_what_is_farthest_off_first(touching: Scene):
    """Together one spoils what the other gains; alone, each finds its mask."""
    start = shifted(touching, {0: 0.03, 1: 0.02})
    calls: list[list[int]] = []

    def again(scene: Scene, ids: Collection[int], **_others: object) -> SettledScene:
        calls.append(list(ids))
        tried = touching if len(ids) == 1 else shifted(touching, {0: 0.0, 1: 0.2})
        return SettledScene(scene=scene.with_objects(*(tried[id] for id in ids)), restless=frozenset())

    after, outcome = retried(start, NO_ROUND, aligned=touching, parted=start, realigned=again)
    assert calls == [[0], [1]]
    assert all(np.array_equal(after[k].T_world_object, touching[k].T_world_object) for k in (0, 1))
    assert [d.choice for d in outcome.decisions[-2:]] == [
        f"re-alignment under contact of object {id} alone: accepted" for id in (0, 1)
    ]


def test_what_was_re_aligned_alone_in_vain_is_not_tried_again(touching: Scene):
    """Together the second spoils what the first gains. Alone, the first ends farther off its mask."""
    start = shifted(touching, {0: 0.03})
    calls: list[list[int]] = []

    def again(scene: Scene, ids: Collection[int], **_others: object) -> SettledScene:
        calls.append(list(ids))
        there = shifted(touching, {0: 0.01, 1: 0.08} if len(ids) > 1 else {0: 0.05})
        return SettledScene(scene=scene.with_objects(*(there[id] for id in ids)), restless=frozenset())

    after, outcome = retried(start, ONCE, aligned=touching, parted=start, realigned=again)
    assert calls[:2] == [[0, 1], [0]] and calls.count([0]) == 1
    assert [d.choice for d in outcome.decisions].count("re-alignment under contact of object 0 alone: rolled back") == 1
    assert np.array_equal(after[0].T_world_object, start[0].T_world_object)


@pytest.mark.parametrize("leads", ["from where it rests", "from where it is placed again"])
def test_re_alignment_starts_from_both_places_and_the_better_end_is_kept(touching: Scene, leads: str):
    """Placing again halves the loss; one of the two starts leads on to the masks, the other nowhere."""
    start, halved = (shifted(touching, {0: x, 1: x}) for x in (0.06, 0.03))
    far = leads == "from where it rests"

    def replaced(*_: object, **_others: object) -> SettledScene:
        return SettledScene(scene=halved, restless=frozenset())

    def realigned(scene: Scene, _: Collection[int], **_others: object) -> SettledScene:
        is_far = np.array_equal(scene[0].T_world_object, start[0].T_world_object)
        return SettledScene(scene=touching if is_far == far else scene, restless=frozenset())

    after, outcome = retried(start, ONCE, aligned=touching, parted=start, replaced=replaced, realigned=realigned)
    assert all(np.array_equal(after[k].T_world_object, touching[k].T_world_object) for k in (0, 1))
    assert any("placed again" in d.choice for d in outcome.decisions) != far


def test_what_stands_alone_or_loses_little_by_contact_is_not_placed_again(seen: Scene, touching: Scene):
    def never(*_: object, **_others: object) -> SettledScene:
        raise AssertionError

    def realigned(scene: Scene, ids: Collection[int], **_others: object) -> SettledScene:
        assert scene[0].mask is seen[0].mask and len(ids) == 1  # what stands alone is re-aligned alone
        return SettledScene(scene=scene, restless=frozenset())

    for aligned, x in ((seen, 0.03), (touching, 0.0005)):
        start = shifted(aligned, {0: x, 1: x})
        retried(start, NO_ROUND, aligned=aligned, parted=start, stood_up=never, replaced=never, realigned=realigned)


def test_a_round_without_gain_is_the_last(seen: Scene):
    calls: list[Collection[int]] = []

    def again(scene: Scene, ids: Collection[int], **_others: object) -> SettledScene:
        calls.append(ids)
        return SettledScene(scene=scene, restless=frozenset())

    scene, outcome = retried(seen, RefineConfig(), aligned=seen, parted=seen, realigned=again)
    assert scene is seen and len(calls) == 1
    assert [d.choice for d in outcome.decisions] == ["re-alignment under contact: rolled back"]


def test_what_gained_much_is_tried_again_and_what_gained_little_is_not(seen: Scene, monkeypatch: pytest.MonkeyPatch):
    start, calls = shifted(seen, {0: 0.03, 1: 0.03}), list[list[int]]()
    off = {0: 0.02, 1: 0.008}

    def ious(scene: Scene) -> dict[int, float]:
        return {o.id: 0.9 - off[o.id] * (o.T_world_object is start[o.id].T_world_object) for o in scene}

    def again(scene: Scene, ids: Collection[int], **_others: object) -> SettledScene:
        calls.append(list(ids))
        return SettledScene(scene=scene.with_objects(*(seen[id] for id in ids)), restless=frozenset())

    monkeypatch.setattr(contact_groups, "visible_ious", ious)
    retried(start, RefineConfig(), aligned=seen, parted=start, realigned=again)
    assert calls == [[0, 1], [0]]


@pytest.mark.parametrize("source", ["sensor", "estimate"])
def test_a_measured_depth_outweighs_a_few_pixels(seen: Scene, source: GeometrySource):
    """What moves along its viewing rays is seen as before: only a sensor knows that it is in the wrong place."""
    scene = measured(seen, source)
    camera, away = scene.camera, 1.02
    far = scene[0].moved(camera.homothety(away), scale=away, stage="test", reason="")
    tried = scene.with_objects(far)
    start, after = (SettledScene(scene=s, restless=frozenset()) for s in (scene, tried))
    assert after.ious[0] == pytest.approx(start.ious[0], abs=2e-3)
    shift = 0.02 * np.linalg.norm(scene[0].bounds_world.mean(0) - camera.center) / scene[0].size
    lost = 4 * shift if source == "sensor" else 0.0
    assert start.scores[0] - after.scores[0] == pytest.approx(lost, rel=0.1, abs=3e-3)
    wrong = shifted(tried, {1: 0.03})
    kept = refined(wrong, shifted(scene, {0: 0.001}))
    assert np.allclose(kept[0].T_world_object, scene[0].T_world_object, atol=2e-3) == (source == "sensor")


def test_a_measured_depth_outweighs_no_mask(seen: Scene):
    """Nearer to its measured depth, but beside its mask."""
    scene = measured(seen, "sensor")
    camera, away = scene.camera, 1.1
    start = scene.with_objects(scene[0].moved(camera.homothety(away), scale=away, stage="test", reason=""))
    tried = shifted(scene, {0: 0.012})
    a, b = (SettledScene(scene=s, restless=frozenset()) for s in (start, tried))
    assert b.scores[0] > a.scores[0] + 0.1 and 0.05 < a.ious[0] - b.ious[0] < 0.3
    assert np.array_equal(refined(start, tried)[0].T_world_object, start[0].T_world_object)


def test_a_retry_moves_the_group_that_gains_and_holds_the_rest(seen: Scene):
    start = shifted(seen, {0: 0.03})
    aligned = shifted(seen, {0: 0.0, 1: 0.03})
    retry = Retry.of(start, aligned, [0, 1], ONCE.contact)
    assert retry.moving == {0}
    assert np.array_equal(retry.scene[0].T_world_object, seen[0].T_world_object)
    assert np.array_equal(retry.scene[1].T_world_object, start[1].T_world_object)
    assert retry.scene[1].mobility == "fixed"
    ended = retry.ended(SettledScene(scene=retry.scene, restless=frozenset()), ONCE.contact, settled=unasked)
    assert ended.scene[1].mobility == "dynamic" and not ended.restless


def test_a_group_moves_as_a_whole(seen: Scene):
    """The second loses by its alignment, but leaves the room that the first needs."""
    near = shifted(seen, {1: -0.3995})
    ids = rasterizer.render(near.objects, near.camera).ids
    near = near.with_objects(*(replace(o, mask=ids == o.id) for o in near))
    start = shifted(near, {0: -0.03})
    aligned = shifted(start, {0: 0.03, 1: 0.0002})
    retry = Retry.of(start, aligned, [0, 1], ONCE.contact)
    assert retry.moving == {0, 1}
    assert all(np.array_equal(retry.scene[k].T_world_object, aligned[k].T_world_object) for k in (0, 1))


def test_of_a_group_that_loses_as_a_whole_only_what_gains_is_aligned(touching: Scene):
    """The first gains less than the second loses. Where the first loses too, both are held."""
    start = shifted(touching, {0: 0.03})
    aligned = shifted(touching, {0: 0.01, 1: 0.06})
    retry = Retry.of(start, aligned, [0, 1], ONCE.contact)
    assert retry.moving == {0, 1}
    assert np.array_equal(retry.scene[0].T_world_object, aligned[0].T_world_object)
    assert np.array_equal(retry.scene[1].T_world_object, start[1].T_world_object)
    assert not Retry.of(start, shifted(touching, {0: 0.05, 1: 0.06}), [0, 1], ONCE.contact).moving


@pytest.mark.parametrize("restless", [[], [1]])
def test_what_came_to_touch_a_held_object_is_settled_with_it(seen: Scene, restless: list[int]):
    """It came to rest beside something that was held. Free, both stay, or not."""
    start = shifted(seen, {0: 0.03})
    retry = Retry.of(start, shifted(seen, {0: 0.0}), [0], ONCE.contact)
    touching = retry.scene.with_objects(retry.scene[0].moved(pose(t=[0.4, 0, 0]), stage="test", reason=""))
    asked: list[dict[int, str]] = []

    def settled(scene: Scene) -> SettledScene:
        asked.append({o.id: o.mobility for o in scene})
        moved = [o.moved(pose(t=[0, 0.01, 0]), stage="settle", reason="") for o in scene]
        return SettledScene(scene=scene.with_objects(*moved), restless=frozenset(restless))

    ended = retry.ended(SettledScene(scene=touching, restless=frozenset()), ONCE.contact, settled=settled)
    assert asked == [{0: "dynamic", 1: "dynamic"}] and ended.restless == set(restless)
    assert all(ended.scene[k].T_world_object[1, 3] == touching[k].T_world_object[1, 3] + 0.01 for k in (0, 1))


def test_a_group_that_lost_much_is_put_back_before_its_gaps_are_closed(seen: Scene):
    start = shifted(seen, {0: 0.03})
    retry = Retry.of(start, shifted(seen, {0: 0.0}), [0], ONCE.contact)
    fallen = retry.scene.with_objects(shifted(seen, {0: -0.2})[0])
    lost = SettledScene(scene=fallen, restless=frozenset())
    back = retry.without_losers(lost, ONCE.contact)
    assert not back.moving
    assert np.array_equal(back.scene[0].T_world_object, start[0].T_world_object)


def test_after_two_that_gained_nothing_alone_the_others_are_left():
    scene = scene_of(*(box(k, at=(0.25 * k - 0.5, 0, 0.05)) for k in range(5)))
    ids = rasterizer.render(scene.objects, scene.camera).ids
    scene = scene.with_objects(*(replace(o, mask=ids == o.id) for o in scene))
    start = shifted(scene, {k: 0.02 + 0.004 * k for k in range(5)})
    alone: list[int] = []

    def tried(helped: int | None) -> list[int]:
        """The objects that are re-aligned alone where only the ``helped``-th of them gains."""
        alone.clear()

        def realigned(now: Scene, ids: Collection[int], **_others: object) -> SettledScene:
            alone.extend(ids)
            found = [scene[id] for id in ids if len(alone) == helped]
            return SettledScene(scene=now.with_objects(*found), restless=frozenset())

        retried(start, NO_ROUND, aligned=scene, parted=start, stood_up=never, replaced=never, realigned=realigned)
        return alone

    def never(*_: object, **_others: object) -> SettledScene:
        raise AssertionError

    assert len(tried(helped=2)) == 4, "the second one gains, so the count begins anew"
    assert len(tried(helped=None)) == 2


@pytest.mark.parametrize("ground", [0.0, 0.04])
def test_what_contact_moved_off_its_masks_is_balanced_first_from_where_the_photo_shows_it(
    touching: Scene, ground: float
):
    """Also where the ground has moved since, under the camera and all objects."""
    lower = pose(t=[0, 0, -ground])
    moved = tuple(o.moved(lower, stage="test", reason="") for o in touching)
    aligned = replace(touching, objects=moved, camera=touching.camera.moved(lower @ touching.camera.T_world_camera))
    start = shifted(touching, {0: 0.06, 1: 0.06})

    def balanced(before: Scene, *, start: Scene, moving: frozenset[int]) -> SettledScene:
        assert before is not start and moving == {0, 1}
        return SettledScene(scene=start, restless=frozenset())

    def never(*_: object, **_others: object) -> SettledScene:
        raise AssertionError

    def realigned(scene: Scene, _: Collection[int], **_others: object) -> SettledScene:
        return SettledScene(scene=scene, restless=frozenset())

    after, outcome = retried(
        start, NO_ROUND, aligned=aligned, parted=start, stood_up=never, balanced=balanced, replaced=never,
        realigned=realigned,
    )  # fmt: skip
    assert outcome.decisions[0].choice == "moved to the nearest equilibrium: objects 0 and 1: accepted"
    for o in after:
        assert o.T_world_object == pytest.approx(touching[o.id].T_world_object, abs=1e-12)


@pytest.mark.parametrize("helps", [True, False])
def test_what_is_in_balance_is_balanced_again_after_re_alignment(touching: Scene, helps: bool):
    """And what has not gone to an equilibrium is not."""
    start = shifted(touching, {0: 0.06, 1: 0.06})
    told: list[frozenset[int]] = []

    def balanced(before: Scene, *, start: Scene, moving: frozenset[int]) -> SettledScene:
        return SettledScene(scene=start if helps else before, restless=frozenset())

    def realigned(scene: Scene, _: Collection[int], *, balanced: frozenset[int]) -> SettledScene:
        told.append(balanced)
        return SettledScene(scene=scene, restless=frozenset())

    retried(
        start, ONCE, aligned=touching, parted=start, balanced=balanced,
        realigned=realigned,
    )  # fmt: skip
    assert told and set(told) == {frozenset({0, 1}) if helps else frozenset()}


def test_a_friction_that_was_raised_is_told(touching: Scene):
    start = shifted(touching, {0: 0.06, 1: 0.06})

    def balanced(_: Scene, *, start: Scene, moving: frozenset[int]) -> SettledScene:
        rough = start.with_objects(replace(start[1], friction=0.8))
        return SettledScene(scene=rough, restless=frozenset())

    after, outcome = retried(start, NO_ROUND, aligned=touching, parted=start, balanced=balanced)
    assert after[1].friction == 0.8
    assert [(d.about, d.choice) for d in outcome.decisions if d.about is not None] == [(1, "friction 0.6 -> 0.8")]


@pytest.mark.parametrize("before", [False, True])
def test_what_overlaps_is_not_kept_unless_it_did_before(touching: Scene, before: bool):
    """However well it shows the photo."""
    deep = touching.with_objects(touching[1].moved(pose(t=[-0.01, 0, 0]), stage="test", reason=""))
    ids = rasterizer.visible_ids(deep.objects, deep.camera)
    seen = deep.with_objects(*(replace(o, mask=ids == o.id) for o in deep))
    start = shifted(seen, {0: 0.06, 1: 0.06 if before else 0.09})
    tried = SettledScene(scene=seen, restless=frozenset())
    assert tried.overlapping == {0, 1}

    def balanced(_: Scene, **_others: object) -> SettledScene:
        return tried

    after, outcome = retried(start, NO_ROUND, aligned=seen, parted=start, balanced=balanced)
    assert (after[0] is seen[0]) == before
    assert outcome.decisions[0].reason.endswith("overlapping: objects 0 and 1") != before


@pytest.mark.parametrize(
    ("slides", "count", "is_kept"),
    [(FAR, 1, True), (FAR, 2, True), (NEAR, 1, True), (NEAR, 2, False), (FAR, 0, False)],
)
def test_where_contact_leaves_a_group_far_off_its_masks_what_must_hang_is_held_and_told(
    slides: tuple[float, float], count: int, is_kept: bool
):
    """Boxes side by side have slid out of their masks; ``count`` of them are held there, each for .2 of IoU."""
    seen = side_by_side()
    start = shifted(seen, {0: -slides[0], 1: slides[1]})
    asked = list[frozenset[int]]()

    def held(before: Scene, *, start: Scene, moving: frozenset[int], most: int) -> SettledScene:
        asked.append(moving)
        assert most == (2 if slides == FAR else 1), "half of all, or as many as their masks may win"
        assert all(np.array_equal(start[id].T_world_object, seen[id].T_world_object) for id in moving)
        objects = (start[id].on_something_unseen() if id < count else start[id] for id in (0, 1))
        return SettledScene(scene=before.with_objects(*objects), restless=frozenset())

    after, outcome = retried(start, NO_ROUND, aligned=seen, parted=start, held=held)
    assert asked == [frozenset({0, 1})]
    assert [after[id].mobility for id in (0, 1)] == [
        ("fixed" if is_kept and id < count else "dynamic") for id in (0, 1)
    ]
    told = [d for d in outcome.decisions if d.fallback]
    assert [d.about for d in told] == (list(range(count)) if is_kept else [])
    assert all("kept fixed" in d.choice and "rises by" in d.reason for d in told)
    assert is_kept or outcome.decisions[-1].choice.endswith("rolled back" if count else "none")


def side_by_side(source: GeometrySource = "estimate", *, height: float = 0.05) -> Scene:
    """Two boxes, with two far away that rest, as the photo shows them."""
    beside = (box(0, at=(-0.0502, 0, height)), box(1, at=(0.0502, 0, height)))
    return measured(scene_of(*beside, *(box(id, at=(x, 0, 0.05)) for id, x in ((2, 0.25), (3, -0.25)))), source)


def held_as_seen(before: Scene, *, start: Scene, moving: frozenset[int], most: int) -> SettledScene:
    objects = (start[id].on_something_unseen() if id == 0 and most else start[id] for id in moving)
    return SettledScene(scene=before.with_objects(*objects), restless=frozenset())


def test_nothing_is_held_whose_distance_only_its_input_tells():
    for seen in (side_by_side("ground"), replace(side_by_side(), geometry=None)):
        start = shifted(seen, {0: -0.03, 1: 0.03})
        after, _ = retried(start, NO_ROUND, aligned=seen, parted=start, held=held_as_seen)
        assert all(o.mobility == "dynamic" for o in after)


def test_nothing_is_held_whose_mobility_is_given():
    seen = side_by_side()
    seen = seen.with_objects(*(replace(seen[id], mobility_source="given") for id in (0, 1)))
    start = shifted(seen, {0: -0.03, 1: 0.03})
    after, _ = retried(start, NO_ROUND, aligned=seen, parted=start, held=held_as_seen)
    assert all(o.mobility == "dynamic" for o in after)


def test_nothing_is_held_below_the_ground():
    seen = side_by_side(height=0.04)
    start = shifted(seen, {0: -0.03, 1: 0.03})
    after, outcome = retried(start, NO_ROUND, aligned=seen, parted=start, held=held_as_seen)
    assert all(o.mobility == "dynamic" for o in after) and "above the ground" in outcome.decisions[-1].reason


def test_where_most_would_be_held_none_is():
    seen = side_by_side()
    seen = replace(seen, objects=seen.objects[:1])
    start = shifted(seen, {0: -0.03})
    after, _ = retried(start, NO_ROUND, aligned=seen, parted=start, held=held_as_seen)
    assert after[0].mobility == "dynamic"


@pytest.mark.parametrize(("farther", "aside", "is_kept"), [(1.05, 0.003, False), (1.08, 0.003, True), (1.08, 0, False)])
def test_what_lies_elsewhere_is_held_though_it_shows_most_of_its_mask(farther: float, aside: float, is_kept: bool):
    """But for what shows all of its mask there: it may be the depth that is wrong, so that is told."""
    seen = side_by_side()
    T = seen.camera.homothety(farther)
    away = seen[2].moved(T, scale=farther, stage="test", reason="")
    start = seen.with_objects(away.moved(pose(t=[aside, 0, 0]), stage="test", reason=""))
    lost = visible_ious(seen)[2] - visible_ious(start)[2]
    assert HOPELESS < lost < UNSEEN if aside else lost < HOPELESS

    def held(before: Scene, *, start: Scene, moving: frozenset[int], most: int) -> SettledScene:
        assert moving == {2} and most == 1
        return SettledScene(scene=before.with_objects(start[2].on_something_unseen()), restless=frozenset())

    after, outcome = retried(start, NO_ROUND, aligned=seen, parted=start, held=held)
    assert (after[2].mobility == "fixed") == is_kept
    assert [d.about for d in outcome.decisions if d.fallback] == ([2] if farther == 1.08 else [])
    assert not is_kept or "object 2 would lie elsewhere" in outcome.decisions[-1].reason


def test_a_group_that_needs_more_than_it_may_have_leaves_another_its_hold():
    seen = side_by_side()
    start = shifted(seen, {0: -NEAR[0], 1: NEAR[1], 2: 0.1})

    def held(before: Scene, *, start: Scene, moving: frozenset[int], most: int) -> SettledScene:
        """Every object needs to be held."""
        objects = [start[id].on_something_unseen() for id in moving] if len(moving) <= most else []
        return SettledScene(scene=before.with_objects(*objects), restless=frozenset())

    after, outcome = retried(start, NO_ROUND, aligned=seen, parted=start, held=held)
    assert [o.id for o in after if o.mobility == "fixed"] == [2]
    assert [d.about for d in outcome.decisions if d.fallback] == [2]


def test_what_geometry_holds_counts_for_half_of_all():
    seen = side_by_side()
    seen = seen.with_objects(*(seen[id].on_something_unseen() for id in (2, 3)))
    start = shifted(seen, {0: -FAR[0], 1: FAR[1]})
    after, outcome = retried(start, NO_ROUND, aligned=seen, parted=start, held=held_as_seen)
    assert [o.id for o in after if o.mobility == "fixed"] == [2, 3]
    assert outcome.decisions[-1].choice.endswith("none") and "too many" in outcome.decisions[-1].reason


@pytest.mark.parametrize(("supported_by", "most"), [(None, 1), (GROUND, 2)])
def test_more_than_half_may_be_held_where_one_stands_on_the_ground_as_seen(supported_by: int | None, most: int):
    seen = side_by_side()
    seen = seen.with_objects(seen[2].on_something_unseen(), replace(seen[3], supported_by=supported_by))
    asked = list[int]()

    def held(before: Scene, *, start: Scene, moving: frozenset[int], most: int) -> SettledScene:
        asked.append(most)
        return SettledScene(scene=before, restless=frozenset())

    retried(shifted(seen, {0: -FAR[0], 1: FAR[1]}), NO_ROUND, aligned=seen, parted=seen, held=held)
    assert asked == [most]


@pytest.mark.parametrize(("farther", "aside"), [(1.05, 0.003), (1.08, 0.003), (1.08, 0.0)])
def test_what_lies_elsewhere_at_last_is_told(farther: float, aside: float):
    seen = side_by_side().with_objects(replace(side_by_side()[2], mobility_source="given"))
    away = seen[2].moved(seen.camera.homothety(farther), scale=farther, stage="test", reason="")
    start = seen.with_objects(away.moved(pose(t=[aside, 0, 0]), stage="test", reason=""))
    _, outcome = retried(start, NO_ROUND, aligned=seen, parted=start)
    told = [(d.about, d.choice) for d in outcome.decisions if d.fallback]
    assert told == ([(2, "is not as far away as the photo shows it")] if farther == 1.08 else [])


def test_what_is_held_must_rest_and_overlap_nothing(seen: Scene):
    seen = measured(seen, "estimate")
    start = shifted(seen, {0: 0.1})

    def held(before: Scene, *, start: Scene, moving: frozenset[int], most: int) -> SettledScene:
        return replace(held_as_seen(before, start=start, moving=moving, most=most), restless=frozenset({0}))

    after, outcome = retried(start, NO_ROUND, aligned=seen, parted=start, held=held)
    assert after[0].mobility == "dynamic" and not any(d.fallback for d in outcome.decisions)
