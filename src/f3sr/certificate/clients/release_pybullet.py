"""PyBullet: the URDF of every object where ``poses.json`` says, on ``ground.urdf``, at the package's time step.

``URDF_INITIALIZE_SAT_FEATURES`` lets whole faces touch. Without it PyBullet grows every convex mesh by a millimetre.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from client_job import ClientJob
from mujoco_state import rotation

ITERATIONS = 200
"""Of the solver: with PyBullet's 50 a light body under a heavy one creeps, .2 mm a second of 40 g under 270 g."""


def main() -> None:
    job = ClientJob.from_arguments()
    p = job.library("pybullet")
    file = Path(job.file)
    world = json.loads(file.read_text())
    p.connect(p.DIRECT)
    p.setGravity(*world["gravity"])
    timestep = world["timestep"]
    p.setTimeStep(timestep)
    p.setPhysicsEngineParameter(numSolverIterations=ITERATIONS)
    flags = p.URDF_USE_INERTIA_FROM_FILE | p.URDF_INITIALIZE_SAT_FEATURES
    p.loadURDF(str(file.parent / world["ground"]["urdf"]), flags=flags)
    bodies, inertial = dict[str, int](), dict[str, tuple[Any, Any]]()
    for o in world["objects"]:
        body = p.loadURDF(
            str(file.parent / o["urdf"]),
            useFixedBase=o["fixed"],
            flags=flags,
        )
        told = p.getDynamicsInfo(body, -1)
        inertial[o["name"]] = (np.array(told[3]), np.array(told[4]))
        place = p.multiplyTransforms(o["position"], o["orientation"], told[3], told[4])
        p.resetBasePositionAndOrientation(body, *place)
        bodies[o["name"]] = body

    def state(name: str) -> list[float]:
        """Of the link's frame: Bullet tells that of the centre of mass."""
        place = p.getBasePositionAndOrientation(bodies[name])
        position, (x, y, z, w) = p.multiplyTransforms(*place, *p.invertTransform(*inertial[name]))
        return [*position, w, x, y, z]

    samples = [{name: state(name) for name in job.names}]
    deepest = dict.fromkeys(job.names, 0.0)
    owners = {body: name for name, body in bodies.items()}
    every = max(1, round(job.interval / timestep))
    for step in range(round(job.seconds / timestep)):
        p.stepSimulation()
        if (step + 1) % every == 0:
            samples.append({name: state(name) for name in job.names})
            for contact in p.getContactPoints():
                for body in contact[1:3]:
                    if name := owners.get(body):
                        deepest[name] = max(deepest[name], -contact[8])
    job.answer_release(
        packages=["pybullet"],
        settings=f"URDF_INITIALIZE_SAT_FEATURES; {ITERATIONS} iterations",
        timestep=timestep,
        bodies={o["name"]: _body(p, bodies[o["name"]]) for o in world["objects"] if not o["fixed"]},
        samples=samples,
        penetrations=deepest,
    )


def _body(p: Any, body: int) -> dict[str, Any]:
    told = p.getDynamicsInfo(body, -1)
    x, y, z, w = told[4]
    axes = rotation((w, x, y, z))
    return {"mass": told[0], "center": list(told[3]), "inertia": (axes @ np.diag(told[2]) @ axes.T).tolist()}


if __name__ == "__main__":
    main()
