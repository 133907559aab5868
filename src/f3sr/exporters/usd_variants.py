"""What single engines read beyond UsdPhysics, as variants of a prop: PhysX, Newton and MuJoCo.

Every variant set is off unless a user chooses ``Enabled``; then a payload adds that engine's schemas and nothing else
(SimReady Foundation, capability runtime variants). The schemas are those engines' own, authored by name: OpenUSD does
not ship them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from f3sr.exporters.exported_scene import ExportedObject, ExportedScene
from f3sr.exporters.usd_library import pxr
from f3sr.physics.mujoco_model import CONDIM, SOLIMP

RUNTIMES = ("PhysX", "Newton", "MuJoCo")
OFF, ON = "Disabled", "Enabled"
HULL_VERTICES = 64
"""Most vertices of a hull in PhysX on a GPU; the package's parts have no more."""
POSITION_ITERATIONS = 32
"""Of PhysX's solver: its 16 leave stacks creeping (docs: physics)."""

Values = Mapping[str, tuple[str, Any]]
"""Type in ``.usda`` and value of attributes by name."""


@dataclass(frozen=True, kw_only=True)
class EngineExtras:
    """Schemas and attributes of one engine for the body, each collider and the contact material of a prop."""

    body: Sequence[str] = ()
    of_body: Values = field(default_factory=dict[str, tuple[str, Any]])
    collider: Sequence[str] = ()
    of_collider: Values = field(default_factory=dict[str, tuple[str, Any]])
    material: Sequence[str] = ()
    of_material: Values = field(default_factory=dict[str, tuple[str, Any]])


def extras_of(o: ExportedObject, exported: ExportedScene) -> Mapping[str, EngineExtras]:
    """What each engine is told of an object."""
    _, spinning, rolling = o.body.friction
    return {
        # A contact takes the larger friction, as in the package.
        "PhysX": EngineExtras(
            body=["PhysxRigidBodyAPI"],
            of_body={"physxRigidBody:solverPositionIterationCount": ("int", POSITION_ITERATIONS)},
            collider=["PhysxCollisionAPI", "PhysxConvexHullCollisionAPI"],
            of_collider={
                "physxConvexHullCollision:hullVertexLimit": ("int", HULL_VERTICES),
            },
            material=["PhysxMaterialAPI"],
            of_material={"physxMaterial:frictionCombineMode": ("token", "max")},
        ),
        "Newton": EngineExtras(
            collider=["NewtonCollisionAPI", "NewtonMeshCollisionAPI"],
            material=["NewtonMaterialAPI"],
            of_material={
                "newton:torsionalFriction": ("float", spinning),
                "newton:rollingFriction": ("float", rolling),
            },
        ),
        "MuJoCo": EngineExtras(
            collider=["MjcCollisionAPI", "MjcMeshCollisionAPI"],
            of_collider={
                "mjc:condim": ("int", CONDIM),
                "mjc:solref": ("double[]", list(exported.physics.solref)),
                "mjc:solimp": ("double[]", list(SOLIMP)),
                "mjc:inertia": ("token", "shell"),
            },
            material=["MjcMaterialAPI"],
            of_material={
                "mjc:torsionalfriction": ("double", spinning),
                "mjc:rollingfriction": ("double", rolling),
            },
        ),
    }


def variant_files(o: ExportedObject, exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
    """The payloads of an object's prop, relative to the prop's layer."""
    for runtime, extras in extras_of(o, exported).items():
        yield _file(runtime), _payload(o, extras)


def add_variants(layer: Any, name: str) -> None:
    """The variant sets of the prop's root, all off, in its finished layer."""
    sdf = pxr().Sdf
    root = layer.GetPrimAtPath(f"/{name}")
    for runtime in RUNTIMES:
        sets = sdf.VariantSetSpec(root, runtime)
        sdf.VariantSpec(sets, OFF)
        on = sdf.VariantSpec(sets, ON)
        on.primSpec.payloadList.Prepend(sdf.Payload(f"./{_file(runtime)}"))
        root.variantSetNameList.Append(runtime)
        root.variantSelections[runtime] = OFF


def variants_told(name: str) -> dict[str, Any]:
    """How to switch a variant on, for the prop's metadata."""
    return {r: {"prim": f"/{name}", "variantSetName": r, "activateOption": ON} for r in RUNTIMES}


def _file(runtime: str) -> str:
    return f"runnables/physics/{runtime.lower()}.usda"


def _payload(o: ExportedObject, extras: EngineExtras) -> bytes:
    sdf = pxr().Sdf
    layer = sdf.Layer.CreateAnonymous(".usda")
    root = f"/{o.name}"
    _over(layer, root, extras.body, extras.of_body)
    layer.defaultPrim = o.name
    for k in range(len(o.body.parts)):
        _over(layer, f"{root}/colliders/hull_{k:03d}", extras.collider, extras.of_collider)
    _over(layer, f"{root}/materials/contact", extras.material, extras.of_material)
    text: str = layer.ExportToString()
    return text.encode()


def _over(layer: Any, path: str, schemas: Sequence[str], values: Values) -> None:
    """Schemas and attributes added to a prim that the prop defines."""
    sdf = pxr().Sdf
    prim = sdf.CreatePrimInLayer(layer, path)
    if schemas:
        prim.SetInfo("apiSchemas", sdf.TokenListOp.Create(prependedItems=list(schemas)))
    for name, (kind, value) in values.items():
        type_ = sdf.ValueTypeNames.Find(kind)
        uniform = sdf.VariabilityUniform if kind == "token" or name.startswith("mjc:") else sdf.VariabilityVarying
        sdf.AttributeSpec(prim, name, type_, uniform).default = value
