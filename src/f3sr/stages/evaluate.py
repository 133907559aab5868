"""evaluate: a scene beside direct composition, the input as it came, by the same measures."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Self

from f3sr.frames import pose
from f3sr.measures import Details, Gap, Measures, ObjectMeasures, Overlap, measure_with_details
from f3sr.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The measures of a result and of direct composition, None where the input is not known."""

    result: Measures
    direct: Measures | None
    result_details: Details
    direct_details: Details | None

    def stored(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """As plain values, for a store."""
        return asdict(self), {}

    @classmethod
    def restored(cls, document: dict[str, Any], _: dict[str, Any]) -> Self:
        direct, details = document["direct"], document["direct_details"]
        return cls(
            result=Measures(**document["result"]),
            direct=Measures(**direct) if direct else None,
            result_details=_details(document["result_details"]),
            direct_details=_details(details) if details else None,
        )


def evaluate(scene: Scene, direct: Scene | None, *, true_scale: float = 1.0) -> Evaluation:
    """Measure ``scene`` and ``direct``, the levelled but otherwise untouched input, with the same proxies."""
    result, result_details = measure_with_details(scene, true_scale=true_scale)
    if direct is None:
        return Evaluation(result=result, direct=None, result_details=result_details, direct_details=None)
    beside, details = measure_with_details(direct_composition(direct, scene), true_scale=true_scale)
    return Evaluation(result=result, direct=beside, result_details=result_details, direct_details=details)


def _details(document: dict[str, Any]) -> Details:
    return Details(
        objects=tuple(ObjectMeasures(**o) for o in document["objects"]),
        gaps=tuple(Gap(**_with_points(g)) for g in document["gaps"]),
        overlaps=tuple(Overlap(**_with_points(o)) for o in document["overlaps"]),
    )


def _with_points(document: dict[str, Any]) -> dict[str, Any]:
    """JSON's lists are points."""
    return {name: tuple(value) if isinstance(value, list) else value for name, value in document.items()}


def direct_composition(levelled: Scene, result: Scene) -> Scene:
    """The input as it came, only levelled, its lowest vertex on the ground, with the proxies of ``result``.

    Proxies live in the asset's frame, so they fit the untouched assets as they are.
    """
    lowest = min(float(o.bounds_world[0, 2]) for o in levelled)
    T = pose(t=[0, 0, -lowest])
    objects = tuple(replace(o, T_world_object=T @ o.T_world_object, parts=result[o.id].parts) for o in levelled)
    camera = levelled.camera.moved(T @ levelled.camera.T_world_camera)
    return replace(levelled, objects=objects, camera=camera)
