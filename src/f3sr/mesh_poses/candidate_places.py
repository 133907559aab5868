"""Where meshes stand by each of many readings of their files, as arrays: readings are compared by the hundred."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from f3sr.backends.protocols import GivenPose
from f3sr.core.transforms import Array
from f3sr.io.pose_conventions import (
    Order,
    PoseConvention,
    SignedAxes,
    Vectors,
    camera_name,
    rotation_as_read,
)


@dataclass(frozen=True, eq=False, kw_only=True)
class CandidatePlaces:
    """k readings of n files: a vertex v is at ``x_camera = scale R v + t``, OpenCV axes.

    R is orthogonal; where its determinant is -1 the file is left-handed and shows the object mirrored."""

    ids: tuple[int, ...]
    """(n,) of the objects."""
    names: tuple[str, ...]
    """(k,) of the readings, the usual ones first."""
    R: Array
    """(k, n, 3, 3)"""
    t: Array
    """(k, n, 3), in the unit that the producer gives places in."""
    scale: Array
    """(k, n), of that unit per unit of the file."""
    own: Array
    """(k, 3, 3): the axes in which an object is kept, from those of its file; they mirror where R does."""

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def of_poses(cls, poses: Mapping[int, GivenPose], conventions: Sequence[PoseConvention]) -> Self:
        """Poses by each of some conventions."""
        ids = tuple(poses)
        kinds: set[tuple[Order, Vectors]] = {(c.order, c.vectors) for c in conventions}
        turned = {
            kind: np.stack([rotation_as_read(poses[id].rotation, *kind) for id in ids]) for kind in kinds
        }  # each (n, 3, 3)
        F = np.stack([c.camera.matrix for c in conventions])
        A = np.stack([c.mesh.matrix for c in conventions])
        Q = np.stack([turned[c.order, c.vectors] for c in conventions])
        return cls(
            ids=ids,
            names=tuple(c.name for c in conventions),
            R=np.einsum("kij,knjl,klm->knim", F, Q, A),
            t=np.einsum("kij,nj->kni", F, np.array([poses[id].translation for id in ids])),
            scale=np.tile([poses[id].scale for id in ids], (len(conventions), 1)),
            own=np.stack([c.own for c in conventions]),
        )

    @classmethod
    def of_frames(cls, ids: Sequence[int], cameras: Sequence[SignedAxes]) -> Self:
        """Files whose vertices are in a camera's frame, by each of some axes of that camera."""
        k, n = len(cameras), len(ids)
        F = np.stack([c.matrix for c in cameras])
        return cls(
            ids=tuple(ids),
            names=tuple(camera_name(c) for c in cameras),
            R=np.repeat(F[:, None], n, axis=1),
            t=np.zeros((k, n, 3)),
            scale=np.ones((k, n)),
            own=F,
        )

    def chosen(self, which: Sequence[int], *, scale: Array | None = None) -> Self:
        """Some of the readings, by index, perhaps with other scales (len(which), n)."""
        index = np.asarray(which, int)
        return type(self)(
            ids=self.ids,
            names=tuple(self.names[k] for k in index),
            R=self.R[index],
            t=self.t[index],
            scale=self.scale[index] if scale is None else scale,
            own=self.own[index],
        )
