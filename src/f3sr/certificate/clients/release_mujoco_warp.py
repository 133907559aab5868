"""MuJoCo Warp on a processor: ``scene.xml`` as it is, in one world."""

from __future__ import annotations

import numpy as np
from client_job import ClientJob
from mujoco_state import body_of, states_from

ROOM = 4
"""Contacts and constraints that there is room for, as a multiple of those at the start: what touches changes."""
LEAST = 256


def main() -> None:
    job = ClientJob.from_arguments()
    mujoco = job.library("mujoco")
    warp = job.library("warp")
    mjw = job.library("mujoco_warp")
    warp.config.quiet = True
    job.say("compiling")
    with warp.ScopedDevice("cpu"):
        host = mujoco.MjModel.from_xml_path(job.file)
        state = mujoco.MjData(host)
        mujoco.mj_forward(host, state)
        model = mjw.put_model(host)
        contacts, rows = max(LEAST, ROOM * state.ncon), max(LEAST, ROOM * state.nefc)
        data = mjw.put_data(host, state, nconmax=contacts, njmax=rows)

        def sample() -> dict[str, list[float]]:
            qpos, xpos, xquat = (array.numpy()[0] for array in (data.qpos, data.xpos, data.xquat))
            return states_from(host, qpos, xpos, xquat, job.names)

        samples, deepest = [sample()], dict.fromkeys(job.names, 0.0)
        ids = {int(host.body(name).id): name for name in job.names}
        every = max(1, round(job.interval / host.opt.timestep))
        for step in range(round(job.seconds / host.opt.timestep)):
            mjw.step(model, data)
            if (step + 1) % every == 0:
                samples.append(sample())
                job.say(f"{(step + 1) * host.opt.timestep:.1f} s")
                count = min(int(data.nacon.numpy()[0]), len(data.contact.dist.numpy()))
                for dist, geoms in zip(
                    data.contact.dist.numpy()[:count], data.contact.geom.numpy()[:count], strict=True
                ):
                    for geom in geoms:
                        if name := ids.get(int(host.geom_bodyid[geom])):
                            deepest[name] = max(deepest[name], -float(dist))
        overflow = _overflow(data, contacts, rows)
    job.answer_release(
        packages=["mujoco-warp", "warp-lang", "mujoco"],
        settings=f"as in scene.xml; room for {contacts} contacts and {rows} constraints",
        timestep=float(host.opt.timestep),
        bodies={name: body_of(host, name) for name in job.names},
        samples=samples,
        penetrations=deepest,
        notes=overflow,
    )


def _overflow(data: object, contacts: int, rows: int) -> list[str]:
    used = int(np.max(getattr(data, "nacon").numpy())), int(np.max(getattr(data, "nefc").numpy()))  # noqa: B009
    return (
        [f"{used[0]} contacts and {used[1]} constraints at the end"] if used[0] >= contacts or used[1] >= rows else []
    )


if __name__ == "__main__":
    main()
