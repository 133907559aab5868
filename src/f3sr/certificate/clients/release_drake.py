"""Drake: ``scene.sdf`` in a discrete MultibodyPlant with its default contact model."""

from __future__ import annotations

from typing import Any

from client_job import ClientJob

TIMESTEP = 0.002
"""[s], that of the package: a discrete plant has no default."""

STICTION = 1e-5
"""Speed at which what sticks may slide [m/s]: Drake smooths friction, and what leans creeps. No file can say it."""


def main() -> None:
    job = ClientJob.from_arguments()
    job.library("pydrake")
    plants = job.library("pydrake.multibody.plant")
    parsing = job.library("pydrake.multibody.parsing")
    builders = job.library("pydrake.systems.framework")
    analysis = job.library("pydrake.systems.analysis")
    builder = builders.DiagramBuilder()
    plant, _ = plants.AddMultibodyPlantSceneGraph(builder, TIMESTEP)
    parsing.Parser(plant).AddModels(job.file)
    plant.set_stiction_tolerance(STICTION)
    plant.Finalize()
    diagram = builder.Build()
    simulator = analysis.Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    links = {name: plant.GetBodyByName("link", plant.GetModelInstanceByName(name)) for name in job.names}

    def sample() -> dict[str, list[float]]:
        return {name: _state(plant.EvalBodyPoseInWorld(context, link)) for name, link in links.items()}

    owners = {link.index(): name for name, link in links.items()}
    deepest, samples = dict.fromkeys(job.names, 0.0), [sample()]
    for k in range(round(job.seconds / job.interval)):
        simulator.AdvanceTo((k + 1) * job.interval)
        samples.append(sample())
        results = plant.get_contact_results_output_port().Eval(context)
        for i in range(results.num_point_pair_contacts()):
            contact = results.point_pair_contact_info(i)
            for body in (contact.bodyA_index(), contact.bodyB_index()):
                if name := owners.get(body):
                    deepest[name] = max(deepest[name], contact.point_pair().depth)
    model, solver = plant.get_contact_model().name, plant.get_discrete_contact_approximation().name
    job.answer_release(
        packages=["drake"],
        settings=f"{model}, {solver}, stiction {STICTION:g} m/s",
        timestep=TIMESTEP,
        bodies={name: _body(context, link) for name, link in links.items() if link.get_mass(context) > 0},
        samples=samples,
        penetrations=deepest,
    )


def _body(context: Any, link: Any) -> dict[str, Any]:
    spatial = link.CalcSpatialInertiaInBodyFrame(context)
    center = spatial.get_com()
    about = spatial.Shift(center).CalcRotationalInertia()
    return {
        "mass": spatial.get_mass(),
        "center": center.tolist(),
        "inertia": about.CopyToFullMatrix3().tolist(),
    }


def _state(pose: Any) -> list[float]:
    return [*pose.translation().tolist(), *pose.rotation().ToQuaternion().wxyz().tolist()]


if __name__ == "__main__":
    main()
