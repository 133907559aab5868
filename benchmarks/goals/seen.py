"""What was filmed: a package's bodies and camera and a rollout's poses, read from their files alone, and distances.

Shares no code with the product: its formats are read here a second time.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from gaps import FAR, least_gap
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

GROUND = -1


@dataclass(frozen=True, eq=False, kw_only=True)
class Body:
    """One object: convex parts as vertices (n, 3) in its own frame [m]."""

    id: int
    label: str
    parts: list[np.ndarray]
    com: np.ndarray
    T: np.ndarray
    """Where scene.json has it, 4x4."""

    @cached_property
    def points(self) -> np.ndarray:
        return np.concatenate(self.parts)

    @cached_property
    def hull(self) -> np.ndarray:
        """Half-spaces (n, 4) of all parts' convex hull, inside where ``h[:3] @ x + h[3] <= 0``."""
        return ConvexHull(self.points).equations

    @cached_property
    def radius(self) -> float:
        return float(np.linalg.norm(self.points - self.com, axis=1).max())


@dataclass(frozen=True, eq=False, kw_only=True)
class Film:
    """A scene and where its bodies were: ``time`` (T,) [s], ``T`` id -> (T, 4, 4), recorded contacts."""

    bodies: dict[int, Body]
    K: np.ndarray
    T_world_camera: np.ndarray
    size: tuple[int, int]
    """Width and height of the photo [px]."""
    time: np.ndarray
    T: dict[int, np.ndarray]
    contacts: list[tuple[float, int, int, float]] = field(default_factory=list)

    def centre(self, id: int) -> np.ndarray:
        """(T, 3) centre of mass in the world."""
        return placed(self.T[id], self.bodies[id].com)

    def points(self, id: int, k: int) -> np.ndarray:
        """(n, 3) vertices of its parts in the world at a sample."""
        return placed(self.T[id][k], self.bodies[id].points)

    def uprights(self, id: int) -> np.ndarray:
        """(T, 3) what was up in a body at the start."""
        R = self.T[id][:, :3, :3]
        return R @ (R[0].T @ [0, 0, 1.0])

    def moved(self, id: int, since: np.ndarray | None = None) -> np.ndarray:
        """(T, 2) how far it is [m] and turned [deg] from its first sample or from a pose."""
        T0 = self.T[id][0] if since is None else since
        far = np.linalg.norm(self.centre(id) - placed(T0, self.bodies[id].com), axis=1)
        turned = Rotation.from_matrix(self.T[id][:, :3, :3] @ T0[:3, :3].T).magnitude()
        return np.stack([far, np.degrees(turned)], axis=1)

    @cached_property
    def right(self) -> np.ndarray:
        """The picture's right, along the table."""
        return unit(self.T_world_camera[:3, 0] * [1, 1, 0])

    @cached_property
    def away(self) -> np.ndarray:
        """From the camera into the picture, along the table."""
        return unit(self.T_world_camera[:3, 2] * [1, 1, 0])

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """(n, 2) pixels of world points; NaN behind the camera."""
        camera = (points - self.T_world_camera[:3, 3]) @ self.T_world_camera[:3, :3]
        seen = camera @ self.K.T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(camera[:, 2:] > 0, seen[:, :2] / seen[:, 2:], np.nan)

    def in_frame(self, id: int, k: int) -> float:
        """Share of a body's vertices that project into the picture."""
        pixels = self.pixels(self.points(id, k))
        return float(((pixels >= 0) & (pixels <= self.size)).all(axis=1).mean())

    def gap(self, a: int, b: int, k: int, far: float = FAR) -> float:
        """Distance [m] of two bodies at a sample, b may be GROUND; 0 where they touch or overlap, at most ``far``."""
        return self.gap_of(a, self.T[a][k], b, None if b == GROUND else self.T[b][k], far)

    def gap_of(self, a: int, Ta: np.ndarray, b: int, Tb: np.ndarray | None, far: float = FAR) -> float:
        """The same of poses."""
        A = self.bodies[a]
        if Tb is None:
            return float(np.clip(placed(Ta, A.points)[:, 2].min(), 0, far))
        B = self.bodies[b]
        if np.linalg.norm(placed(Ta, A.com) - placed(Tb, B.com)) > A.radius + B.radius + far:
            return far
        return least_gap([placed(Ta, p) for p in A.parts], [placed(Tb, p) for p in B.parts], far)


def read(package: Path, rollout: Path) -> Film:
    """The film of a rollout.npz in a package; a later phase's first sample is left out."""
    scene = json.loads((package / "scene.json").read_text())
    with np.load(rollout, allow_pickle=False) as arrays:
        time, ids, T = arrays["time"], arrays["ids"].tolist(), arrays["T_world_object"]
        kept = ~np.isin(np.arange(len(time)), arrays["starts"][1:] if "starts" in arrays else [])
        contacts = [(float(c[0]), int(c[1]), int(c[2]), float(c[3])) for c in arrays["contacts"].tolist()]
    return Film(
        bodies=bodies_of(package, scene),
        K=np.array(scene["camera"]["K"], float),
        T_world_camera=np.array(scene["camera"]["T_world_camera"], float),
        size=(scene["camera"]["width"], scene["camera"]["height"]),
        time=np.asarray(time[kept], float),
        T={id: np.asarray(T[kept, n], float) for n, id in enumerate(ids)},
        contacts=contacts,
    )


def bodies_of(package: Path, scene: dict[str, Any]) -> dict[int, Body]:
    return {
        o["id"]: Body(
            id=o["id"],
            label=o["label"] or "",
            parts=[vertices(package / p) for p in o["collision"]],
            com=np.array(o["center_of_mass"], float),
            T=np.array(o["T_world_object"], float),
        )
        for o in scene["objects"]
    }


def vertices(file: Path) -> np.ndarray:
    """(n, 3) of an OBJ file."""
    return np.array([line.split()[1:4] for line in file.read_text().splitlines() if line.startswith("v ")], float)


def placed(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (3,) or (n, 3) under a pose 4x4, or one point under poses (T, 4, 4)."""
    return points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., :3, 3]


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """[deg] between two vectors; 180 where one is nothing."""
    n = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(a @ b / n, -1, 1)))) if n > 0 else 180.0
