"""A model's physical properties written into a package: scene.json, the exporters' files and the measures with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace

from f3sr.agents import answer_checks, prompts
from f3sr.agents.asks import Asks
from f3sr.agents.role_answers import Estimate, ReasonerAnswer
from f3sr.agents.scene_evidence import SceneEvidence
from f3sr.errors import OutputError
from f3sr.exporters.exported_scene import ExportedScene
from f3sr.metrics.measures import measure
from f3sr.models.model_client import Call
from f3sr.play.trials import Trials
from f3sr.runtime.atomic_folder import claimed
from f3sr.scene import Scene, SceneObject
from f3sr.scene_package.package import WRITTEN, Package
from f3sr.scene_package.package_folder import EDITS, ROLLOUTS, placed
from f3sr.scene_package.scene_json import SceneDocument, to_document, to_json

CROPS = 24
"""Most crops of objects that the model is shown."""
OF_MATERIAL = (
    *("density", "mass", "inertia", "center_of_mass", "friction", "rolling_friction", "restitution"),
    *("structure", "material", "material_source", "material_reason"),
)
"""Fields of an object in scene.json that follow from its material."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimated:
    """A scene with a model's properties. ``kept``: ids that would not rest with theirs and have those of before."""

    scene: Scene
    kept: tuple[int, ...]
    disagreements: tuple[str, ...]
    """With the table of materials, in words."""


def estimated(scene: Scene, model: Asks, name: str) -> Estimated:
    """Ask for the properties of every object. Raises ModelError without an answer that suits."""

    def suits(answer: ReasonerAnswer) -> None:
        answer_checks.require(answer_checks.estimate_faults(answer.objects, scene))

    parts = [*SceneEvidence.of(scene, crops=CROPS).parts, "There is no goal: estimate what the objects are."]
    estimates = model.ask("reasoner", prompts.REASONER, parts, ReasonerAnswer, suits).objects
    wanted = [answer_checks.semantics_of(e, scene, at_speed=False) for e in estimates]
    steady = Trials(scene).steady(wanted)
    kept = tuple(s.id for s, asked in zip(steady, wanted, strict=True) if s != asked)
    made = [_made_of(scene[e.id], e, name) for e in estimates if e.id not in kept]
    told = tuple(answer_checks.disagreements(estimates, scene))
    return Estimated(scene=scene.with_objects(*made), kept=kept, disagreements=told)


def _made_of(o: SceneObject, e: Estimate, model: str) -> SceneObject:
    properties = e.model_dump(exclude={"id"})
    return replace(o, **properties, material_source="model", material_reason=f"estimated by {model}")


def write_materials(package: Package, found: Estimated, calls: Sequence[Call], *, overwrite: bool = False) -> None:
    """Write the properties into the package's folder, all files or none. Raises OutputError for a package with
    rollouts, which belong to the scene as it was, unless ``overwrite`` says so; and for an edited package."""

    def allowed(folder: object) -> None:
        if not overwrite and (package.folder / ROLLOUTS).is_dir():
            said = "holds rollouts, which belong to the scene as it is; changed only with --overwrite"
            raise OutputError(f"{package.folder}: {said}")
        if (package.folder / EDITS).exists():
            raise OutputError(
                f"{package.folder}: holds edits, the next of which would undo this; estimate before editing"
            )

    with claimed(placed(package.folder), allowed) as claim:
        for name, data in _files(package, found.scene, calls):
            claim.write(name, data)
        claim.add()


def _files(package: Package, scene: Scene, calls: Sequence[Call]) -> Iterator[tuple[str, bytes]]:
    """Those that name materials; meshes and collision parts, in folders, stay."""
    exported = ExportedScene.of(scene)
    for exporter in WRITTEN:
        yield from ((name, data) for name, data in exporter.files(exported) if "/" not in name)
    yield "scene.json", to_json(_document(package, scene, calls))


def _document(package: Package, scene: Scene, calls: Sequence[Call]) -> SceneDocument:
    """scene.json with other materials, and what is measured with them; all else as it was."""
    made = {o.id: o for o in to_document(scene, direct=None, uncertainty={}, metrics={}, provenance={}).objects}
    before = package.document
    objects = tuple(
        o.model_copy(update={field: getattr(made[o.id], field) for field in OF_MATERIAL}) for o in before.objects
    )
    now = measure(scene).as_dict()
    metrics = {name: now.get(name, value) for name, value in before.metrics.items()}
    provenance = {**before.provenance, "materials": [asdict(call) for call in calls]}
    return before.model_copy(update={"objects": objects, "metrics": metrics, "provenance": provenance})
