"""Newton on a processor: ``scene.xml`` by its MJCF importer, stepped by its MuJoCo solver."""

from __future__ import annotations

from typing import Any

import numpy as np
from client_job import ClientJob

TIMESTEP = 0.002
"""[s], that of the package."""


def main() -> None:
    job = ClientJob.from_arguments()
    warp = job.library("warp")
    newton = job.library("newton")
    warp.config.quiet = True
    job.say("compiling")
    with warp.ScopedDevice("cpu"):
        builder = newton.ModelBuilder()
        newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
        builder.add_mjcf(job.file)
        model = builder.finalize()
        labels = [str(label).rpartition("/")[2] for label in model.body_label]
        solver = newton.solvers.SolverMuJoCo(model, njmax=2000, nconmax=1000)
        state, after = model.state(), model.state()
        control = model.control()
        newton.eval_fk(model, model.joint_q, model.joint_qd, state)
        place = {name: labels.index(name) for name in job.names}

        def sample(of: Any) -> dict[str, list[float]]:
            poses = of.body_q.numpy()
            found = dict[str, list[float]]()
            for name, k in place.items():
                x, y, z, a, b, c, w = map(float, poses[k])
                found[name] = [x, y, z, w, a, b, c]
            return found

        samples = [sample(state)]
        every = max(1, round(job.interval / TIMESTEP))
        for step in range(round(job.seconds / TIMESTEP)):
            state.clear_forces()
            solver.step(state, after, control, None, TIMESTEP)
            state, after = after, state
            if (step + 1) % every == 0:
                samples.append(sample(state))
                job.say(f"{(step + 1) * TIMESTEP:.1f} s")
        masses, centers, inertias = (a.numpy() for a in (model.body_mass, model.body_com, model.body_inertia))
    job.answer_release(
        packages=["newton", "mujoco-warp", "warp-lang"],
        settings="add_mjcf, SolverMuJoCo",
        timestep=TIMESTEP,
        bodies={
            name: {
                "mass": float(masses[k]),
                "center": np.asarray(centers[k], float).tolist(),
                "inertia": np.asarray(inertias[k], float).tolist(),
            }
            for name, k in place.items()
        },
        samples=samples,
        penetrations=None,
    )


if __name__ == "__main__":
    main()
