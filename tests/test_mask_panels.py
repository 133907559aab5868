"""Laws of the panels that show one object against its mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from f3sr.core.transforms import pose
from f3sr.metrics.measures import full_silhouette
from f3sr.report_page.mask_panels import mask_panels
from f3sr.scene import Photo, Scene, SceneObject
from f3sr.vision.occlusion import nearer_objects
from f3sr.vision.pictures import BOTH, MASK_ONLY, RENDER_ONLY, TINT
from f3sr.vision.silhouette import iou, union_of
from folders import boxes, camera

GREY = 128
EYE = camera().resized(384, 288)


def scene() -> Scene:
    """The boxes of the test folder with the masks they have in the picture, on grey."""
    from f3sr.vision import rasterizer

    ids = rasterizer.render(boxes(), EYE).ids
    rgb = np.full((EYE.height, EYE.width, 3), GREY, np.uint8)
    return Scene(photo=Photo(rgb=rgb), camera=EYE, objects=tuple(replace(o, mask=ids == o.id) for o in boxes()))


def shifted(s: Scene, id: int, by: tuple[float, float, float]) -> Scene:
    return s.with_objects(s[id].moved(pose(t=by), stage="test", reason="shifted"))


def panels(s: Scene, *states: Scene, id: int, nearer: Sequence[SceneObject] = (), longest: int = 200):
    hidden = union_of((p.mask for p in nearer), s[id].mask.shape)
    return mask_panels(id, [s, *states], hidden, longest=longest, drawn=range(1 + len(states)))


def tinted(color: tuple[int, int, int]) -> np.ndarray:
    return np.round((1 - TINT) * GREY + TINT * np.array(color))


def share_of(picture: np.ndarray, color: tuple[int, int, int]) -> float:
    return float((np.abs(picture.astype(float) - tinted(color)).max(2) < 2).mean())


def test_colours_are_mask_red_render_green_both_blue_in_their_right_shares():
    s = scene()
    moved = shifted(s, 7, (0.05, 0, 0))
    found = panels(s, moved, id=7)
    exact, off = found.pictures
    assert share_of(exact, BOTH) > 0.2 and share_of(exact, MASK_ONLY) == share_of(exact, RENDER_ONLY) == 0
    red, green, blue = (share_of(off, c) for c in (MASK_ONLY, RENDER_ONLY, BOTH))
    assert red > 0.02 and green > 0.02
    assert blue / (red + green + blue) == pytest.approx(found.ious[1], abs=0.02)
    assert found.ious[0] == 1 and exact.shape == off.shape and max(exact.shape) == 200


def test_numbers_are_those_of_whole_images():
    s = scene()
    nearer = nearer_objects(s)
    for o in s:
        moved = shifted(s, o.id, (0.02, -0.01, 0.0))
        hidden = np.zeros_like(o.mask)
        for p in nearer[o.id]:
            hidden |= p.mask
        found = panels(s, moved, id=o.id, nearer=nearer[o.id])
        for state, value, share in zip((s, moved), found.ious, found.hidden, strict=True):
            render = full_silhouette(state[o.id], EYE)
            assert value == iou(render, o.mask, ~hidden)
            assert share == np.count_nonzero(render & hidden) / np.count_nonzero(render)


def test_what_a_nearer_mask_hides_is_neither_compared_nor_coloured_like_the_rest():
    """The box under the small one: its render reaches behind the small one's mask, and is right there."""
    s = scene()
    under = next(o for o in s if any(p.id != o.id for p in nearer_objects(s)[o.id]) and o.id == 2)
    alone, aware = panels(s, id=2), panels(s, id=2, nearer=nearer_objects(s)[2])
    assert alone.ious[0] < 0.99 and aware.ious[0] > 0.995 and alone.hidden[0] == 0 < aware.hidden[0]
    assert share_of(alone.pictures[0], RENDER_ONLY) > 0.01 > share_of(aware.pictures[0], RENDER_ONLY)
    assert under.mask.any() and not np.array_equal(alone.pictures[0], aware.pictures[0])


def test_a_render_far_off_leaves_the_mask_large_in_its_panel():
    s = scene()
    found = panels(s, shifted(s, 5, (0.35, 0, 0)), id=5)
    assert found.ious[1] == 0
    mask = share_of(found.pictures[1], MASK_ONLY)
    assert mask > 0.1


@pytest.mark.parametrize("case", ["behind", "outside", "empty mask", "speck"])
def test_odd_cases_have_panels_too(case: str):
    s = scene()
    if case in ("behind", "outside"):
        s = shifted(s, 7, (0, -3, 0) if case == "behind" else (40, 0, 0))
    else:
        mask = np.zeros_like(s[7].mask)
        mask[0, 0] = case == "speck"
        s = s.with_objects(replace(s[7], mask=mask))
    found = panels(s, id=7)
    assert found.ious == (0.0,) and max(found.pictures[0].shape[:2]) == 200 and np.isfinite(found.hidden).all()
