"""Boxes around given masks, and the bound on their time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from eight_boxes import box, judge


def saved(folder: Path, rows: slice, columns: slice) -> Path:
    mask = np.zeros((60, 80), np.uint8)
    mask[rows, columns] = 255
    Image.fromarray(mask).save(folder / "03_tomato_soup_can.png")
    return folder / "03_tomato_soup_can.png"


def test_a_box_is_five_pixels_looser_than_its_mask(tmp_path: Path) -> None:
    mask = saved(tmp_path, slice(20, 30), slice(40, 50))
    assert box(mask) == "--box=35,15,55,35:tomato soup can"


def test_a_box_ends_with_the_photo(tmp_path: Path) -> None:
    mask = saved(tmp_path, slice(2, 58), slice(0, 80))
    assert box(mask) == "--box=0,0,80,60:tomato soup can"


@pytest.mark.parametrize(("wall", "cpu", "wrong"), [(15, 15, False), (16, 10, True), (10, 16, True)])
def test_both_clocks_are_held(wall: float, cpu: float, wrong: bool) -> None:
    ten: dict[str, Any] = {"wall": 10, "cpu": 10}
    rows = {"a": {"boxes": {"wall": wall, "cpu": cpu}, "given": ten, "given, proxies known": {"wall": 1, "cpu": 1}}}
    assert judge(rows) == wrong
