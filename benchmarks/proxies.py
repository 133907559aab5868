"""Collision proxies of every asset at hand: how many, how tight, how dear; ours, CoACD and V-HACD side by side.

python benchmarks/proxies.py                      # one asset per model and all methods: minutes
python benchmarks/proxies.py --all --methods cuts # every asset of every scene
python benchmarks/proxies.py --assets dev_03_mixed/03 dev_00_stack/01
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import peers
import tables
from f3sr import proxies
from f3sr.io.mesh_files import load_mesh
from f3sr.metrics import measures
from f3sr.runtime.machine import ONE_THREAD
from f3sr.scene import SceneObject

METHODS = ("cuts", *peers.PEERS)
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
COLUMNS = ("parts", "facets", "cpu_s", "inflation", "outside", "out_pct", "far_pct", "mean", "p99", "largest", "floor")
"""``outside``: largest of a vertex; ``out_pct`` and ``far_pct`` as the referee measures them; then the excess where
something can touch: its mean, its 99th of a hundred parts, its largest, and
its 99th of a hundred parts over the floor of a cavity. All lengths in % of the size."""


def assets(data: Path) -> Iterator[tuple[str, str, Path]]:
    """Name, model and file of every asset: the scenes', the real tables', and generated ones."""
    for file in sorted([*data.glob("scenes/*/assets/*.glb"), *data.glob("real/*/assets/*.glb")]):
        folder = file.parent.parent
        truth = folder / "truth.json"
        listed = json.loads(truth.read_text())["objects"] if truth.exists() else []
        name = f"{folder.name}/{file.stem}"
        yield name, listed[int(file.stem)]["model"] if int(file.stem) < len(listed) else name, file
    for file in sorted(data.glob("generated/*/model.glb")):
        yield file.parent.name, file.parent.name, file


def measured(file: Path, method: str, cache: Path) -> dict[str, float]:
    """One asset by one method, decomposed anew: ``cuts`` are the product's."""
    mesh = load_mesh(file)
    before, start = _cpu(), time.monotonic()
    proxy = proxies.decompose(mesh, cache_dir=cache) if method == "cuts" else peers.decompose(mesh, method)
    cpu, wall = _cpu() - before, time.monotonic() - start
    mask = np.zeros((1, 1), bool)
    o = SceneObject(id=0, label="", mask_name="", mask=mask, mesh=mesh, T_world_object=np.eye(4), parts=proxy.parts)
    out, far = measures.proxy_distances(o)
    lengths = (proxy.outside, out, far, proxy.excess.mean, proxy.excess.most, proxy.excess.largest)
    return {
        "parts": len(proxy.parts),
        "facets": float(np.mean([_facets(p) for p in proxy.parts])),
        "cpu_s": cpu,
        "wall_s": wall,
        **({} if proxy.inflation is None else {"inflation": proxy.inflation}),
        **dict(zip(COLUMNS[4:-1], (100 * length for length in lengths), strict=True)),
        **({} if proxy.excess.floor is None else {"floor": 100 * proxy.excess.floor}),
        "failed": float(proxy.method == "hull-fallback"),
    }


def _facets(part: Any) -> int:
    """Polygons, not triangles."""
    from f3sr.contact.polytopes import Polytope

    return len(Polytope.of(part).normals)


def _cpu() -> float:
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(s.ru_utime + s.ru_stime for s in spent)


def means(rows: list[dict[str, float]]) -> dict[str, float]:
    keys = {k for row in rows for k in row}
    return {k: float(np.mean([row[k] for row in rows if k in row])) for k in sorted(keys)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS)
    parser.add_argument("--assets", nargs="+", help="names such as dev_03_mixed/03")
    parser.add_argument("--all", action="store_true", help="every asset, not one per model")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/proxies"))
    args = parser.parse_args()
    os.environ.update(ONE_THREAD)
    args.out.mkdir(parents=True, exist_ok=True)
    chosen: dict[str, tuple[str, str, Path]] = {}
    for name, model, file in assets(args.data):
        if name in args.assets if args.assets else True:
            chosen.setdefault(name if args.all or args.assets else model, (name, model, file))
    results: dict[str, dict[str, dict[str, float]]] = {method: {} for method in args.methods}
    for method in args.methods:
        for name, model, file in chosen.values():
            cache = args.out / f"cache-{time.time_ns()}"
            row = measured(file, method, cache)
            results[method][name] = row
            label = f"{method:6} {name:18} {model.removeprefix('ycb_')[:18]:18}"
            print(label, "  ".join(f"{k} {row[k]:.3g}" for k in (*COLUMNS, "wall_s") if k in row), flush=True)
        (args.out / "results.json").write_text(json.dumps(results, indent=1))
    columns = (*COLUMNS, "failed")
    lines = [[m, *(f"{means(list(r.values())).get(c, np.nan):.3g}" for c in columns)] for m, r in results.items()]
    print()
    tables.show([["mean of " + str(len(chosen)), *columns], *lines])


if __name__ == "__main__":
    main()
