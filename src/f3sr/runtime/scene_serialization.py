"""What stages change in a scene, as plain JSON and arrays: everything but the photo, the masks and the meshes.

Of a geometry only its zooms change: the factors are stored, not the points."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import ConvexPart, MassProperties
from f3sr.core.transforms import Array
from f3sr.scene import Geometry, Ground, Motion, Node, Relation, Scene, SceneGraph, SceneObject, Support

Arrays = dict[str, NDArray[Any]]
PLAIN = (
    *("mobility", "mobility_source", "density", "friction", "rolling_friction", "restitution", "damping", "structure"),
    *("material", "material_source", "material_reason", "supported_by", "scale"),
)
"""Fields of an object that JSON holds as they are."""


def pack(scene: Scene) -> tuple[dict[str, Any], Arrays]:
    """The changeable state of a scene; floats survive JSON exactly, as Python writes their shortest exact form."""
    arrays: Arrays = {"T_world_camera": scene.camera.T_world_camera, "K": scene.camera.K}
    for o in scene:
        arrays[f"T/{o.id}"] = o.T_world_object
        for k, part in enumerate(o.colliders):
            arrays[f"vertices/{o.id}/{k}"] = part.vertices
            arrays[f"faces/{o.id}/{k}"] = part.faces
    ground = scene.ground
    document = {
        "ground": {
            "normal": np.asarray(ground.normal, float).tolist(),
            "offset": float(ground.offset),
            "source": ground.source,
            "confidence": float(ground.confidence),
            "tilt_error": float(ground.tilt_error),
            "height_error": float(ground.height_error),
            "friction": float(ground.friction),
        },
        "zooms": list(scene.geometry.zooms) if scene.geometry else [],
        "graph": asdict(scene.graph),
        "objects": {str(o.id): _pack_object(o) for o in scene},
    }
    return document, arrays


def unpack(base: Scene, document: dict[str, Any], arrays: Arrays) -> Scene:
    """The state put back onto the scene it was derived from: same ids, photo, masks and meshes."""
    ground, graph = document["ground"], document["graph"]
    return replace(
        base,
        camera=replace(base.camera, K=arrays["K"], T_world_camera=arrays["T_world_camera"]),
        geometry=_zoomed(base.geometry, document["zooms"]),
        ground=Ground(**ground | {"normal": np.array(ground["normal"])}),
        graph=SceneGraph(
            source=graph["source"],
            relations=tuple(Relation(**r) for r in graph["relations"]),
            nodes=tuple(Node(**n) for n in graph["nodes"]),
        ),
        objects=tuple(_unpack_object(o, document["objects"][str(o.id)], arrays) for o in base),
    )


def _zoomed(geometry: Geometry | None, zooms: list[float]) -> Geometry | None:
    """The geometry after all of some zooms: those that it has not been through yet, one after another."""
    for factor in zooms[len(geometry.zooms) :] if geometry else ():
        geometry = geometry and geometry.zoomed(factor)
    return geometry


def _pack_object(o: SceneObject) -> dict[str, Any]:
    return {
        "plain": {name: getattr(o, name) for name in PLAIN},
        "parts": len(o.parts),
        "footing": len(o.footing),
        "solid": o.solid and [o.solid.volume, o.solid.center.tolist(), o.solid.inertia.tolist()],
        "supports": [asdict(s) for s in o.supports],
        "motion": [asdict(m) for m in o.motion],
    }


def _unpack_object(o: SceneObject, state: dict[str, Any], arrays: Arrays) -> SceneObject:
    def part(k: int) -> ConvexPart:
        return ConvexPart(vertices=arrays[f"vertices/{o.id}/{k}"], faces=arrays[f"faces/{o.id}/{k}"])

    T: Array = arrays[f"T/{o.id}"]
    return replace(
        o,
        T_world_object=T,
        parts=tuple(part(k) for k in range(state["parts"])),
        footing=tuple(part(state["parts"] + k) for k in range(state["footing"])),
        supports=tuple(Support(**s) for s in state["supports"]),
        solid=_solid(*state["solid"]) if state["solid"] else None,
        motion=tuple(Motion(**m | {"translation": tuple(m["translation"])}) for m in state["motion"]),
        **state["plain"],
    )


def _solid(volume: float, center: list[float], inertia: list[list[float]]) -> MassProperties:
    return MassProperties(volume=volume, center=np.array(center), inertia=np.array(inertia))
