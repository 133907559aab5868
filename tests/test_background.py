"""The completed photo: what is kept, what is continued, what hostile inputs do, and where shadows are found."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter

from f3sr import background
from f3sr.background import BackgroundConfig, complete_background, patchmatch
from f3sr.background.completion import CompletionConfig
from f3sr.background.membrane import membrane
from f3sr.background.shadows import PhotoShadowConfig
from f3sr.scene import Photo

Pixels = NDArray[np.uint8]
Mask = NDArray[np.bool_]

AS_GIVEN = BackgroundConfig(margin=0.0, shadows=PhotoShadowConfig(reach=0.0))
"""The hole as it is: nothing widened, no shadow."""


def box(shape: tuple[int, ...], y: int, x: int, height: int, width: int) -> Mask:
    mask = np.zeros(shape[:2], np.bool_)
    mask[y : y + height, x : x + width] = True
    return mask


def grey(values: NDArray[np.float64]) -> Pixels:
    return np.repeat(np.clip(np.rint(values), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def stripes(height: int = 120, width: int = 160, period: int = 12) -> Pixels:
    return grey(60 + 120.0 * ((np.mgrid[:height, :width][1] // (period // 2)) % 2))


def checker(height: int = 120, width: int = 160, side: int = 8) -> Pixels:
    y, x = np.mgrid[:height, :width] // side
    return grey(60 + 120.0 * ((y + x) % 2))


def noise(height: int = 120, width: int = 160, size: float = 1.5, seed: int = 0) -> Pixels:
    """Grain of some size [px] whose levels spread by 30."""
    rough = gaussian_filter(np.random.default_rng(seed).normal(size=(height, width)), size)
    return grey(128 + 30 * rough / rough.std())


def filled(rgb: Pixels, hole: Mask, config: BackgroundConfig = AS_GIVEN) -> Pixels:
    return complete_background(Photo(rgb=rgb), [hole], config).rgb


def psnr(a: Pixels, b: Pixels, where: Mask) -> float:
    return float(10 * np.log10(255**2 / max(np.mean((a[where].astype(float) - b[where]) ** 2), 1e-9)))


def diffused(rgb: Pixels, hole: Mask) -> Pixels:
    """What smooth filling gives at best: harmonic inside, as diffusion is."""
    values = membrane(rgb.astype(np.float32), ~hole)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def test_the_same_question_about_a_photo_is_answered_once(monkeypatch: pytest.MonkeyPatch):
    photo, hole, other = Photo(rgb=stripes()), box((120, 160), 40, 60, 20, 20), box((120, 160), 10, 60, 20, 20)
    table = box((120, 160), 50, 0, 70, 160)
    asked: list[tuple[list[Mask], BackgroundConfig, Mask | None]] = [
        *(([*masks], AS_GIVEN, None) for masks in ([hole], [other], [hole, other])),
        ([hole], AS_GIVEN, table),
        ([hole], AS_GIVEN, ~table),
        ([hole], replace(AS_GIVEN, margin=0.05), None),
    ]
    first = [complete_background(photo, masks, config, support=support) for masks, config, support in asked]
    for (masks, config, support), known in zip(asked, first, strict=True):
        fresh = complete_background(Photo(rgb=photo.rgb), masks, config, support=support)
        assert np.array_equal(fresh.rgb, known.rgb) and np.array_equal(fresh.replaced, known.replaced)
        again = complete_background(photo, [mask.copy() for mask in masks], config, support=support)
        monkeypatch.setattr(background, "complete", None)  # what is known needs no completion
        assert complete_background(photo, masks, config, support=support) is again
        monkeypatch.undo()
        assert np.array_equal(again.rgb, known.rgb) and np.array_equal(again.replaced, known.replaced)


def test_nothing_outside_the_hole_changes() -> None:
    rgb = noise()
    hole = box(rgb.shape, 40, 50, 30, 40)
    spoiled = rgb.copy()
    spoiled[hole] = (255, 0, 0)
    result = complete_background(Photo(rgb=spoiled), [hole], AS_GIVEN)
    assert np.array_equal(result.replaced, hole)
    assert np.array_equal(result.rgb[~hole], rgb[~hole])
    assert np.abs(result.rgb[hole].astype(int) - (255, 0, 0)).min(0).max() > 20  # and all of it does


def test_what_the_hole_held_does_not_matter() -> None:
    rgb = noise()
    hole = box(rgb.shape, 40, 50, 30, 40)
    other = rgb.copy()
    other[hole] = 255 - other[hole]
    assert np.array_equal(filled(rgb, hole), filled(other, hole))


@pytest.mark.parametrize("picture", [stripes, checker])
def test_a_pattern_goes_on_where_diffusion_loses_it(picture) -> None:
    rgb = picture()
    hole = box(rgb.shape, 45, 60, 30, 36)
    assert psnr(filled(rgb, hole), rgb, hole) > 25
    assert psnr(diffused(rgb, hole), rgb, hole) < 15


def test_even_colour_stays_even() -> None:
    rgb = np.full((90, 120, 3), (40, 90, 160), np.uint8)
    assert np.array_equal(filled(rgb, box(rgb.shape, 20, 30, 40, 50)), rgb)


@pytest.mark.parametrize("angle", [0, 90, 35])
def test_a_slope_of_light_goes_on(angle: float) -> None:
    y, x = np.mgrid[:120, :160]
    along = np.cos(np.radians(angle)) * x + np.sin(np.radians(angle)) * y
    rgb = grey(60 + 130 * (along - along.min()) / np.ptp(along))
    hole = box(rgb.shape, 35, 50, 50, 60)
    assert psnr(filled(rgb, hole), rgb, hole) > 38


def test_texture_under_a_lamp_keeps_contrast_and_light() -> None:
    """Grain whose light falls to a third across the picture: in the hole the same light and the same contrast, in the
    median of five grains, as one may have no like patch near."""
    y, x = np.mgrid[:150, :200]
    light = 1 / (1 + ((x - 20) ** 2 + (y - 20) ** 2) / 170**2)
    hole = box((150, 200), 50, 70, 50, 60)
    quarters = [(slice(50 + 25 * i, 75 + 25 * i), slice(70 + 30 * j, 100 + 30 * j)) for i in (0, 1) for j in (0, 1)]
    means, spreads = list[float](), list[float]()
    for seed in range(5):
        rgb = grey(1.2 * light * noise(150, 200, size=0.8, seed=seed)[..., 0])
        result = filled(rgb, hole).astype(float)[..., 0]
        means += [abs(result[q].mean() / rgb[..., 0][q].mean() - 1) for q in quarters]
        spreads += [abs(result[q].std() / rgb[..., 0][q].std() - 1) for q in quarters]
    assert np.median(means) < 0.06 and max(means) < 0.2
    assert np.median(spreads) < 0.2 and max(spreads) < 0.5


def test_same_bytes_on_every_run_and_thread() -> None:
    rgb = noise(100, 140)
    hole = box(rgb.shape, 30, 40, 30, 40)
    results: list[Pixels] = []
    threads = [threading.Thread(target=lambda: results.append(filled(rgb, hole))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    results.append(filled(rgb, hole))
    assert all(np.array_equal(r, results[0]) for r in results)
    other = filled(
        rgb, hole, BackgroundConfig(margin=0.0, shadows=AS_GIVEN.shadows, completion=CompletionConfig(seed=1))
    )
    assert not np.array_equal(other, results[0])


@pytest.mark.parametrize("slope", [-0.15, 0.0, 0.2])
def test_the_edge_of_a_support_goes_on_straight(slope: float) -> None:
    """A table against a wall, its edge half hidden: each is completed from itself alone."""
    y, x = np.mgrid[:120, :160]
    table = y > 55 + slope * (x - 80)
    rgb = np.where(table[..., None], noise() // 2 + 90, 40 + noise(size=3.0) // 4).astype(np.uint8)
    hole = box(rgb.shape, 25, 45, 60, 70)
    known = Photo(rgb=np.where(hole[..., None], 255, rgb).astype(np.uint8))
    completed = complete_background(known, [hole], AS_GIVEN, support=table).rgb
    shade = gaussian_filter(completed[..., 0].astype(float), 2)
    inside = hole & (np.abs(y - 55 - slope * (x - 80)) > 4)
    assert ((shade > 105) == table)[inside].mean() > 0.995
    assert np.array_equal(completed[~hole], rgb[~hole])


@pytest.mark.parametrize("axis", [0, 1])
def test_flips_flip_the_result(axis: int) -> None:
    """Where the picture says what must be there; a random search is not bound to the same texture."""
    y, x = np.mgrid[:120, :160]
    rgb = grey(60 + 0.5 * x + 0.3 * y + 40.0 * ((y // 8) % 2))
    hole = box(rgb.shape, 40, 50, 30, 40)
    there = np.flip(filled(np.flip(rgb, axis), np.flip(hole, axis)), axis)
    assert psnr(there, filled(rgb, hole), hole) > 25


HOSTILE = {
    "at the border": ((80, 100), (0, 0, 80, 25)),
    "in a corner": ((80, 100), (50, 70, 30, 30)),
    "40 percent": ((80, 100), (8, 10, 40, 80)),
    "a strip left": ((60, 60), (0, 0, 60, 50)),
    "tiny": ((16, 16), (4, 4, 5, 5)),
    "thin": ((16, 300), (4, 40, 8, 100)),
    "odd": ((61, 83), (20, 30, 17, 23)),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_holes_are_filled(case: str) -> None:
    shape, where = HOSTILE[case]
    truth = np.full((*shape, 3), (120, 100, 80), np.uint8)
    hole = box(shape, *where)
    rgb = truth.copy()
    rgb[hole] = (0, 255, 0)
    assert psnr(filled(rgb, hole), truth, hole) > 40


def test_no_hole_returns_the_photo() -> None:
    rgb = noise(40, 50)
    for masks in ([], [np.zeros((40, 50), np.bool_)]):
        result = complete_background(Photo(rgb=rgb), masks)
        assert np.array_equal(result.rgb, rgb) and not result.replaced.any() and not result.decisions


@pytest.mark.parametrize("left", [0, 2])
def test_no_patch_to_copy_is_told(left: int) -> None:
    rgb = np.full((40, 50, 3), (10, 200, 90), np.uint8)
    hole = box(rgb.shape, 0, left, 40, 50)
    result = complete_background(Photo(rgb=rgb), [hole], AS_GIVEN)
    assert [d.fallback for d in result.decisions] == [True]
    assert np.abs(result.rgb.astype(int) - rgb).max() <= 1


def test_finer_levels_keep_the_detail_of_their_sources() -> None:
    """Searched at a quarter of the pixels, grain as fine as the photo's is in the hole."""
    rgb = grey(np.random.default_rng(0).normal(128, 20, (200, 260)))
    hole = box(rgb.shape, 60, 80, 60, 80)
    coarse = replace(AS_GIVEN, completion=CompletionConfig(working_pixels=13_000))
    result = filled(rgb, hole, coarse)
    assert result[hole].std() > 0.7 * rgb[hole].std()


@njit
def mismatch_at(picture: Any, weight: Any, ty: int, tx: int, sy: int, sx: int, bound: float) -> Any:
    return patchmatch._mismatch(picture, weight, ty, tx, sy, sx, bound)


@pytest.mark.parametrize("seed", range(5))
def test_a_bound_ends_the_comparison_of_patches_only_above_it(seed: int) -> None:
    """Also of patches that differ by light, whose first rows alone look like another picture."""
    rng, side = np.random.default_rng(seed), patchmatch.SIDE
    picture = rng.normal(0, 0.05, (side, 2 * side, 3)).astype(np.float32)
    picture[:, side:] = picture[:, :side] + rng.normal(0, 0.01, (side, side, 3)) + [0.3, 0.0, 0.0]
    weight = rng.uniform(0.2, 1, (side, 2 * side)).astype(np.float32)
    middle = side // 2

    def mismatch(bound: float) -> float:
        return float(mismatch_at(picture, weight, middle, middle, middle, middle + side, bound))

    exact = mismatch(1e30)
    assert all(mismatch(share * exact) == exact for share in (1.001, 1.5, 10.0))
    assert mismatch(0.2 * exact) > 0.2 * exact


def test_warm_up_compiles_every_kernel() -> None:
    patchmatch.warm_up()
    kernels = [patchmatch.measure, patchmatch.search, patchmatch.vote, patchmatch.vote_slopes, patchmatch.relax]
    seen = [len(k.signatures) for k in kernels]
    assert all(seen)
    filled(noise(40, 60), box((40, 60), 12, 20, 12, 14))
    assert [len(k.signatures) for k in kernels] == seen  # with the types that completion calls them with


def test_small_gaps_between_objects_are_replaced() -> None:
    rgb = noise()
    ring = box(rgb.shape, 30, 40, 40, 50) & ~box(rgb.shape, 48, 62, 4, 5)
    assert complete_background(Photo(rgb=rgb), [ring], AS_GIVEN).replaced[50, 64]


# --- shadows ------------------------------------------------------------------------------------------------------


def shadowed(depth: float, softness: float, grain: float = 0.0) -> tuple[Pixels, Mask, NDArray[np.float64]]:
    """A table under a slope of light with a blue box on it and its soft shadow to the right; how dark each pixel is."""
    h, w = 240, 320
    mask = box((h, w), 90, 100, 60, 40)
    cast = box((h, w), 110, 130, 42, 60).astype(float)
    dark = depth * gaussian_filter(cast, softness)
    y, x = np.mgrid[:h, :w]
    light = (0.8 + 0.2 * x / w + 0.1 * y / h) * (1 - dark)
    light *= 1 + grain * np.random.default_rng(0).normal(size=(h, w))
    rgb = np.clip(np.array([200, 160, 120]) * light[..., None], 0, 255).astype(np.uint8)
    rgb[mask] = (30, 40, 160)
    return rgb, mask, np.where(mask, 0, dark)


@pytest.mark.parametrize(
    ("softness", "depth", "grain"), [(2.0, 0.25, 0.0), (2.0, 0.6, 0.04), (6.0, 0.25, 0.04), (6.0, 0.6, 0.0)]
)
def test_a_soft_shadow_is_found(softness: float, depth: float, grain: float) -> None:
    rgb, mask, dark = shadowed(depth, softness, grain)
    found = complete_background(Photo(rgb=rgb), [mask]).replaced
    core = dark > 0.3 * depth
    assert (found & core).sum() > 0.97 * core.sum()
    lit = (dark < 0.01 * depth) & ~binary_dilation(mask, iterations=12)
    assert (found & lit).sum() < 0.03 * lit.sum()


def test_after_removal_no_shadow_is_left() -> None:
    rgb, mask, _ = shadowed(0.5, 4.0)
    empty, *_ = shadowed(0.0, 4.0)
    result = complete_background(Photo(rgb=rgb), [mask])
    assert psnr(result.rgb, empty, box(mask.shape, 80, 90, 90, 130) & ~mask) > 33
    assert psnr(rgb, empty, box(mask.shape, 80, 90, 90, 130) & ~mask) < 20


def test_no_shadow_is_found_where_there_is_none() -> None:
    rgb, mask, _ = shadowed(0.0, 4.0, grain=0.03)
    assert not complete_background(Photo(rgb=rgb), [mask]).shadows.any()


def test_a_dark_floor_behind_an_object_is_no_shadow() -> None:
    """Its upper half is before a darker material, which the edge of the table parts from the lower."""
    rgb, mask, _ = shadowed(0.0, 4.0)
    rgb = rgb.copy()
    floor = box(mask.shape, 0, 0, 105, 320) & ~mask
    rgb[floor] = (70, 70, 80)
    assert not complete_background(Photo(rgb=rgb), [mask]).shadows.any()


def test_a_dark_spot_apart_from_the_object_is_kept() -> None:
    rgb, mask, _ = shadowed(0.0, 4.0)
    rgb = rgb.copy()
    spot = box(mask.shape, 190, 230, 25, 35)
    rgb[spot] = rgb[spot] // 2
    assert np.array_equal(complete_background(Photo(rgb=rgb), [mask]).rgb[spot], rgb[spot])
