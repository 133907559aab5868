"""inpaint: the photo completed behind the objects, and where it shows their support. For pictures and films only: no
geometry, plan or rollout depends on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from f3sr.background import BackgroundConfig, complete_background, widened
from f3sr.background.regions import Mask
from f3sr.background.support import hiding, support_of
from f3sr.report import Decision, Measure, Report, report_of
from f3sr.scene import Scene


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


def inpaint(scene: Scene, config: BackgroundConfig, *, given: NDArray[np.uint8] | None = None) -> Inpainting:
    """The photo behind the objects of a levelled scene, or a ``given`` one (H, W, 3) of its size, pixel for pixel."""
    masks = [o.mask for o in scene]
    support = support_of(scene, widened(masks, config.margin))
    background = complete_background(scene.photo, masks, config, support=support)
    decisions = background.decisions
    if given is not None:
        decisions = (Decision(choice="background: as given", reason="background.png"),)
    if scene.geometry is None and scene.ground_mask is None:
        reason = "neither geometry nor a ground mask"
        decisions += (Decision(choice="support: all below the horizon", reason=reason, fallback=True),)
    measures = (
        Measure(name="replaced", after=100 * float(background.replaced.mean()), unit="% of the photo"),
        Measure(name="of it shadows", after=100 * float(background.shadows.mean()), unit="% of the photo"),
    )
    return Inpainting(
        rgb=background.rgb if given is None else given,
        support=support,
        kept=hiding(scene, support, widened(masks, 2 * config.margin)),
        report=Report(stage="inpaint", measures=measures, decisions=decisions),
    )
