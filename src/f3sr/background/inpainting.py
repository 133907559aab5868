"""The photo completed behind its objects, as later steps read it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.vision.regions import Mask


@dataclass(frozen=True, eq=False, kw_only=True)
class Inpainting:
    """``rgb`` (H, W, 3) uint8 sRGB, the photo's size and place; ``support`` (H, W): where it shows what things stand
    on; ``kept`` (H, W) float32: depth [m] of what else it shows and may hide objects, inf elsewhere."""

    rgb: NDArray[np.uint8]
    support: Mask
    kept: NDArray[np.float32]
