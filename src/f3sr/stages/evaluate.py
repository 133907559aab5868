"""evaluate: a scene beside direct composition, the input as it came, by the same measures."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Self

from f3sr.frames import pose
from f3sr.measures import Measures, measure
from f3sr.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The measures of a result and of direct composition, None where the input is not known."""

    result: Measures
    direct: Measures | None

    def stored(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """As plain values, for a store."""
        return {"result": asdict(self.result), "direct": asdict(self.direct) if self.direct else None}, {}

    @classmethod
    def restored(cls, document: dict[str, Any], _: dict[str, Any]) -> Self:
        direct = document["direct"]
        return cls(result=Measures(**document["result"]), direct=Measures(**direct) if direct else None)


def evaluate(scene: Scene, direct: Scene | None, *, true_scale: float = 1.0) -> Evaluation:
    """Measure ``scene`` and ``direct``, the levelled but otherwise untouched input, with the same proxies."""
    return Evaluation(
        result=measure(scene, true_scale=true_scale),
        direct=direct and measure(direct_composition(direct, scene), true_scale=true_scale),
    )


def direct_composition(levelled: Scene, result: Scene) -> Scene:
    """The input as it came, only levelled, its lowest vertex on the ground, with the proxies of ``result``.

    Proxies live in the asset's frame, so they fit the untouched assets as they are.
    """
    lowest = min(float(o.bounds_world[0, 2]) for o in levelled)
    T = pose(t=[0, 0, -lowest])
    objects = tuple(replace(o, T_world_object=T @ o.T_world_object, parts=result[o.id].parts) for o in levelled)
    camera = levelled.camera.moved(T @ levelled.camera.T_world_camera)
    return replace(levelled, objects=objects, camera=camera)
