"""A release on soft contacts without margins: MuJoCo's defaults, which models of other people have.

f3sr's own contacts are stiff, so that stacks do not creep. A pose that rests on them alone falls where somebody loads
the parts into another model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from f3sr.core.transforms import Array
from f3sr.physics.mujoco_model import MjModel, MjSpec, compiled, engine
from f3sr.physics.outlook import Outlook, Snapshot
from f3sr.physics.release import release_spec, released_pose
from f3sr.physics.settling import DEFAULT_SETTLING
from f3sr.scene import SceneObject

SOLREF = (0.02, 1.0)
"""Time constant [s] and damping ratio of a contact."""
SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
"""Contact impedance: least, most, width [m], midpoint and power."""
IMPRATIO = 1.0
"""Ratio of friction to normal impedance."""
SECONDS = 5.0
"""Length of the release [s], that of the release protocol."""


def soft_release(objects: Sequence[SceneObject], far: float) -> Mapping[int, Array]:
    """Poses (4, 4) of all objects by id after a release on soft contacts in which one travels farther than ``far`` [m].

    Empty where none does, or where a state is not finite (docs: physics).

    Masses and friction are those of the release protocol. Whether one travels is seen without damping. What falls would
    spin, so places are those of a run with the damping of ``settle``."""
    model = compiled(_softened(release_spec(objects, centred=True)))
    model.opt.disableflags |= int(engine().mjtDisableBit.mjDSBL_AUTORESET)  # a reset would hide a blow-up
    if not _travels(model, far):
        return {}
    data = engine().MjData(model)
    damping = 1 - DEFAULT_SETTLING.damping * model.opt.timestep
    for _ in range(_steps(model)):
        engine().mj_step(model, data)
        data.qvel *= damping
    return {o.id: released_pose(model, data, o) for o in objects} if np.isfinite(data.qpos).all() else {}


def _travels(model: MjModel, far: float) -> bool:
    """Whether a centre of mass is ever more than ``far`` [m] from where it began.

    It ends early where none would go so far even if its travel went on growing as it does."""
    data = engine().MjData(model)
    engine().mj_forward(model, data)
    seen, drifts = [Snapshot.of(data)], np.zeros(model.nbody - 1)
    window = round(DEFAULT_SETTLING.rest.window / model.opt.timestep)
    for left in reversed(range(_steps(model) // window)):
        for _ in range(window):
            engine().mj_step(model, data)
            drifts = np.maximum(drifts, np.linalg.norm(data.xipos - seen[0].centers, axis=1)[1:])
        if drifts.max() > far:
            return True
        seen.append(Snapshot.of(data))
        outlook = Outlook.of(seen, drifts, far, left)
        if outlook and outlook.rests:
            break
    return False


def _steps(model: MjModel) -> int:
    return round(SECONDS / model.opt.timestep)


def _softened(spec: MjSpec) -> MjSpec:
    """The specification with soft contacts, changed in place."""
    spec.option.impratio = IMPRATIO
    for geom in spec.geoms:
        geom.solref, geom.solimp, geom.margin = SOLREF, SOLIMP, 0.0
    return spec
