"""What MuJoCo's models say of a package's objects, for all engines that load ``scene.xml``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def body_of(model: Any, name: str) -> dict[str, Any]:
    """Mass, centre of mass and inertia about it, in the frame of the body."""
    body = model.body(name)
    axes = rotation(body.iquat)
    return {
        "mass": float(body.mass[0]),
        "center": body.ipos.tolist(),
        "inertia": (axes @ np.diag(body.inertia) @ axes.T).tolist(),
    }


def state_of(model: Any, data: Any, names: Sequence[str]) -> dict[str, list[float]]:
    """Position and quaternion (w, x, y, z) of every body: of what is free from its joint, which ``mj_step`` moved."""
    return {name: _state(model, name, data.qpos, data.xpos, data.xquat) for name in names}


def states_from(model: Any, qpos: Any, xpos: Any, xquat: Any, names: Sequence[str]) -> dict[str, list[float]]:
    """The same of arrays: ``qpos`` (nq,), ``xpos`` (nbody, 3) and ``xquat`` (nbody, 4)."""
    return {name: _state(model, name, qpos, xpos, xquat) for name in names}


def depths(model: Any, data: Any, names: Sequence[str]) -> dict[str, float]:
    """The deepest overlap of every body [m] in the contacts of the last step."""
    ids = {int(model.body(name).id): name for name in names}
    found = dict.fromkeys(names, 0.0)
    for k in range(data.ncon):
        contact = data.contact[k]
        for geom in contact.geom:
            if name := ids.get(int(model.geom_bodyid[geom])):
                found[name] = max(found[name], -float(contact.dist))
    return found


def rotation(quaternion: Any) -> Any:
    """(3, 3) of a unit quaternion (w, x, y, z)."""
    w, x, y, z = (float(v) for v in quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _state(model: Any, name: str, qpos: Any, xpos: Any, xquat: Any) -> list[float]:
    id = int(model.body(name).id)
    if model.body_jntnum[id]:
        at = int(model.jnt_qposadr[model.body_jntadr[id]])
        return [float(v) for v in qpos[at : at + 7]]
    return [float(v) for v in (*xpos[id], *xquat[id])]
