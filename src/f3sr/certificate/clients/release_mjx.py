"""MJX (JAX) on a processor: ``scene.xml`` as it is, compiled as a whole."""

from __future__ import annotations

from typing import Any

from client_job import ClientJob
from mujoco_state import body_of, states_from


def main() -> None:
    job = ClientJob.from_arguments()
    mujoco = job.library("mujoco")
    jax = job.library("jax")
    mjx = job.library("mujoco.mjx")
    host = mujoco.MjModel.from_xml_path(job.file)
    data = mujoco.MjData(host)
    mujoco.mj_forward(host, data)
    model = mjx.put_model(host)
    state = mjx.put_data(host, data)
    every = max(1, round(job.interval / host.opt.timestep))
    job.say("compiling")

    def step(_: Any, state: Any) -> Any:
        return mjx.step(model, state)

    def interval(state: Any) -> Any:
        return jax.lax.fori_loop(0, every, step, state)

    advance = jax.jit(interval)
    samples = [states_from(host, data.qpos, data.xpos, data.xquat, job.names)]
    for _ in range(round(job.seconds / host.opt.timestep / every)):
        state = advance(state)
        samples.append(states_from(host, state.qpos, state.xpos, state.xquat, job.names))
        job.say(f"{len(samples) * every * host.opt.timestep:.1f} s")
    job.answer_release(
        packages=["mujoco-mjx", "mujoco", "jax"],
        settings="as in scene.xml",
        timestep=float(host.opt.timestep),
        bodies={name: body_of(host, name) for name in job.names},
        samples=samples,
    )


if __name__ == "__main__":
    main()
