"""The rollout: the pose of every object at every sample, and the contact forces in between."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array, frozen
from f3sr.errors import InputError
from f3sr.files import npz
from f3sr.files.bounds import FARTHEST, MAX_OBJECTS
from f3sr.goals.plan import MOST_PHASES
from f3sr.scene import GROUND

CONTACT = np.dtype([("time", np.float64), ("a", np.int64), ("b", np.int64), ("force", np.float64)])
"""A row of ``contacts``: time [s] and largest normal force [N] between two ids since the sample before.

``a`` is the lower id; the ground is GROUND, -1."""
MAX_SAMPLES = 1001
"""Samples of a phase: a hundred in each of ten seconds, and the first."""
MAX_CONTACTS = 10_000_000
"""Rows of contacts of a rollout: ten thousand pairs at every sample."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Rollout:
    """Samples of a simulation: ``time`` (T,) [s], ``ids`` (N,), poses ``T_world_object`` (T, N, 4, 4) [m].

    ``contacts`` (C,) are rows of CONTACT, ordered by time. ``starts`` (P,) are the first samples of the phases; each is
    at the time of the sample before it. Raises ValueError if shapes disagree.
    """

    time: Array
    ids: NDArray[np.int64]
    T_world_object: Array
    contacts: NDArray[Any]
    starts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64))

    def __post_init__(self) -> None:
        T, N = len(self.time), len(self.ids)
        if self.T_world_object.shape != (T, N, 4, 4) or self.contacts.dtype != CONTACT:
            raise ValueError(f"poses {self.T_world_object.shape} of {T} times and {N} ids")
        types = {"time": float, "ids": np.int64, "T_world_object": float, "contacts": CONTACT, "starts": np.int64}
        for name, dtype in types.items():
            object.__setattr__(self, name, frozen(getattr(self, name), dtype))

    def poses(self, id: int) -> Array:
        """Poses (T, 4, 4) of an object in the world [m]. Raises KeyError for an unknown id."""
        return self.T_world_object[:, self.row(id)]

    def row(self, id: int) -> int:
        """Index of an object in ``ids`` and the second axis of ``T_world_object``. Raises KeyError."""
        found = np.flatnonzero(self.ids == id)
        if not len(found):
            raise KeyError(f"no object {id}; the rollout has {self.ids.tolist()}")
        return int(found[0])

    @property
    def phases(self) -> tuple[Rollout, ...]:
        """Every phase as a rollout of its own, with times from 0 on."""
        ends = [*self.starts[1:].tolist(), len(self.time)]
        return tuple(self._part(start, end) for start, end in zip(self.starts.tolist(), ends, strict=True))

    def _part(self, start: int, end: int) -> Rollout:
        at, last = float(self.time[start]), end == len(self.time)
        since = self.contacts["time"] >= at if start else np.ones(len(self.contacts), bool)
        contacts = self.contacts[since & (True if last else self.contacts["time"] < self.time[end])].copy()
        contacts["time"] -= at
        time, T = self.time[start:end] - at, self.T_world_object[start:end]
        return Rollout(time=time, ids=self.ids, T_world_object=T, contacts=contacts)

    def touches(self, a: int, b: int) -> NDArray[Any]:
        """Rows of ``contacts`` between two ids, by time."""
        low, high = sorted((a, b))
        return self.contacts[(self.contacts["a"] == low) & (self.contacts["b"] == high)]


def joined(phases: Sequence[Rollout]) -> Rollout:
    """One rollout of phases that follow each other, each with times from 0 on."""
    if len(phases) == 1:
        return phases[0]
    at = np.cumsum([0.0, *(float(p.time[-1]) for p in phases[:-1])])
    contacts = [p.contacts.copy() for p in phases]
    for rows, start in zip(contacts, at, strict=True):
        rows["time"] += start
    return Rollout(
        time=np.concatenate([p.time + start for p, start in zip(phases, at, strict=True)]),
        ids=phases[0].ids,
        T_world_object=np.concatenate([p.T_world_object for p in phases]),
        contacts=np.concatenate(contacts),
        starts=np.cumsum([0, *(len(p.time) for p in phases[:-1])]),
    )


def to_npz(rollout: Rollout) -> bytes:
    """The arrays as a zip of .npy files, the same bytes for the same values."""
    return npz.dump(**{name: getattr(rollout, name) for name in _ARRAYS})


def from_npz(file: Path) -> Rollout:
    """Read and validate a written rollout. Raises InputError with the file and its fault."""
    accepted = "a rollout that f3sr wrote: time, ids, T_world_object, contacts"
    rollout = Rollout(**npz.read(file, _ARRAYS, accepted=accepted))  # starts are missing in older files
    if fault := next(_faults(rollout), None):
        raise InputError(file, found=fault, accepted=accepted)
    return rollout


def _faults(rollout: Rollout) -> Iterator[str]:
    """Faults of values that no simulation produces."""
    time, poses, contacts = rollout.time, rollout.T_world_object, rollout.contacts
    starts = rollout.starts
    if not len(starts) or starts[0] != 0 or (np.diff(starts) <= 0).any() or starts[-1] >= max(len(time), 1):
        yield "starts of phases that do not rise from 0 on"
        return
    new = np.isin(np.arange(1, len(time)), starts)
    if not len(time) or not np.isfinite(time).all() or time[0] < 0 or (np.diff(time)[~new] <= 0).any():
        yield "times that do not rise from 0 on"
    if (np.diff(time)[new] != 0).any():
        yield "a phase that does not start when the one before it ends"
    if len(set(rollout.ids.tolist())) < len(rollout.ids):
        yield "an id twice"
    R, t = poses[..., :3, :3], poses[..., :3, 3]
    if not (np.abs(t) <= FARTHEST).all():
        yield f"places that are not finite, or more than {FARTHEST:,.0f} m away"
        return
    if not (np.abs(R) <= 2).all() or np.abs(R @ R.swapaxes(-1, -2) - np.eye(3)).max(initial=0) > TURN:
        yield "poses that are no rotations"
        return
    if (np.linalg.det(R) < 0).any() or (poses[..., 3, :] != [0, 0, 0, 1]).any():
        yield "poses that mirror or distort"
    known = {GROUND, *rollout.ids.tolist()}
    if not {*contacts["a"].tolist(), *contacts["b"].tolist()} <= known:
        yield "contacts of objects that it does not have"
    if not (np.isfinite(contacts["time"]).all() and np.isfinite(contacts["force"]).all()):
        yield "contacts that are not finite"


TURN = 1e-5
"""By which R R^T may differ from 1."""
_ARRAYS = {
    "time": npz.Wanted(kinds="f", shape=("T",), most=MOST_PHASES * MAX_SAMPLES),
    "ids": npz.Wanted(kinds="i", shape=("N",), most=MAX_OBJECTS),
    "T_world_object": npz.Wanted(kinds="f", shape=("T", "N", 4, 4)),
    "contacts": npz.Wanted(dtype=CONTACT, shape=("C",), most=MAX_CONTACTS),
    "starts": npz.Wanted(kinds="i", shape=("P",), most=MOST_PHASES, optional=True),
}
