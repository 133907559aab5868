"""PAT3D's simulate-and-correct, named and short: a layout, a forward simulation, a correction of the layout, again.

Lin et al., "PAT3D: Physics-Augmented Text-to-3D Scene Generation", ICLR 2026, arXiv 2511.21978; its repository is
github.com/Simulation-Intelligence/PAT3D, read at commit 6abc823. This is an independent implementation.

Implemented: the initial layout in the poses that the generator of the assets gives (its layout from SAM 3D poses); the
preparation by the scene tree, every child above its parent and no two objects in each other; forward simulation to
static equilibrium; simulation in the loop over the objects' horizontal starting places, which pulls centres back to the
layout and boxes of children into those of their parents; the best of its rounds.

Replaced, and why:

- The gradient through a differentiable simulator (CUDA) by the identity: a resting place is taken to move as its start
  does. So an error is corrected by its whole length, and no learning rate is needed.
- Libuipc's affine bodies by MuJoCo without momentum (``simulator``), with the friction that everything is measured
  by. Theirs is .1, with which things slide farther.
- Overlaps of boxes by those of convex parts, which push objects less. Boxes would push apart what only nearly touches.
- What networks and services answer: ``given.STAND_INS``.

It has no fit to the photo: rotations and sizes stay those of the assets' poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from baselines.simulator import DEFAULT_SIMULATION, Simulation, at_rest
from contact_report import middle, shortest
from f3sr.contact import compounds
from f3sr.contact.compounds import Compound
from f3sr.contact.polytopes import Polytope
from f3sr.core.transforms import UP, Array, pose
from f3sr.scene import GROUND, Scene, SceneObject

GAP = 0.0025
"""Left between what is put apart [share of the scene's diagonal]: theirs is .005 in a scene 2 units long."""
SWEEPS = 32
"""Most rounds of pushes."""

Places = dict[int, Array]
"""Shifts (3,) [m] of objects by id."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Round:
    """A simulation: where it started from and ended, and its loss."""

    started: Scene
    rested: Scene
    loss: float
    """Mean square over objects of what is to be corrected [m2]."""


def reconstruct(
    scene: Scene, *, rounds: int = 5, simulation: Simulation = DEFAULT_SIMULATION
) -> tuple[Scene, list[Round]]:
    """The scene at rest of the best of some ``rounds`` (theirs are 5 epochs), and all of them.

    ``scene`` is the layout: levelled, with supports and proxies.
    """
    corrections: Places = {o.id: np.zeros(3) for o in scene}
    done: list[Round] = []
    for _ in range(rounds):
        started = prepared(moved(scene, corrections))
        rested = at_rest(started, simulation)
        errors = errors_of(scene, rested)
        done.append(Round(started=started, rested=rested, loss=float(np.mean([e @ e for e in errors.values()]))))
        corrections = {id: corrections[id] - error for id, error in errors.items()}
    return min(done, key=lambda r: r.loss).rested, done


def errors_of(layout: Scene, rested: Scene) -> Places:
    """How far every object rests from where it should, horizontally (3,) [m]: from its place in the layout, or from
    the place nearest to that where its box is within its parent's."""
    errors: Places = {}
    for o in rested:
        wanted = layout[o.id].bounds_world
        if o.supported_by is not None and o.supported_by != GROUND:
            wanted = wanted - _outside(wanted, rested[o.supported_by].bounds_world)
        errors[o.id] = (o.bounds_world - wanted).mean(0) * [1, 1, 0]
    return errors


def _outside(box: Array, around: Array) -> Array:
    """How far a box (2, 3) sticks out of another (3,) along each axis; of one that is too long, how far from its
    middle."""
    low, high = np.minimum(box[0] - around[0], 0), np.maximum(box[1] - around[1], 0)
    fits = np.ptp(box, axis=0) <= np.ptp(around, axis=0)
    return np.where(fits, low + high, (box - around).mean(0))


def prepared(scene: Scene) -> Scene:
    """No two objects in each other: first each child above its parent, then siblings apart, with all that they carry.

    What carries is placed first; whatever still overlaps after ``SWEEPS`` starts so.
    """
    gap = GAP * scene.diagonal
    for id in scene.supports_first:
        o = scene[id]
        carriers = [scene[c] for c in o.carriers if c != GROUND]
        sunk = max(0.0, gap - float(o.bounds_world[0, 2]))
        lift = max([sunk, *(shortest(body(o), body(c), UP) + gap for c in carriers if _meet(o, c))])
        scene = moved(scene, dict.fromkeys(scene.subtree(id), lift * UP))
    for _ in range(SWEEPS):
        pushes = 0
        for a, b in combinations([o.id for o in scene], 2):
            if a in scene.ancestors(b) or b in scene.ancestors(a) or not _meet(scene[a], scene[b]):
                continue
            A, B = body(scene[a]), body(scene[b])
            line = (middle(A) - middle(B)) * [1, 1, 0]
            length = float(np.linalg.norm(line))
            direction = line / length if length > 0 else np.array([1.0, 0, 0])
            half = (shortest(A, B, direction) + gap) / 2 * direction
            scene = moved(scene, dict.fromkeys(scene.subtree(a), half) | dict.fromkeys(scene.subtree(b), -half))
            pushes += 1
        if not pushes:
            break
    return scene


def moved(scene: Scene, shifts: Places) -> Scene:
    return scene.with_objects(
        *(scene[id].moved(pose(t=t), stage="pat3d", reason="layout") for id, t in shifts.items() if t.any())
    )


def body(o: SceneObject) -> Compound:
    return Compound.of(Polytope.of(part) for part in o.colliders_world)


def _meet(a: SceneObject, b: SceneObject) -> bool:
    """Whether two objects overlap: their boxes first, as that is quick, then their parts."""
    (low, high), (lowest, highest) = a.bounds_world, b.bounds_world
    return bool((low < highest).all() and (lowest < high).all()) and compounds.collide(body(a), body(b))
