"""What somebody at the camera sees of a scene: directions, places, sizes, colours, and what stands by what."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.transforms import UP, Array
from f3sr.language.grammar.lexicon import Axis, Direction, lexicon
from f3sr.language.grammar.normaliser import canonical, words_of
from f3sr.language.grammar.nouns import compounded
from f3sr.language.grammar.referring_expressions import PLACES
from f3sr.language.grammar.request import OPPOSITE
from f3sr.scene import GROUND, Scene
from f3sr.vision.colour_terms import Colour, colours_of

SAME_PLACE = 0.02
"""Share of the photo's side, or of the depth, within which two objects are as far left, up or away."""
SAME_SIZE = 0.05
"""Share of its size within which an object is as large as another."""
STEEP = 0.2
"""Horizontal part of the viewing direction below which the camera looks down and the photo's up is away."""
BESIDE = ("next_to", "touching", "leaning_on")


def world_vector(directions: Sequence[Direction], camera: Camera) -> Array:
    """The unit vector (3,) in the world of some directions together, as somebody at the camera means them. Left is
    against the camera's x axis and away along its z axis, both laid on the ground. ValueError where they cancel out."""
    total = np.sum([_vector(d, camera) for d in directions], axis=0) if directions else np.zeros(3)
    length = float(np.linalg.norm(total))
    if length < 1e-6:
        raise ValueError(f"directions {list(directions)} lead nowhere; accepted: some that are not opposite")
    return total / length


def _vector(direction: Direction, camera: Camera) -> Array:
    if direction in ("up", "down"):
        return UP if direction == "up" else -UP
    if direction in ("left", "towards"):
        return -_vector(OPPOSITE[direction], camera)
    x, y, z = camera.T_world_camera[:3, :3].T
    axis = x if direction == "right" else z if np.hypot(z[0], z[1]) > STEEP else -y
    flat = np.array([axis[0], axis[1], 0.0])
    return flat / max(float(np.linalg.norm(flat)), 1e-12)


class Sight:
    """What an observer at the camera sees of a scene's objects, by id. Each measure is taken when first needed."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._colours: dict[int, tuple[Colour, ...]] = {}

    @cached_property
    def labels(self) -> dict[int, tuple[str, ...]]:
        """The words of every label."""
        return {o.id: compounded(canonical(" ".join(words_of(o.label))).split()) for o in self.scene}

    @cached_property
    def vocabulary(self) -> frozenset[str]:
        """All words of all labels."""
        return frozenset(word for label in self.labels.values() for word in label)

    @cached_property
    def shapes(self) -> dict[int, str]:
        """Descriptions from the scene graph, of objects without a label."""
        return {n.id: n.description for n in self.scene.graph.nodes if not self.labels.get(n.id)}

    def colours(self, id: int) -> tuple[Colour, ...]:
        """The colours that an object may be called by: those in the photo, then those in its label."""
        if id not in self._colours:
            seen = colours_of(self.scene.photo.rgb[self.scene[id].mask])
            said: list[Colour] = [c for word in self.labels[id] for c in lexicon().colours_of.get(word, ())]
            self._colours[id] = (*seen, *(c for c in said if c not in seen))
        return self._colours[id]

    def picked(self, axis: Axis, rank: int, ids: Sequence[int]) -> list[int]:
        """The objects of a rank (0 the first, -1 the last) along an axis. Several where they differ too little to tell;
        none where there are fewer objects."""
        if not ids or not -len(ids) <= rank < len(ids):
            return []
        if axis == "middle":
            return self._middle(ids)
        keys = {id: self._key(axis, id) for id in ids}
        wanted = sorted(keys.values())[rank]
        margin = SAME_PLACE if axis in PLACES else SAME_SIZE
        return [id for id in ids if abs(keys[id] - wanted) <= margin]

    def related(self, relation: str, ids: Sequence[int], anchors: Sequence[int]) -> list[int]:
        """Those of some objects that stand in a relation to any anchor."""
        pairs = [(a, b) for a in ids for b in anchors if a != b]
        if relation in ("nearest-to", "farthest-from"):
            return self._nearest([p for p in pairs if GROUND not in p], 1 if relation == "nearest-to" else -1)
        held = {a for a, b in pairs if self._holds(relation, a, b)}
        if relation == "next-to" and not held:
            close = [(a, b) for a, b in pairs if GROUND not in (a, b) and self._gap(a, b) <= self.scene[b].size]
            return self._nearest(close, 1)
        return [id for id in ids if id in held]

    def _holds(self, relation: str, a: int, b: int) -> bool:
        if relation == "with":
            return self._holds("on", b, a) or self._holds("in", b, a)
        if relation == "under":
            return self._holds("on", b, a)
        if relation in ("on", "above"):
            return a != GROUND and any(s.id == b for s in (*self.scene[a].supports,))
        if GROUND in (a, b):
            return False
        if relation == "in":
            return (a, b) in self._graph["inside"] or (b, a) in self._graph["contains"]
        if relation == "next-to":
            return any((a, b) in self._graph[p] or (b, a) in self._graph[p] for p in BESIDE)
        return self._beyond(relation, a, b)

    def _beyond(self, relation: str, a: int, b: int) -> bool:
        """Whether one is left of, right of, behind or in front of another."""
        axis: Axis = "left" if relation == "left-of" else "right" if relation == "right-of" else "front"
        axis = "back" if relation == "behind" else axis
        return self._key(axis, a) < self._key(axis, b) - SAME_PLACE

    def _nearest(self, pairs: Sequence[tuple[int, int]], sign: int) -> list[int]:
        """Those of first objects that are nearest to, or farthest from, their second ones."""
        gaps: dict[int, float] = {}
        for a, b in pairs:
            gaps[a] = min(gaps.get(a, np.inf), self._gap(a, b))
        if not gaps:
            return []
        best = min(sign * g for g in gaps.values())
        margin = SAME_SIZE * min(self.scene[a].size for a in gaps)
        return [a for a, g in gaps.items() if sign * g - best <= margin]

    def _middle(self, ids: Sequence[int]) -> list[int]:
        """Nearest to halfway between the leftmost and the rightmost; of two, both."""
        x = {id: self._centres[id][0] for id in ids}
        halfway = (min(x.values()) + max(x.values())) / 2
        nearest = min(abs(v - halfway) for v in x.values())
        return [id for id in ids if abs(x[id] - halfway) <= nearest + SAME_PLACE]

    def _key(self, axis: Axis, id: int) -> float:
        """What is less for the first along an axis: shares of the photo's sides, logarithms of depths and sizes."""
        if axis in ("left", "right"):
            return self._centres[id][0] * (1 if axis == "left" else -1)
        if axis in ("upper", "lower"):
            return self._centres[id][1] * (1 if axis == "upper" else -1)
        if axis in ("front", "back"):
            return self._depths[id] * (1 if axis == "front" else -1)
        sides = np.maximum(np.ptp(self.scene[id].bounds_world, axis=0), 1e-9)
        flat, height = float(np.log(sides[:2].max())), float(np.log(sides[2]))
        size = float(np.log(sides).mean())
        return {"big": -size, "small": size, "tall": -height, "short": height, "long": -max(flat, height)}[axis]

    def _gap(self, a: int, b: int) -> float:
        """Distance [m] of two bounding boxes."""
        p, q = self.scene[a].bounds_world, self.scene[b].bounds_world
        return float(np.linalg.norm(np.maximum(0, np.maximum(p[0] - q[1], q[0] - p[1]))))

    @cached_property
    def _centres(self) -> dict[int, Array]:
        """Middles (2,) of the masks, right and down, in shares of the photo's sides."""
        return {o.id: _middle_of(o.mask) for o in self.scene}

    @cached_property
    def _depths(self) -> dict[int, float]:
        """Logarithms of the distances [m] from the camera along the ground, of the middles of bounding boxes."""
        eye = self.scene.camera.T_world_camera[:3, 3]
        flat = {o.id: float(np.linalg.norm((o.middle - eye)[:2])) for o in self.scene}
        return {id: float(np.log(max(d, 1e-9))) for id, d in flat.items()}

    @cached_property
    def _graph(self) -> dict[str, frozenset[tuple[int, int]]]:
        return {p: self.scene.graph.of(p) for p in (*BESIDE, "inside", "contains")}


def _middle_of(mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Array:
    columns, rows = mask.sum(0), mask.sum(1)
    total = max(int(columns.sum()), 1)
    x = float(columns @ (np.arange(len(columns)) + 0.5)) / total / len(columns)
    y = float(rows @ (np.arange(len(rows)) + 0.5)) / total / len(rows)
    return np.array([x, y])
