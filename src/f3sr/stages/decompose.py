"""decompose: every mesh as a union of convex parts that covers it, for everything that touches."""

from __future__ import annotations

from dataclasses import replace

from f3sr import proxies
from f3sr.proxies import Excess, ProxyConfig
from f3sr.report import Decision, Measure, Report
from f3sr.scene import Scene

WIDE = 0.02
"""How far proxies must stand off at one place for a decision to name it [size]."""


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
    for o, r in pairs:
        excess = r.excess
        values = {"mean": excess.mean, "99th of a hundred": excess.most, "largest": excess.largest}
        values |= {} if excess.floor is None else {"floor of a cavity": excess.floor}
        measures += [
            Measure(name=f"proxies stand off the mesh, {which}", after=100 * value, unit="% of the size", about=o.id)
            for which, value in values.items()
        ]
        measures.append(
            Measure(name="mesh outside its proxies", after=100 * r.outside, unit="% of the size", about=o.id)
        )
    decisions = [replace(d, about=o.id) for o, r in pairs for d in r.decisions]
    scene = scene.with_objects(*(replace(o, parts=r.parts) for o, r in pairs))
    decisions += [_where(r.excess, o.id) for o, r in pairs if r.excess.largest > WIDE]
    cut_short = any(r.cut_short for r in results)
    return scene, Report(stage="decompose", measures=tuple(measures), decisions=tuple(decisions), cut_short=cut_short)


def _where(excess: Excess, id: int) -> Decision:
    x, y, z = excess.at
    reason = f"{excess.largest:.1%} of the size near ({x:.4g}, {y:.4g}, {z:.4g}) in the asset's axes"
    return Decision(choice="proxies that stand off the mesh are kept", reason=reason, about=id)
