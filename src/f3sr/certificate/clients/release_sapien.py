"""SAPIEN (PhysX on a processor): the URDF of every object where ``poses.json`` says, on ``ground.urdf``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from client_job import ClientJob
from mujoco_state import rotation

ITERATIONS = 32
"""Of positions, as in the PhysX variant of the export to USD: with SAPIEN's 10 bodies creep and turn."""


def main() -> None:
    job = ClientJob.from_arguments()
    sapien = job.library("sapien")
    physx = job.library("sapien.physx")
    file = Path(job.file)
    world = json.loads(file.read_text())
    physx.set_scene_config(gravity=np.array(world["gravity"], np.float32))
    physx.set_body_config(solver_position_iterations=ITERATIONS)
    scene = sapien.Scene([physx.PhysxCpuSystem()])
    timestep = world["timestep"]
    scene.set_timestep(timestep)
    bodies = {o["name"]: _loaded(scene, sapien, file.parent / o["urdf"], o, job.folder) for o in world["objects"]}
    ground = world["ground"]
    loader = _loader(scene, ground["friction"], restitution=0)
    loader.load(str(file.parent / ground["urdf"]))

    def sample() -> dict[str, list[float]]:
        return {name: [*map(float, e.pose.p), *map(float, e.pose.q)] for name, e in bodies.items()}

    samples = [sample()]
    deepest = dict.fromkeys(job.names, 0.0)
    owners = {entity: name for name, entity in bodies.items()}
    every = max(1, round(job.interval / timestep))
    for step in range(round(job.seconds / timestep)):
        scene.step()
        if (step + 1) % every == 0:
            samples.append(sample())
            for contact in scene.get_contacts():
                for body in contact.bodies:
                    if name := owners.get(body.entity):
                        depth = max((-float(point.separation) for point in contact.points), default=0.0)
                        deepest[name] = max(deepest[name], depth)
    job.answer_release(
        packages=["sapien"],
        settings=f"{ITERATIONS} position iterations",
        timestep=timestep,
        bodies={o["name"]: _body(physx, bodies[o["name"]]) for o in world["objects"] if not o["fixed"]},
        samples=samples,
        penetrations=deepest,
    )


def _loaded(scene: Any, sapien: Any, urdf: Path, o: dict[str, Any], folder: Path) -> Any:
    """The one link of a URDF as an actor, with the friction that SAPIEN takes from its loader, not from the file."""
    loader = _loader(scene, o["friction"], o["restitution"])
    _, actors, _ = loader.parse(str(_without_looks(urdf, folder)))
    (builder,) = actors
    builder.set_physx_body_type("kinematic" if o["fixed"] else "dynamic")
    x, y, z, w = o["orientation"]
    builder.set_initial_pose(sapien.Pose(o["position"], [w, x, y, z]))
    return builder.build(name=o["name"])


def _loader(scene: Any, friction: float, restitution: float) -> Any:
    loader = scene.create_urdf_loader()
    loader.set_material(friction, friction, restitution)
    return loader


def _without_looks(urdf: Path, folder: Path) -> Path:
    """The same URDF in the job folder without its looks, for which SAPIEN wants a graphics card."""
    tree = ET.parse(urdf)
    for link in tree.getroot().iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        for mesh in link.iter("mesh"):
            mesh.set("filename", str(urdf.parent / mesh.get("filename", "")))
    copy = folder / urdf.name
    tree.write(copy)
    return copy


def _body(physx: Any, entity: Any) -> dict[str, Any]:
    body = entity.find_component_by_type(physx.PhysxRigidDynamicComponent)
    pose = body.cmass_local_pose
    axes = rotation(pose.q)
    return {
        "mass": float(body.mass),
        "center": [float(v) for v in pose.p],
        "inertia": (axes @ np.diag(np.asarray(body.inertia, float)) @ axes.T).tolist(),
    }


if __name__ == "__main__":
    main()
