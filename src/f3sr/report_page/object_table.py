"""The table of objects: what moved each and why, its visible IoU, its proxy, its mass and its supports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, takewhile

import numpy as np

from f3sr.core.pose_uncertainty import PoseUncertainty
from f3sr.core.transforms import rotation_angle, transform
from f3sr.io.images import resized
from f3sr.metrics.measures import ObjectMeasures
from f3sr.physics.mujoco_model import body_of
from f3sr.report_page.formatting import length, number
from f3sr.report_page.page_data import PageData, by_id
from f3sr.scene import Motion, SceneObject, Support
from f3sr.stages.decompose import Decomposed
from f3sr.vision.pictures import Image

THUMBNAIL = 96
"""Longest side [px]."""
MARGIN = 0.1
"""Of a thumbnail around its mask, as a share of the mask's longer side."""
OUTSIDE = 0.25
"""Brightness of a thumbnail's pixels that are not the object's."""
NO_SHIFT, NO_TURN, NO_SCALE = 1e-4, np.radians(0.1), 1e-3
"""Shifts [m], turns [rad] and changes of scale that are not shown."""
UNKNOWN_TURN = np.pi / 2
"""Half width of a yaw's interval [rad] from which on the yaw is unknown."""
LOST = 0.05
"""A fall of the visible IoU that is marked."""


@dataclass(frozen=True, kw_only=True)
class Move:
    """What one stage did to an object: shift of its middle [m], turn [rad], factor of its size, and why."""

    stage: str
    shift: float
    turn: float
    scale: float
    reasons: tuple[str, ...]

    @property
    def amount(self) -> str:
        """``42 mm, 31°, ×1.040``: only what is worth a word."""
        parts = (
            length(self.shift) if self.shift > NO_SHIFT else None,
            f"{number(float(np.degrees(self.turn)), digits=2)}°" if self.turn > NO_TURN else None,
            f"×{self.scale:.3f}" if abs(self.scale - 1) > NO_SCALE else None,
        )
        return ", ".join(p for p in parts if p) or f"under {length(NO_SHIFT)}"


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectRow:
    """An object; ``before``, ``after``: direct composition and ours where they are measured; ``inflation``: volume of
    the proxy over that of the mesh; ``mass`` [kg]; ``supports``, the largest share first;
    ``known``: how well its pose is."""

    o: SceneObject
    thumbnail: Image
    moves: Sequence[Move]
    before: ObjectMeasures | None
    after: ObjectMeasures | None
    inflation: float | None
    mass: float
    supports: Sequence[Support]
    known: PoseUncertainty | None

    @property
    def yaw(self) -> str:
        """The interval of the yaw in words: beyond a quarter turn nothing shows it."""
        if self.known is None or self.known.yaw >= UNKNOWN_TURN:
            return "yaw unknown"
        return f"yaw ±{number(float(np.degrees(self.known.yaw)), digits=2)}°"

    @property
    def worse(self) -> bool:
        """Whether the visible IoU fell."""
        return bool(self.before and self.after and self.after.IoU_visible < self.before.IoU_visible - LOST)


def rows(page: PageData) -> list[ObjectRow]:
    before, after = by_id(page.direct_details), by_id(page.details)
    decomposed = (x for x in page.result.outcomes if isinstance(x, Decomposed))
    inflation = {id: fit.inflation for x in decomposed for id, fit in x.fits.items()}
    return [
        ObjectRow(
            o=o,
            thumbnail=thumbnail(o, page),
            moves=moves(page, o.id),
            before=before.get(o.id),
            after=after.get(o.id),
            inflation=inflation.get(o.id),
            mass=body_of(o).mass,
            supports=sorted(o.supports, key=lambda s: -s.share),
            known=page.result.uncertainty.get(o.id),
        )
        for o in page.scene
    ]


def thumbnail(o: SceneObject, page: PageData) -> Image:
    """The photo around the object's mask, the rest dimmed."""
    rows, columns = np.flatnonzero(o.mask.any(1)), np.flatnonzero(o.mask.any(0))
    if not len(rows):
        return np.full((THUMBNAIL, THUMBNAIL, 3), 200, np.uint8)
    pad = round(MARGIN * max(np.ptp(rows), np.ptp(columns))) + 1
    top, left = max(0, rows[0] - pad), max(0, columns[0] - pad)
    crop = slice(top, rows[-1] + pad + 1), slice(left, columns[-1] + pad + 1)
    rgb, mask = page.scene.photo.rgb[crop], o.mask[crop]
    picture = np.where(mask[..., None], rgb, OUTSIDE * rgb + (1 - OUTSIDE) * 128).astype(np.uint8)
    scale = THUMBNAIL / max(picture.shape[:2])
    return resized(picture, max(1, round(scale * picture.shape[1])), max(1, round(scale * picture.shape[0])))


def moves(page: PageData, id: int) -> list[Move]:
    """The stages that moved an object, in order. Levelling moves all as one and is no move."""
    found: list[Move] = []
    for (_, a), (stage, b) in pairwise(page.result.scenes.items()):
        before, after = a[id], b[id]
        pairs = zip(before.motion, after.motion, strict=False)
        shared = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
        notes = after.motion[shared:]  # some begin again from an earlier stage
        if notes:
            middle = before.mesh.bounds.mean(0)
            way = transform(after.T_world_asset, middle) - transform(before.T_world_asset, middle)
            R = after.T_world_object[:3, :3] @ before.T_world_object[:3, :3].T
            found.append(
                Move(
                    stage=stage,
                    shift=float(np.linalg.norm(way)),
                    turn=rotation_angle(R),
                    scale=after.scale / before.scale,
                    reasons=tuple(dict.fromkeys(x.reason for x in notes if _matters(x))),
                )
            )
    return found


def _matters(x: Motion) -> bool:
    return float(np.linalg.norm(x.translation)) > NO_SHIFT or x.rotation > NO_TURN or abs(x.scale - 1) > NO_SCALE
