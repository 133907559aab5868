"""The vote on readings: which one is meant, or which of them nothing in the picture tells apart.

All objects vote, as a producer has one convention. A reading's cost is the mean over objects of what each misses of
mask, detail and depth once it is corrected nearby: poses are off by degrees themselves. Readings race: one that falls
behind by more than chance after some objects is not asked about the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from f3sr.core.mesh import Mesh
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.mesh_poses.outline_votes import DEFAULT_OUTLINES, OutlineConfig, sieved
from f3sr.mesh_poses.pose_by_mask import DEFAULT_SEARCH, MaskedPhoto, PoseSearchConfig
from f3sr.mesh_poses.pose_seeker import Seeker
from f3sr.scene import SceneObject
from f3sr.settings import constants


@constants
class VoteConfig:
    """When a reading is taken, and when readings are alike."""

    outlines: OutlineConfig = DEFAULT_OUTLINES
    slack: float = 0.25
    """How much more than the best a reading may miss of the masks in the sieve and still race."""
    racers: int = 24
    """Most readings in the race. A box has 8 that show the same, with mirrors 16."""
    noise: float = 0.03
    """Standard deviation, for one object, of the difference in cost between two readings that is no evidence: errors of
    meshes and of corrections. Chosen, not fitted; ``benchmarks/scrambled.py`` counts what it lets through."""
    sigmas: float = 2.0
    """Standard deviations of the mean over objects from which on one reading is better than another."""
    dropped: float = 5.0
    """Those from which on a reading leaves the race."""
    usable: float = 0.5
    """Mean IoU, once corrected, below which no reading shows what the masks show."""
    alike: float = 0.03
    """Largest distance of surfaces [share of an object's diagonal] at which two readings show the same object."""
    samples: int = 2_000
    """Points of a surface in that. Two samples of one surface are .014 apart; with 400 they were .03, as other ones."""

    def margin(self, objects: int) -> float:
        """Difference in cost from which on it is evidence."""
        return self.sigmas * self.noise / math.sqrt(objects)


DEFAULT_VOTES = VoteConfig()


@dataclass(frozen=True, eq=False, kw_only=True)
class Votes:
    """Readings that finished the race, best first."""

    places: CandidatePlaces
    costs: Array
    """(k,) mean over objects."""
    ious: Array
    """(k,) mean IoU with the masks, once corrected."""
    usual: Array
    """(k,) the place of each in the order in which they were put to the vote: the usual ones first."""
    meshes: Mapping[int, Mesh]
    config: VoteConfig

    @property
    def usable(self) -> bool:
        """Whether any reading shows what the masks show."""
        return len(self.places) > 0 and float(self.ious[0]) >= self.config.usable

    @property
    def alike(self) -> list[int]:
        """Indices of readings that fit as well as the best, which is the first; they are the first ones."""
        margin = self.config.margin(len(self.places.ids))
        return [k for k in range(len(self.places)) if self.costs[k] <= self.costs[0] + margin]

    @cached_property
    def likeliest(self) -> int:
        """Index of the most usual reading of those that fit as well as the best and show the same surfaces."""
        return min((k for k in self.alike if k == 0 or not self.differ(k, 0)), key=lambda k: self.usual[k])

    @cached_property
    def rivals(self) -> list[int]:
        """Indices of readings that fit as well as the best, and differ visibly from it and from each other."""
        found = list[int]()
        for k in self.alike[1:]:
            if all(self.differ(k, other) for other in (0, *found)):
                found.append(k)
        return found

    def differ(self, one: int, other: int) -> bool:
        """Whether two readings put any object's surface visibly elsewhere."""
        return any(self.apart(v, one, other) > self.config.alike for v in range(len(self.places.ids)))

    def apart(self, v: int, one: int, other: int) -> float:
        """Mean distance of the surfaces of the ``v``-th object by two readings [share of its diagonal]."""
        a, b = (self._placed(v, k) for k in (one, other))
        return _apart(a, b) / (float(self.places.scale[one, v]) * self.meshes[self.places.ids[v]].diagonal)

    def _placed(self, v: int, k: int) -> Array:
        """Points (p, 3) of a surface where a reading puts it, in the camera."""
        R, t, scale = self.places.R[k, v], self.places.t[k, v], float(self.places.scale[k, v])
        return self._points[v] @ (scale * R).T + t

    @cached_property
    def _points(self) -> list[Array]:
        chosen = (self.meshes[id] for id in self.places.ids)
        return [sample_surface(m.vertices, m.faces, self.config.samples) for m in chosen]


def surfaces_apart(one: SceneObject, other: SceneObject, samples: int) -> float:
    """Mean distance of two surfaces in the world [share of the first's size]."""
    a, b = (sample_surface(o.vertices_world, o.mesh.faces, samples) for o in (one, other))
    return _apart(a, b) / one.size


def _apart(a: Array, b: Array) -> float:
    """Mean distance of points (n, 3) to the nearest of others (m, 3), both ways."""
    from scipy.spatial import KDTree

    return float(KDTree(a).query(b)[0].mean() + KDTree(b).query(a)[0].mean()) / 2


def voted(
    view: MaskedPhoto,
    meshes: Mapping[int, Mesh],
    places: CandidatePlaces,
    *,
    units: bool,
    config: VoteConfig = DEFAULT_VOTES,
    search: PoseSearchConfig = DEFAULT_SEARCH,
) -> Votes:
    """The vote of all objects on readings of their files. ``units``: whether a file may have another unit than its
    place."""
    near, missed = sieved(view, meshes, places, config.outlines, units=units)
    entered = near.chosen([k for k in range(len(near)) if missed[k] <= missed[0] + config.slack][: config.racers])
    costs, ious = _raced(view, meshes, entered, config, search)
    order = sorted(range(len(entered)), key=lambda k: costs[k])
    finished = [k for k in order if np.isfinite(costs[k])]
    return Votes(
        places=entered.chosen(finished),
        costs=costs[finished],
        ious=ious[finished],
        usual=np.array([places.names.index(entered.names[k]) for k in finished]),
        meshes=meshes,
        config=config,
    )


def _raced(
    view: MaskedPhoto,
    meshes: Mapping[int, Mesh],
    places: CandidatePlaces,
    config: VoteConfig,
    search: PoseSearchConfig,
) -> tuple[Array, Array]:
    """Costs (k,) of readings, inf where one fell behind, and their mean IoUs (k,)."""
    total, ious = np.zeros(len(places)), np.zeros(len(places))
    running, done = list(range(len(places))), 0
    order = sorted(range(len(places.ids)), key=lambda v: -int(view.instances[places.ids[v]].mask.sum()))
    for done, v in enumerate(order, start=1):
        id = places.ids[v]
        seeker = Seeker(view=view, id=id, mesh=meshes[id], search=search)
        for k in running:
            found = seeker.found(places, k, v, corrected=True)
            total[k] += found.missed
            ious[k] += found.iou
        best = min((total[k] / done for k in running), default=0.0)
        running = [k for k in running if total[k] / done <= best + config.dropped * config.noise / math.sqrt(done)]
        if len(running) <= 1:
            break
    finished = np.isin(np.arange(len(places)), running)
    return np.where(finished, total / max(done, 1), np.inf), ious / max(done, 1)
