"""The photo completed behind its objects, as later steps read it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from f3sr.background.regions import Mask
from f3sr.report import Report, report_of


@dataclass(frozen=True, eq=False, kw_only=True)
class Inpainting:
    """``rgb`` (H, W, 3) uint8 sRGB, the photo's size and place; ``support`` (H, W): where it shows what things stand
    on; ``kept`` (H, W) float32: depth [m] of what else it shows and may hide objects, inf elsewhere."""

    rgb: NDArray[np.uint8]
    support: Mask
    kept: NDArray[np.float32]
    report: Report

    def stored(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """For a store."""
        return asdict(self.report), {"rgb": self.rgb, "support": self.support, "kept": self.kept}

    @classmethod
    def restored(cls, document: dict[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Self:
        return cls(rgb=arrays["rgb"], support=arrays["support"], kept=arrays["kept"], report=report_of(document))
