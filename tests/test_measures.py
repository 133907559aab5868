"""The measures against closed forms: what is seen, what pierces, what lies inside, and what proxies miss."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from f3sr.core.mesh import ConvexPart, Material, Mesh
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array, rotation_about
from f3sr.metrics.measures import (
    SAMPLES,
    Measures,
    full_silhouette,
    gaps_of,
    image_agreement,
    mean_over_masks,
    points_inside,
    proxy_distances,
    visible_ious,
)
from f3sr.scene import GROUND, Excluded, Photo, Scene
from scenes import ball_mesh, box, scene_of


def half_masked() -> Scene:
    """A box whose mask is the left half of its silhouette, and its bottom half beyond it, on a grey photo."""
    o = box(1, at=(0, 0, 0.3), size=(0.4, 0.1, 0.4))
    scene = scene_of(o)
    mask = full_silhouette(o, scene.camera)
    columns = np.flatnonzero(mask.any(0))
    mask[:, columns[len(columns) // 2] :] = False
    grey = Photo(rgb=np.full((*mask.shape, 3), 102, np.uint8))
    return replace(scene.with_objects(replace(o, mask=mask)), photo=grey)


def test_half_a_silhouette_is_an_iou_of_one_half() -> None:
    scene = half_masked()
    full, visible, _ = image_agreement(scene)
    share = np.count_nonzero(scene[1].mask) / np.count_nonzero(full_silhouette(scene[1], scene.camera))
    assert full == visible == [share] and share == pytest.approx(0.5, abs=0.03)
    excluded = replace(scene, excluded=(Excluded(mask="a.png", reason="a test"),))
    assert mean_over_masks(visible_ious(excluded), excluded) == share / 2, "an excluded mask counts 0"


@pytest.mark.parametrize(("colour", "decibel"), [(0.5, 20.0), (0.41, 40.0)])
def test_a_constant_error_of_a_tenth_is_20_db(colour: float, decibel: float) -> None:
    """The photo is .4 grey; each tenth of an error is 20 dB."""
    scene = half_masked()
    mesh = replace(scene[1].mesh, materials=(Material(base_color=(colour,) * 3),))
    painted = scene.with_objects(replace(scene[1], mesh=mesh))
    assert image_agreement(painted)[2] == pytest.approx(decibel, abs=1e-6)


def test_mask_pixels_without_an_object_are_black() -> None:
    scene = half_masked()
    mesh = replace(scene[1].mesh, materials=(Material(base_color=(0.4,) * 3),))
    beside = np.zeros_like(scene[1].mask)
    beside[:3, :3] = True
    painted = scene.with_objects(replace(scene[1], mesh=mesh, mask=scene[1].mask | beside))
    share = 9 / np.count_nonzero(painted[1].mask)
    assert image_agreement(painted)[2] == pytest.approx(-10 * np.log10(share * 0.4**2), abs=1e-6)


def test_every_fortieth_vertex_of_a_ball_in_a_box_is_inside() -> None:
    ball = replace(box(2, at=(0, 0, 0.2)), mesh=ball_mesh(0.05))
    around = box(1, size=(0.4, 0.4, 0.4), at=(0, 0, 0.2))
    expected = len(range(0, len(ball.mesh.vertices), 40))
    assert points_inside([around, ball]) == expected > 5
    assert points_inside([box(1, at=(1, 0, 0.05)), ball]) == 0
    lidless = Mesh(vertices=around.mesh.vertices, faces=around.mesh.faces[2:])
    assert points_inside([replace(around, mesh=lidless), ball]) == 0, "what is open has no inside"


def part(size: Array) -> ConvexPart:
    return ConvexPart.hull_of(size / 2 * (np.array(list(np.ndindex(2, 2, 2))) * 2 - 1))


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_a_larger_and_a_smaller_proxy_are_told_in_shares_of_the_size(scale: float) -> None:
    size, beyond = np.array([0.2, 0.2, 0.2]), np.array([0, 0, 0.04])
    o = box(1, size=size.tolist(), at=(0, 0, 0.1), scale=scale)
    out, far = proxy_distances(replace(o, parts=(part((size - beyond) / scale),)))
    assert out == pytest.approx(0.02 / o.size) and far < 0.01 / o.size
    out, far = proxy_distances(replace(o, parts=(part((size + 0.04) / scale),)))
    assert out == 0 and 0.02 <= far * o.size <= 0.02 * np.sqrt(3), "the faces of the proxy lie .02 m off the mesh"


def test_a_cap_that_sticks_out_is_told_however_small_it_is() -> None:
    ball = ball_mesh(0.05)
    low = np.minimum(ball.vertices, [1, 1, 0.04])
    o = replace(box(1, at=(0, 0, 0.1)), mesh=ball, parts=(ConvexPart.hull_of(low),))
    assert np.mean(ball.vertices[:, 2] > 0.04) < 0.25
    assert proxy_distances(o)[0] * o.size == pytest.approx(0.01, abs=5e-4)


@pytest.mark.parametrize("seed", range(3))
def test_the_gap_is_that_to_the_nearest_of_all(seed: int) -> None:
    """Against all pairs: boxes about the objects, which may lie in each other, leave none out."""
    rng = np.random.default_rng(seed)
    places = rng.uniform([-0.1, -0.1, 0.1], [0.1, 0.1, 0.3], (4, 3))
    objects = [box(k, at=at, R=rotation_about(rng.normal(size=3), 1.0)) for k, at in enumerate(places)]
    points = [
        np.concatenate([o.vertices_world, sample_surface(o.vertices_world, o.mesh.faces, SAMPLES)]) for o in objects
    ]
    trees = {k: KDTree(p) for k, p in enumerate(points)}
    for gap, own in zip(gaps_of(objects), points, strict=True):
        between = {GROUND: own[:, 2].min()}
        others = (k for k in trees if k != gap.id)
        between |= {k: trees[k].query(own[::7], distance_upper_bound=between[GROUND])[0].min() for k in others}
        assert (gap.nearest, gap.distance) == min(between.items(), key=lambda item: item[1])


def test_a_gap_leads_from_the_one_to_the_other() -> None:
    """A ball beside a turned box: the nearest points are on one line with the ball's middle."""
    ball = replace(box(1, at=(0.2, 0, 0.2)), mesh=ball_mesh(0.05))
    other = box(2, at=(0, 0, 0.2), R=rotation_about([1, 2, 3], 0.5))
    gap = next(g for g in gaps_of([ball, other]) if g.id == 1)
    start, end = np.array(gap.start), np.array(gap.end)
    assert gap.nearest == 2 and np.linalg.norm(start - end) == pytest.approx(gap.distance, rel=1e-9)
    assert np.linalg.norm(start - [0.2, 0, 0.2]) == pytest.approx(0.05, abs=5e-4), "on the ball"
    local = (end - [0, 0, 0.2]) @ rotation_about([1, 2, 3], 0.5)
    assert np.abs(local).max() == pytest.approx(0.05), "on the box"


def test_samples_lie_in_the_triangle_and_about_its_middle() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    points = sample_surface(corners, np.array([[0, 1, 2]], np.int32), 5000)
    assert (points >= 0).all() and (points.sum(1) <= 1 + 1e-12).all()
    assert points.mean(0) == pytest.approx([1 / 3, 1 / 3, 0], abs=0.01)


def test_every_row_of_the_printed_table_is_defined_on_its_page() -> None:
    page = (Path(__file__).parents[1] / "docs" / "measures.md").read_text()
    rows = [name for names in re.findall(r"^\| (\w[\w, ]*) \|", page, re.MULTILINE) for name in names.split(", ")]
    assert rows == ["measure", *Measures.__dataclass_fields__]
