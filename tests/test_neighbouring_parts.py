"""What is around an object: the quick looks of ``are_apart`` decide as exact distances between all parts do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from f3sr.contact.polytopes import Polytope, separation
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array, pose, transform
from f3sr.proxies.hulls import planes
from f3sr.proxies.neighbouring_parts import NeighbouringParts
from f3sr.scene import SceneObject
from scenes import box

REACH = 0.02
MIDDLE = np.array([0.02, 0.01, 0.1])


def scattered(seed: int, count: int) -> list[ConvexPart]:
    """Hulls of 2 to 12 cm that overlap or nearly do."""
    rng = np.random.default_rng(seed)
    clouds = (rng.normal(size=(12, 3)) * rng.uniform(0.01, 0.03) + rng.uniform(-0.06, 0.06, 3) for _ in range(count))
    return [ConvexPart.hull_of(cloud) for cloud in clouds]


def turned(scale: float) -> SceneObject:
    """An object that is neither upright nor of scale 1."""
    R = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    return replace(box(0), T_world_object=pose(R * np.linalg.det(R), MIDDLE), scale=scale)


def placed(parts: Sequence[ConvexPart]) -> list[Polytope]:
    """Parts of other bodies, about the object."""
    return [Polytope.of(part).shifted(MIDDLE) for part in parts]


def exact(o: SceneObject, part: ConvexPart, others: Sequence[Polytope]) -> Array:
    """Distances from other parts and from the ground."""
    body = Polytope.of(part).moved(o.T_world_asset)
    return np.array([*(separation(body, other) for other in others), body.vertices[:, 2].min()])


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000), scale=st.floats(0.5, 2), nearer=st.floats(1e-8, 0.01), sign=st.sampled_from([-1, 1])
)
def test_apart_is_what_exact_distances_say(seed: int, scale: float, nearer: float, sign: int) -> None:
    part, *rest = scattered(seed, 12)
    o = turned(scale)
    around = NeighbouringParts(o, placed(rest), within=1.0, reach=REACH)
    distances = exact(o, part, around.parts)
    allowed = np.minimum(distances - sign * nearer, REACH)
    assert around.are_apart(part, planes(part), allowed) == bool((np.minimum(distances, REACH) >= allowed).all())
    np.testing.assert_allclose(around.gaps(part), np.minimum(distances, REACH), atol=1e-12)


@pytest.mark.parametrize("k", range(4))
def test_one_part_that_is_too_near_is_enough(k: int) -> None:
    """One that is nearer than allowed by a micrometre, among parts that are as far as allowed."""
    part, *rest = scattered(k, 12)
    o = turned(1.0)
    around = NeighbouringParts(o, placed(rest), within=1.0, reach=REACH)
    gaps = around.gaps(part)
    asked = gaps - 1e-9
    assert around.are_apart(part, planes(part), asked)
    asked[int(gaps[:-1].argmin())] += 1e-6
    assert not around.are_apart(part, planes(part), asked)


def test_nothing_around_leaves_the_ground() -> None:
    part, o = scattered(1, 1)[0], turned(1.0)
    around = NeighbouringParts(o, (), within=1.0, reach=REACH)
    height = float(Polytope.of(part).moved(o.T_world_asset).vertices[:, 2].min())
    assert around.are_apart(part, planes(part), np.array([height]))
    assert not around.are_apart(part, planes(part), np.array([height + 1e-6]))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), scale=st.floats(0.5, 2), deeper=st.floats(0, 0.01))
def test_what_is_between_two_parts_forbids_one_hull_for_both(seed: int, scale: float, deeper: float) -> None:
    """Segments that pass deep enough through a part, by points on them; a hull of both ends is never free then."""
    parts = scattered(seed, 14)
    (first, *others), rest = parts[:6], parts[6:]
    o = turned(scale)
    around = NeighbouringParts(o, placed(rest), within=1.0, reach=REACH)
    gaps = around.gaps(first)
    allowed = np.array([np.minimum(gaps, around.gaps(other)) - deeper for other in others])
    start, ends = first.vertices.mean(0), np.array([other.vertices.mean(0) for other in others])
    found = around.are_between(start, ends, allowed)
    for is_between, end, other, least in zip(found, ends, others, allowed, strict=True):
        hull = ConvexPart.hull_of(np.concatenate([first.vertices, other.vertices]))
        assert not (is_between and around.are_apart(hull, planes(hull), least))
        points = transform(o.T_world_asset, start + np.linspace(0, 1, 400)[:, None] * (end - start))
        depths = np.array([(p.offsets - points @ p.normals.T).min(1).max() for p in around.parts])
        needed = np.maximum(-least[:-1], 0)
        if (depths > needed + 1e-8).any():
            assert is_between
        if (depths < needed - 1e-3 * scale).all():
            assert not is_between
