"""Forward simulation until nothing moves, without momentum: the simulator of both baselines.

PAT3D's published simulator drops velocities after every frame of .03 s. Here velocities decay with that time constant,
in MuJoCo, with the contact model that all methods are measured by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from f3sr.core.transforms import Array, pose
from f3sr.physics.mujoco_model import DEFAULT_PHYSICS, body_name, build_spec, engine
from f3sr.physics.near_pairs import NearPairs
from f3sr.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """How bodies move and when they stand still; the defaults are PAT3D's published ones."""

    frame: float = 0.03
    """Time constant in which momentum is lost, and time between two looks at the bodies [s]."""
    still_frames: int = 10
    """Frames in a row without motion after which the scene stands still."""
    still_shift: float = 5e-5
    """Largest shift in a frame that is no motion [share of the scene's diagonal]: 1e-4 of a scene 2 units long."""
    still_turn: float = 1e-4
    """Largest change of an entry of a rotation in a frame that is no motion."""
    seconds: float = 9.0
    """Most simulated time [s]: 300 frames."""


DEFAULT_SIMULATION = Simulation()


def at_rest(scene: Scene, simulation: Simulation = DEFAULT_SIMULATION) -> Scene:
    """The scene where its objects stand still, or where they are after ``seconds``; as it was where that blows up."""
    mujoco = engine()
    near = NearPairs(build_spec(scene.objects, DEFAULT_PHYSICS, ground_friction=scene.ground.friction), DEFAULT_PHYSICS)
    data, step = mujoco.MjData(near.model), near.model.opt.timestep
    kept = np.exp(-step / simulation.frame)
    mujoco.mj_forward(near.model, data)
    still, last = 0, _places(data)
    for _ in range(round(simulation.seconds / simulation.frame)):
        for _ in range(round(simulation.frame / step)):
            near.step(data)
            data.qvel *= kept
        if not np.isfinite(data.qpos).all():
            return scene
        now = _places(data)
        shift, turn = (float(np.abs(a - b).max()) for a, b in zip(now, last, strict=True))
        moves = shift > simulation.still_shift * scene.diagonal or turn > simulation.still_turn
        still, last = 0 if moves else still + 1, now
        if still == simulation.still_frames:
            break
    bodies = ((o, data.body(body_name(o.id))) for o in scene if o.mobility == "dynamic")
    return scene.with_objects(
        *(replace(o, T_world_object=pose(body.xmat.reshape(3, 3), body.xpos)) for o, body in bodies)
    )


def _places(data: object) -> tuple[Array, Array]:
    """Positions (n, 3) [m] and orientations (n, 9) of all bodies."""
    return data.xpos.copy(), data.xmat.copy()  # type: ignore[attr-defined]
