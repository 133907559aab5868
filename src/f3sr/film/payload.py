"""What the player's script reads: the rollout, light meshes and contacts."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from f3sr.core.transforms import Array, quaternion_from_rotation
from f3sr.film.footage import Footage, paths
from f3sr.film.moments import Moment
from f3sr.film.timeline import pairs_of
from f3sr.film.video import Video
from f3sr.goals.plan import Plan
from f3sr.goals.rollout import Rollout
from f3sr.goals.rollout_queries import Seen
from f3sr.goals.verify import Verdict
from f3sr.scene import Scene
from f3sr.web.document import clean
from f3sr.web.light_mesh import lightened
from f3sr.web.packed import TextureIndex, packed_camera, packed_mesh

FEWEST_FACES = 200
"""Least faces of one mesh, however many objects share the page's."""
FAR = 2.0
"""How far beyond the scene's box, in its diagonals, the view frames what moves."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Shown:
    """What a player shows: a played goal, its film (a frame per sample of ``footage``) and its moments."""

    scene: Scene
    plan: Plan
    verdict: Verdict
    footage: Footage
    video: Video
    moments: tuple[Moment, ...]
    slow: Fraction = Fraction(1)


def payload(shown: Shown, *, faces: int, texture: int) -> dict[str, Any]:
    """All that ``player.js`` reads, as plain values."""
    scene, rollout = shown.scene, shown.footage.rollout
    textures = TextureIndex(texture)
    each = max(FEWEST_FACES, faces // len(scene.objects))
    return {
        "fps": float(shown.video.fps),
        "frames": shown.video.frames,
        "step": float(rollout.time[-1]) / max(1, len(rollout.time) - 1),
        "view": {
            "camera": packed_camera(scene.camera),
            "bounds": _bounds(scene, rollout),
            "objects": [{"mesh": packed_mesh(lightened(o.mesh, each), textures.index)} for o in scene],
            "path": np.round(_path(shown), 5).ravel().tolist(),
            "strips": [first for _, first, _ in paths(shown.footage.scenarios, len(rollout.time))],
            "textures": textures.uris,  # after the meshes, which name them
        },
        "names": [clean(f"{o.id} {o.label}".strip()) for o in scene],
        "ids": [o.id for o in scene],
        "poses": base64.b64encode(_poses(rollout).astype("<f4").tobytes()).decode(),
        "contacts": [
            {"a": p.a, "b": p.b, "forces": [round(float(f), 3) for f in p.forces]}
            for p in pairs_of(rollout)
            if not p.rests
        ],
    }


def _path(shown: Shown) -> Array:
    """(T, 3): the centre of what is launched, in every frame that of its phase."""
    rollout = shown.footage.rollout
    seen = Seen(rollout, shown.scene)
    parts = paths(shown.footage.scenarios, len(rollout.time))
    return np.concatenate([seen.way(id)[first:end] for id, first, end in parts])


def _poses(rollout: Rollout) -> Array:
    """(T, N, 7): place and quaternion (wxyz)."""
    T = rollout.T_world_object
    quaternions = [quaternion_from_rotation(R) for R in T[..., :3, :3].reshape(-1, 3, 3)]
    return np.concatenate([T[..., :3, 3], np.reshape(quaternions, (*T.shape[:2], 4))], axis=-1)


def _bounds(scene: Scene, rollout: Rollout) -> Sequence[float]:
    """The box that presets frame: the scene and where things go, but not what is flung far away."""
    corners = np.concatenate([o.bounds_world for o in scene])
    low, high = corners.min(0), corners.max(0)
    reach = FAR * float(np.linalg.norm(high - low))
    ways = rollout.T_world_object[..., :3, 3].reshape(-1, 3)
    ways = np.clip(ways, low - reach, high + reach)
    return [*np.minimum(low, ways.min(0)).tolist(), *np.maximum(high, ways.max(0)).tolist()]
