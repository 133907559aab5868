"""The rollout: the pose of every object at every sample, and the contact forces in between."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array, frozen
from f3sr.errors import InputError
from f3sr.files import npz
from f3sr.files.bounds import FARTHEST, MAX_OBJECTS
from f3sr.scene import GROUND

CONTACT = np.dtype([("time", np.float64), ("a", np.int64), ("b", np.int64), ("force", np.float64)])
"""A row of ``contacts``: time [s] and largest normal force [N] between two ids since the sample before.

``a`` is the lower id; the ground is GROUND, -1."""
MAX_SAMPLES = 1001
"""Samples of a rollout: a hundred in each of ten seconds, and the first."""
MAX_CONTACTS = 10_000_000
"""Rows of contacts of a rollout: ten thousand pairs at every sample."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Rollout:
    """Samples of a simulation: ``time`` (T,) [s], ``ids`` (N,), poses ``T_world_object`` (T, N, 4, 4) [m].

    ``contacts`` (C,) are rows of CONTACT, ordered by time. Raises ValueError if shapes disagree.
    """

    time: Array
    ids: NDArray[np.int64]
    T_world_object: Array
    contacts: NDArray[Any]

    def __post_init__(self) -> None:
        T, N = len(self.time), len(self.ids)
        if self.T_world_object.shape != (T, N, 4, 4) or self.contacts.dtype != CONTACT:
            raise ValueError(f"poses {self.T_world_object.shape} of {T} times and {N} ids")
        for name, dtype in (("time", float), ("ids", np.int64), ("T_world_object", float), ("contacts", CONTACT)):
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

    def touches(self, a: int, b: int) -> NDArray[Any]:
        """Rows of ``contacts`` between two ids, by time."""
        low, high = sorted((a, b))
        return self.contacts[(self.contacts["a"] == low) & (self.contacts["b"] == high)]


def to_npz(rollout: Rollout) -> bytes:
    """The arrays as a zip of .npy files, the same bytes for the same values."""
    return npz.dump(**{name: getattr(rollout, name) for name in _ARRAYS})


def from_npz(file: Path) -> Rollout:
    """Read and validate a written rollout. Raises InputError with the file and its fault."""
    accepted = "a rollout that f3sr wrote: time, ids, T_world_object, contacts"
    rollout = Rollout(**npz.read(file, _ARRAYS, accepted=accepted))
    if fault := next(_faults(rollout), None):
        raise InputError(file, found=fault, accepted=accepted)
    return rollout


def _faults(rollout: Rollout) -> Iterator[str]:
    """Faults of values that no simulation produces."""
    time, poses, contacts = rollout.time, rollout.T_world_object, rollout.contacts
    if not len(time) or not np.isfinite(time).all() or time[0] < 0 or (np.diff(time) <= 0).any():
        yield "times that do not rise from 0 on"
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
    "time": npz.Wanted(kinds="f", shape=("T",), most=MAX_SAMPLES),
    "ids": npz.Wanted(kinds="i", shape=("N",), most=MAX_OBJECTS),
    "T_world_object": npz.Wanted(kinds="f", shape=("T", "N", 4, 4)),
    "contacts": npz.Wanted(dtype=CONTACT, shape=("C",), most=MAX_CONTACTS),
}
