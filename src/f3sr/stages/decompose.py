"""decompose: every mesh as a union of convex parts that covers it, for everything that touches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

from f3sr import proxies
from f3sr.proxies import Excess, Join, Proxy, ProxyConfig
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Scene, SceneObject

WIDE = 0.02
"""How far proxies must stand off at one place for a decision to name it [size]."""


@dataclass(frozen=True, kw_only=True)
class ProxyFit:
    """How well the proxies of one object fit its mesh."""

    parts: int
    inflation: float | None
    """Their volume over the mesh's; None where the mesh has none."""
    excess: Excess
    outside: float
    """How far the mesh sticks out of them [size]."""


@dataclass(frozen=True, kw_only=True)
class Decomposed(Outcome):
    stage: ClassVar[str] = "decompose"
    fits: Mapping[int, ProxyFit] = field(default_factory=dict[int, ProxyFit])
    """By object id."""
    joins: Mapping[int, tuple[Join, ...]] = field(default_factory=dict[int, tuple[Join, ...]])
    """How parts may be joined further, by object id."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        fits = self.fits.items()
        return (
            *(Measure(name="convex parts", after=f.parts, about=id) for id, f in fits),
            *(
                Measure(name="proxy volume / mesh volume", after=f.inflation, about=id)
                for id, f in fits
                if f.inflation is not None
            ),
            *(m for id, f in fits for m in _surface_measures(f, id)),
        )


def _surface_measures(fit: ProxyFit, id: int) -> list[Measure]:
    """How far surfaces stand apart."""
    excess = fit.excess
    values = {
        "proxies stand off the mesh, mean": excess.mean,
        "proxies stand off the mesh, 99th of a hundred": excess.most,
        "proxies stand off the mesh, largest": excess.largest,
        "proxies stand off the mesh, floor of a cavity": excess.floor,
        "mesh outside its proxies": fit.outside,
    }
    return [
        Measure(name=name, after=100 * value, unit="% of the size", about=id)
        for name, value in values.items()
        if value is not None
    ]


def decompose(
    scene: Scene, config: ProxyConfig | None = None, *, begun: Callable[[], Sequence[Proxy]] | None = None
) -> tuple[Scene, Decomposed]:
    """Give every object its collision proxies, from the cache where the same mesh was decomposed before.

    ``begun`` waits for those of the scene's meshes where they are made already."""
    results = begun() if begun else proxies.decompose_all([o.mesh for o in scene], config or ProxyConfig())
    pairs = list(zip(scene, results, strict=True))
    fits = {
        o.id: ProxyFit(parts=len(r.parts), inflation=r.inflation, excess=r.excess, outside=r.outside) for o, r in pairs
    }
    decisions = [replace(d, about=o.id) for o, r in pairs for d in r.decisions]
    scene = scene.with_objects(*(_with(o, r) for o, r in pairs))
    decisions += [_where(r.excess, o.id) for o, r in pairs if r.excess.largest > WIDE]
    joins = {o.id: r.joins for o, r in pairs}
    cut_short = any(r.cut_short for r in results)
    return scene, Decomposed(fits=fits, joins=joins, decisions=tuple(decisions), cut_short=cut_short)


def _with(o: SceneObject, proxy: Proxy) -> SceneObject:
    """The object with its parts. The mass of an open mesh is theirs, and stays so when they are cut back or joined."""
    given = o.solid is not None or o.mesh.is_solid
    return replace(o, parts=proxy.parts, solid=o.solid if given else proxy.solid)


def _where(excess: Excess, id: int) -> Decision:
    x, y, z = excess.at
    reason = f"{excess.largest:.1%} of the size near ({x:.4g}, {y:.4g}, {z:.4g}) in the asset's axes"
    return Decision(choice="proxies that stand off the mesh are kept", reason=reason, about=id)
