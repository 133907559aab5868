"""The physics pre-run: things are put down in MuJoCo and come to rest, so that the true poses are exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from f3sr.core.transforms import Array, pose, quaternion_from_rotation, rotation_from_quaternion
from tabletop.things import Thing

TIMESTEP = 0.002


@dataclass(frozen=True, kw_only=True)
class Rest:
    """The scene at rest: poses, who touches whom, who carries whom, and how still it is."""

    T_world_object: tuple[Array, ...]
    contacts: list[tuple[int, int]]
    supports: list[tuple[int, int]]
    """(carried, carrier) pairs; the table is -1, as the world body's number less one."""
    kinetic: float
    """Largest total kinetic energy in a second after an undamped release [J]."""


def settle(things: Sequence[Thing], *, seconds: float = 3.0) -> Rest:
    """Release everything from its first pose, damped, then verify in a fresh undamped state."""
    model = build(things)
    data = mujoco.MjData(model)
    for _ in range(int(seconds / TIMESTEP)):
        data.qvel *= 1 - 4 * TIMESTEP
        mujoco.mj_step(model, data)
    qpos = data.qpos.copy()
    kinetic = release(model, qpos)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    contacts, supports = touching(model, data)
    poses = tuple(pose(rotation_from_quaternion(q[3:]), q[:3]) for q in qpos.reshape(-1, 7))
    return Rest(T_world_object=poses, contacts=contacts, supports=supports, kinetic=kinetic)


def build(things: Sequence[Thing]) -> Any:
    """Settings that rest: elliptic cones, stiff contact, a margin, rolling friction for round things."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.impratio = TIMESTEP, 10
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    contact = {  # margins of a pair add up: things rest .2 mm apart
        "friction": [0.6, 0.005, 0.001],
        "solref": [0.005, 1],
        "solimp": [0.95, 0.99, 0.0005, 0.5, 2],
        "margin": 1e-4,
    }
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1], condim=4, **contact)
    for i, thing in enumerate(things):
        T = thing.T_start
        body = spec.worldbody.add_body(name=thing.label, pos=T[:3, 3], quat=quaternion_from_rotation(T[:3, :3]))
        body.add_freejoint()
        density = thing.mass / sum(float(ConvexHull(part).volume) for part in thing.shape.parts)
        mesh, condim = mujoco.mjtGeom.mjGEOM_MESH, 6 if thing.round else 4
        for k, part in enumerate(thing.shape.parts):
            spec.add_mesh(name=f"{i}_{k}", uservert=part.astype(np.float32).ravel())
            body.add_geom(type=mesh, meshname=f"{i}_{k}", density=density, condim=condim, **contact)
    return spec.compile()


def release(model: Any, qpos: Array) -> float:
    """The largest kinetic energy [J] in the first second of an undamped run from ``qpos``."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    peak = 0.0
    for _ in range(int(1 / TIMESTEP)):
        mujoco.mj_step(model, data)
        mujoco.mj_energyVel(model, data)
        peak = max(peak, float(data.energy[1]))
    return peak


def touching(model: Any, data: Any) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Pairs that touch, and (carried, carrier) pairs by the vertical contact force between them."""
    lift: dict[tuple[int, int], float] = {}
    for k, contact in enumerate(data.contact):
        a, b = sorted(int(model.geom_bodyid[g]) - 1 for g in contact.geom)
        force = np.zeros(6)
        mujoco.mj_contactForce(model, data, k, force)
        upward = (contact.frame.reshape(3, 3).T @ force[:3])[2]
        toward = 1 if int(model.geom_bodyid[contact.geom[1]]) - 1 == b else -1
        lift[a, b] = lift.get((a, b), 0.0) + toward * float(upward)
    supports = sorted((b, a) if f > 0 else (a, b) for (a, b), f in lift.items() if abs(f) > 1e-3)
    return sorted(lift), supports
