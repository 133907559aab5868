"""MuJoCo: ``scene.xml`` as it is, stepped by ``mj_step``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from client_job import ClientJob
from mujoco_state import body_of, depths, state_of


def main() -> None:
    job = ClientJob.from_arguments()
    mujoco = job.library("mujoco")
    model = mujoco.MjModel.from_xml_path(job.file)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    every = max(1, round(job.interval / model.opt.timestep))
    samples, deepest = [state_of(model, data, job.names)], dict[str, float]()
    for step in range(round(job.seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        if (step + 1) % every == 0:
            samples.append(state_of(model, data, job.names))
            _keep(deepest, depths(model, data, job.names))
    job.answer_release(
        packages=["mujoco", "mujoco-core"],
        settings="as in scene.xml",
        timestep=float(model.opt.timestep),
        bodies={name: body_of(model, name) for name in job.names},
        samples=samples,
        penetrations=deepest,
    )


def _keep(deepest: dict[str, float], found: Mapping[str, Any]) -> None:
    for name, depth in found.items():
        deepest[name] = max(deepest.get(name, 0.0), depth)


if __name__ == "__main__":
    main()
