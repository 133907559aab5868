"""inpaint: the photo completed behind the objects, and where it shows their support. For pictures and films only: no
geometry, plan or rollout depends on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import BackgroundCompleter
from f3sr.backends.registry import Backend
from f3sr.background import BackgroundConfig, complete_background, widened
from f3sr.background.inpainting import Inpainting
from f3sr.background.support import hiding, support_of
from f3sr.io.answers import checked_photo
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Photo, Scene


@dataclass(frozen=True, kw_only=True)
class Inpainted(Outcome):
    stage: ClassVar[str] = "inpaint"
    replaced: float = 0.0
    """Share of the photo's pixels that was completed."""
    shadows: float = 0.0
    """Share of its pixels that are shadows."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        return (
            Measure(name="replaced", after=100 * self.replaced, unit="% of the photo"),
            Measure(name="of it shadows", after=100 * self.shadows, unit="% of the photo"),
        )


def inpaint(
    scene: Scene,
    config: BackgroundConfig,
    *,
    given: NDArray[np.uint8] | None = None,
    completer: Backend[BackgroundCompleter] | None = None,
    unanswered: str = "",
) -> tuple[Inpainting, Inpainted]:
    """The photo behind the objects of a levelled scene, or a ``given`` one (H, W, 3) of its size, pixel for pixel.

    A ``completer`` that is named fills the hole in place of ours, where none is given. ``unanswered``: why one that was
    asked gave no answer. Raises InputError for an answer that is no photo of this size, NoAnswerError without one."""
    masks = [o.mask for o in scene]
    support = support_of(scene, widened(masks, config.margin))
    filled = partial(_filled, completer) if completer and given is None else None
    background = complete_background(scene.photo, masks, config, support=support, filled=filled)
    decisions = background.decisions
    if given is not None:
        unasked = f"; {completer} is not asked" if completer else ""
        decisions = (Decision(choice=f"background: as given{unasked}", reason="background.png"),)
    elif unanswered:
        decisions += (Decision(choice="background: completed by patchmatch", reason=unanswered, fallback=True),)
    elif completer:
        decisions += (Decision(choice=f"background: completed by {completer}", reason="asked for"),)
    if (scene.geometry is None or scene.geometry.source == "ground") and scene.ground_mask is None:
        reason = "neither geometry of objects nor a ground mask"
        decisions += (Decision(choice="support: all below the horizon", reason=reason, fallback=True),)
    outcome = Inpainted(
        replaced=float(background.replaced.mean()), shadows=float(background.shadows.mean()), decisions=decisions
    )
    return Inpainting(
        rgb=background.rgb if given is None else given,
        support=support,
        kept=hiding(scene, support, widened(masks, 2 * config.margin)),
    ), outcome


def _filled(
    completer: Backend[BackgroundCompleter], photo: Photo, hole: NDArray[np.bool_], support: NDArray[np.bool_] | None
) -> NDArray[np.uint8]:
    return checked_photo(str(completer), completer.asked(lambda c: c.complete(photo, hole, support)), photo)
