"""What a user points at in a photo, and the masks that come of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import Prompt


@dataclass(frozen=True, eq=False, kw_only=True)
class Selection:
    """A prompt for every object, and what points at the ground: its box is not used, its strokes may be none."""

    prompts: tuple[Prompt, ...]
    ground: Prompt = field(default_factory=Prompt)


@dataclass(frozen=True, eq=False, kw_only=True)
class Outlines:
    """Masks (H, W) in the order of the prompts, disjoint; ``ground`` (H, W) is the visible support surface."""

    masks: tuple[NDArray[np.bool_], ...]
    ground: NDArray[np.bool_]
