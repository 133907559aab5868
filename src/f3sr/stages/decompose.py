"""decompose: every mesh as a union of convex parts that covers it, for everything that touches."""

from __future__ import annotations

from dataclasses import replace

from f3sr import proxies
from f3sr.proxies import ProxyConfig
from f3sr.report import Measure, Report
from f3sr.scene import Scene


def decompose(scene: Scene, config: ProxyConfig | None = None) -> tuple[Scene, Report]:
    """Give every object its collision proxies, from the cache where the same mesh was decomposed before."""
    results = proxies.decompose_all([o.mesh for o in scene], config or ProxyConfig())
    pairs = list(zip(scene, results, strict=True))
    measures = [Measure(name="convex parts", after=len(r.parts), about=o.id) for o, r in pairs]
    measures += [
        Measure(name="proxy volume / mesh volume", after=r.inflation, about=o.id)
        for o, r in pairs
        if r.inflation is not None
    ]
    decisions = [replace(d, about=o.id) for o, r in pairs for d in r.decisions]
    scene = scene.with_objects(*(replace(o, parts=r.parts) for o, r in pairs))
    cut_short = any(r.cut_short for r in results)
    return scene, Report(stage="decompose", measures=tuple(measures), decisions=tuple(decisions), cut_short=cut_short)
