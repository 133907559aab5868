"""How well supports are told: on the benchmark's scenes and on made ones, as they are and with the noise of generated
poses, after ``relate`` and, with --whole, after physics.

usage: python benchmarks/supports.py [--data PATH] [--seeds N] [--whole] [--times]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from f3sr.core.transforms import pose
from f3sr.io import inputs
from f3sr.pipeline import reconstruct
from f3sr.runtime.result_store import Store
from f3sr.scene import Scene
from f3sr.stages.relate import describe, relate

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import made_scenes

REPO = Path(__file__).resolve().parents[1]
AFTER_ALIGN = ("relate", "decompose", "separate", "settle", "close", "refine", "describe", "evaluate")
SEEDS_PER_FAMILY = 8
Pairs = frozenset[tuple[int, int]]
Step = Callable[[Scene], Scene]


@dataclass
class Score:
    """Pairs (object, its support) that were found and are true; main supports that are among the true ones."""

    hits: int = 0
    found: int = 0
    true: int = 0
    mains: int = 0
    objects: int = 0
    unseen: int = 0
    cpu: float = 0.0
    scenes: int = 0

    def add(self, scene: Scene, true: Pairs, cpu: float) -> None:
        found = {(o.id, s.id) for o in scene for s in o.supports}
        self.hits, self.found, self.true = self.hits + len(found & true), self.found + len(found), self.true + len(true)
        self.mains += len({(o.id, o.supported_by) for o in scene} & true)
        self.objects += len(scene.objects)
        self.unseen += sum(o.supported_by is None for o in scene)
        self.cpu, self.scenes = self.cpu + cpu, self.scenes + 1

    def row(self, name: str) -> str:
        precision, recall, main = self.hits / self.found, self.hits / self.true, self.mains / self.objects
        return (
            f"| {name} | {precision:.3f} | {recall:.3f} | {main:.3f} | {self.unseen} | {self.cpu / self.scenes:.2f} |"
        )


def main() -> int:
    args = _arguments()
    if args.times:
        return growth()
    print("| scenes | precision | recall | main support | on something unseen | cpu_s |\n|---|---|---|---|---|---|")
    made = list(_made())
    judge("made, exact", made)
    judge("made, poses off", made, args.seeds, made_scenes.jittered)
    real = _rendered(args.data)
    if not real:
        print(f"no rendered scenes in {args.data}", file=sys.stderr)
        return 0
    for stage in ("level", "align"):
        scenes = [(scenes[stage], true) for scenes, true in real]
        judge(f"rendered, after {stage}", scenes)
        judge(f"rendered, after {stage}, poses off", scenes, args.seeds, made_scenes.jittered)
        bare = [(replace(scene, geometry=None), true) for scene, true in scenes]
        judge(f"rendered, after {stage}, poses off, no geometry", bare, args.seeds, made_scenes.jittered)
    if args.whole:
        judge_whole(args.data)
    return 0


def judge(
    name: str,
    scenes: Iterable[tuple[Scene, Pairs]],
    seeds: int = 1,
    disturbed: Callable[[Scene, np.random.Generator], Scene] | None = None,
) -> None:
    """Print the row of ``relate`` over some scenes, each disturbed with several seeds."""
    score = Score()
    for scene, true in scenes:
        for seed in range(seeds):
            given = disturbed(scene, np.random.default_rng(seed)) if disturbed else scene
            start = time.process_time()
            result, _ = relate(given)
            score.add(result, true, time.process_time() - start)
    print(score.row(name), flush=True)


def judge_whole(data: Path) -> None:
    """Print the row of everything up to rest, supports from contact forces."""
    score = Score()
    for folder, true in _truths(data):
        scene = reconstruct(inputs.read(folder), skip=["evaluate"], store=Store.default()).scene
        start = time.process_time()
        described, _ = describe(scene)
        score.add(described, true, time.process_time() - start)
    print(score.row("rendered, at rest"), flush=True)


def growth() -> int:
    """Print the processor time of ``relate`` over how many objects of 20,000 triangles there are."""
    print("| objects | relations | cpu_s |\n|---|---|---|")
    for n in (5, 10, 20, 50, 100):
        scene = crowd(n)
        relate(scene)
        start = time.process_time()
        related, _ = relate(scene)
        cpu = time.process_time() - start
        print(f"| {n} | {len(related.graph.relations)} | {cpu:.2f} |", flush=True)
    return 0


def crowd(n: int) -> Scene:
    """Balls in rows on the floor, every third one on its neighbour."""
    rng = np.random.default_rng(n)
    shapes = []
    for k in range(n):
        x, y = 0.13 * (k % 10) - 0.6, 0.13 * (k // 10) - 0.3
        z = 0.03 if k % 3 < 2 else 0.09
        shapes.append((made_scenes.ball(0.03, subdivisions=5), pose(t=[x - (0.13 if z > 0.05 else 0), y, z])))
    return made_scenes.photographed(made_scenes.objects_of(shapes), made_scenes.camera(rng), rng)


def _made() -> Iterable[tuple[Scene, Pairs]]:
    for family in sorted(made_scenes.FAMILIES):
        scenes = (made_scenes.made(family, seed) for seed in range(5 * SEEDS_PER_FAMILY))
        kept = [m for m in scenes if m][:SEEDS_PER_FAMILY]
        yield from ((m.scene, m.supports) for m in kept)


def _rendered(data: Path) -> list[tuple[Mapping[str, Scene], Pairs]]:
    """Every rendered scene after each of its stages up to ``align``, with its true supports."""
    store = Store.default()
    return [
        (reconstruct(inputs.read(folder), skip=AFTER_ALIGN, store=store).scenes, true) for folder, true in _truths(data)
    ]


def _truths(data: Path) -> Iterable[tuple[Path, Pairs]]:
    for file in sorted(data.glob("scenes/*/truth.json")):
        pairs = json.loads(file.read_text()).get("supports", [])
        yield file.parent, frozenset((int(a), int(b)) for a, b in pairs)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data", help="holds scenes/*/truth.json")
    parser.add_argument("--seeds", type=int, default=6, help="disturbances of every scene")
    parser.add_argument("--whole", action="store_true", help="also after physics")
    parser.add_argument("--times", action="store_true", help="only how the time of relate grows")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
