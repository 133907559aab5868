"""A second writing of the rollout in plain MuJoCo, which shares no code with the product.

usage: python benchmarks/goals/replay.py PACKAGE ROLLOUT_FOLDER ...
Reads the package's scene.xml and scene.json and every folder's plan.json, plays the plan and compares with its
rollout.npz. Exit codes: 0 every rollout reproduced within 1 mm, 1 one is not.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

WITHIN = 1e-3
"""[m]"""


def main() -> int:
    package, folders = Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]]
    worst = [difference(package, folder) for folder in folders]
    for folder, off in zip(folders, worst, strict=True):
        print(f"{folder}: {1000 * off:.4f} mm")
    return int(max(worst, default=0.0) > WITHIN)


def difference(package: Path, folder: Path) -> float:
    """The largest distance [m] of a body's origin between a rollout and its replay, over all samples."""
    plan = json.loads((folder / "plan.json").read_text())
    with np.load(folder / "rollout.npz") as rollout:
        origins, ids = rollout["T_world_object"][:, :, :3, 3], rollout["ids"].tolist()
    mine = replayed(package, plan["phases"], ids)
    return float(np.linalg.norm(mine[: len(origins)] - origins, axis=2).max())


def replayed(package: Path, phases: list[dict[str, Any]], ids: list[int]) -> Any:
    """Origins (T, N, 3) [m] of all bodies under a plan's phases, each from the places of the one before, at rest."""
    found, ends = [], None
    for phase in phases:
        origins, ends = replayed_phase(package, phase, ids, ends)
        found.append(origins)
    return np.concatenate(found)


def replayed_phase(package: Path, plan: dict[str, Any], ids: list[int], start: Any) -> tuple[Any, Any]:
    """Origins (T, N, 3) [m] of all bodies in a phase, and the coordinates at its end."""
    spec = mujoco.MjSpec.from_file(str(package / "scene.xml"))
    spec.option.timestep = plan["simulation"]["timestep"]
    records = {o["id"]: o for o in json.loads((package / "scene.json").read_text())["objects"]}
    for made in plan["semantics"]:
        body = next(b for b in spec.bodies if is_of(made["id"], b.name))
        was = records[made["id"]]["density"]
        body.mass = made["density"] * (body.mass / was)
        body.fullinertia = made["density"] * (np.array(body.fullinertia) / was)
        for geom in (g for g in body.geoms if g.contype):
            geom.friction = [made["friction"], 0.005, made["rolling_friction"]]
            if made["restitution"] > math.exp(-2):
                geom.solref, geom.priority = [-4e4, -400 * damping_ratio(made["restitution"])], 1
    for mesh in spec.meshes:  # scene.xml has no margin: its ground and parts are grown by it
        mesh.file = mesh.file.replace("_grown.", ".")
    for geom in (g for g in spec.geoms if g.contype):
        geom.margin = plan["simulation"]["margin"]
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.pos = 0, 0, 0
    model = spec.compile()
    package_state, data = mujoco.MjData(model), mujoco.MjData(model)
    if start is not None:
        package_state.qpos[:] = start
    mujoco.mj_forward(model, package_state)
    for offset in plan["initial"]["offsets"]:
        displace(model, package_state, offset)
    data.qpos[:] = package_state.qpos  # nothing else is carried over: solvers start from what was
    mujoco.mj_forward(model, data)
    for velocity in plan["initial"]["velocities"]:
        set_off(model, data, velocity)
    impulses, dt = plan["initial"]["impulses"], model.opt.timestep
    pushes = [(math.ceil(i["time"] / dt - 1e-9), max(1, round(i["duration"] / dt)), i) for i in impulses]
    bodies, kept = [number(model, id) for id in ids], np.ones(model.nv)
    for made in plan["semantics"]:
        at = model.body_dofadr[number(model, made["id"])]
        kept[at : at + model.body_dofnum[number(model, made["id"])]] -= made["damping"] * dt
    found = [data.xpos[bodies].copy()]
    for step in range(round(plan["simulation"]["duration"] / dt)):
        for first, steps, push in pushes:
            if first <= step < first + steps:
                wrench = np.array([*push["linear"], *push["angular"]])
                data.xfrc_applied[number(model, push["id"])] += wrench / (steps * dt)
        mujoco.mj_step(model, data)
        data.xfrc_applied[:] = 0
        data.qvel *= kept
        if (step + 1) % plan["simulation"]["steps_per_sample"] == 0:
            now = mujoco.MjData(model)
            now.qpos[:] = data.qpos
            mujoco.mj_kinematics(model, now)
            found.append(now.xpos[bodies].copy())
    return np.array(found), data.qpos


def set_off(model: Any, data: Any, velocity: dict[str, Any]) -> None:
    """Velocities of the centre of mass and of turning, both in world axes, as those of the free joint."""
    b = number(model, velocity["id"])
    at, R, arm = model.body_dofadr[b], data.xmat[b].reshape(3, 3), data.xpos[b] - data.xipos[b]
    data.qvel[at : at + 3] = velocity["linear"] + np.cross(velocity["angular"], arm)
    data.qvel[at + 3 : at + 6] = R.T @ velocity["angular"]


def displace(model: Any, data: Any, offset: dict[str, Any]) -> None:
    """Turn a body about its centre of mass and shift it."""
    b = number(model, offset["id"])
    at = model.jnt_qposadr[model.body_jntadr[b]]
    if angle := float(np.linalg.norm(offset["rotation"])):
        turn, arm = np.zeros(4), np.zeros(3)
        mujoco.mju_axisAngle2Quat(turn, np.array(offset["rotation"]) / angle, angle)
        mujoco.mju_mulQuat(data.qpos[at + 3 : at + 7], turn, data.xquat[b])
        mujoco.mju_rotVecQuat(arm, data.xpos[b] - data.xipos[b], turn)
        data.qpos[at : at + 3] = data.xipos[b] + arm
    data.qpos[at : at + 3] += offset["translation"]


def damping_ratio(restitution: float) -> float:
    """Of a contact whose spring and dashpot push but never pull, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(60):
        z = (low + high) / 2
        w = math.sqrt(1 - z * z)
        left = math.exp(-z / w * math.atan2(2 * z * w, 2 * z * z - 1))
        low, high = (z, high) if left > restitution else (low, z)
    return low


def number(model: Any, id: int) -> int:
    return next(k for k in range(1, model.nbody) if is_of(id, model.body(k).name))


def is_of(id: int, body: str) -> bool:
    """Bodies are named ``red_mug_03``: the id ends the name."""
    return body.rpartition("_")[2] == f"{id:02d}"


if __name__ == "__main__":
    sys.exit(main())
