"""Published Fysiverse-3D scenes released in MuJoCo, as published and as f3sr delivers them.

usage: python benchmarks/fysiverse.py SESSIONS [--out FOLDER] [--again]
SESSIONS holds their ``sessions/`` folders. Each is imported and reconstructed. Both versions are released from rest:
elliptic cone, friction .6, density 300 kg/m3, steps of 2 ms, 5 s. A scene is at rest if no object moves by over 1 cm.
Published parts are in the poses that their simulator, SAPIEN, left them in: another engine and another friction.
Exit codes: 0 all of ours are at rest without penetration, 1 one is not.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import mujoco
import numpy as np

from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array, transform
from f3sr.importing import fysiverse
from f3sr.importing.composition import drawn
from f3sr.importing.import_source import ImportSource
from f3sr.importing.imported_folder import write_imported
from f3sr.io.mesh_files import load_part
from f3sr.scene_package.package import read_package
from process import reconstruct

SECONDS, TIMESTEP = 5.0, 0.002
DENSITY, FRICTION = 300.0, 0.6
FAR = 0.01
"""Travel from which on an object has moved [m]."""
VERTICES = 64
"""Most vertices of a hull that engines on GPUs take."""


@dataclass(frozen=True, kw_only=True)
class Released:
    """A scene after its release."""

    objects: int
    moved: int
    tipped: int
    """Turned by over 30 degrees."""
    worst_cm: float
    penetration_mm: float
    """Deepest contact at the start."""
    parts: int
    large_parts: int
    """Of over 64 vertices."""

    @property
    def is_at_rest(self) -> bool:
        return not self.moved


def released(bodies: Sequence[Sequence[Array]]) -> Released:
    """Bodies of convex parts, vertices (n, 3) [m] in the world with the ground at z = 0."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.cone = TIMESTEP, mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.memory = 2 << 30
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], friction=[FRICTION, 0.005, 0.0001])
    for k, parts in enumerate(bodies):
        middle = np.concatenate(list(parts)).mean(0)
        body = spec.worldbody.add_body(name=f"b{k}", pos=middle)
        body.add_freejoint()
        for j, vertices in enumerate(parts):
            spec.add_mesh(name=f"m{k}_{j}", uservert=(vertices - middle).ravel().tolist())
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"m{k}_{j}", density=DENSITY,
                friction=[FRICTION, 0.005, 0.0001],
            )  # fmt: skip
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start, turns = data.xipos.copy(), data.xmat.copy().reshape(-1, 3, 3)
    depth = max((-c.dist for c in data.contact), default=0.0)
    for _ in range(round(SECONDS / TIMESTEP)):
        mujoco.mj_step(model, data)
    travel = np.linalg.norm(data.xipos - start, axis=1)[1:]
    turned = np.einsum("nij,nij->n", data.xmat.reshape(-1, 3, 3), turns)[1:]
    tipped = np.degrees(np.arccos(np.clip((turned - 1) / 2, -1, 1))) > 30
    sizes = [len(ConvexPart.hull_of(v).vertices) for parts in bodies for v in parts]
    return Released(
        objects=len(bodies),
        moved=int((travel > FAR).sum()),
        tipped=int(tipped.sum()),
        worst_cm=round(100 * float(travel.max()), 2),
        penetration_mm=round(1000 * max(depth, 0.0), 3),
        parts=len(sizes),
        large_parts=sum(n > VERTICES for n in sizes),
    )


def published(session: Path, root: Path) -> list[list[Array]]:
    """The parts of a session in its final poses."""
    manifest = json.loads((session / fysiverse.MANIFEST).read_text())
    bodies = list[list[Array]]()
    for o in manifest["objects"]:
        T = np.array(o["sapien_final_pose"]["final_pose"], float)
        files = [root / p for p in o["sapien_export"]["collision_paths"]]
        # Two sessions have the files and do not list them.
        files = files or sorted(session.rglob(f"*_mask_{o['mask_id']:03d}_object_coacd/*.obj"))
        bodies.append([transform(T, load_part(f).vertices) for f in files])
    return bodies


def ours(package: Path) -> list[list[Array]]:
    """The parts of a package where they rest."""
    return [
        [transform(o.T_world_object, o.scale * part.vertices) for part in (*o.parts, *o.footing)]
        for o in read_package(package).scene
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sessions", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/fysiverse"))
    parser.add_argument("--again", action="store_true", help="measure the packages that are there")
    args = parser.parse_args()
    rows = dict[str, dict[str, Released]]()
    for session in sorted(p for p in args.sessions.iterdir() if fysiverse.matches(ImportSource(path=p))):
        bodies = published(session, args.sessions.parent)
        if not all(bodies):
            continue  # no parts are published
        package = args.out / "packages" / session.name
        if not args.again:
            composition = fysiverse.read(ImportSource(path=session))
            folder = write_imported(args.out / "inputs" / session.name, composition, drawn(composition))
            reconstruct(folder, package, environment={"F3SR_CACHE_DIR": str(args.out.resolve() / "cache")})
        if not package.is_dir():
            print(f"{session.name}: no package", flush=True)
            continue
        rows[session.name] = {"published": released(bodies), "f3sr": released(ours(package))}
        for name, found in rows[session.name].items():
            print(f"{session.name} {name:9s} {json.dumps(asdict(found))}", flush=True)
    for name in ("published", "f3sr"):
        found = [row[name] for row in rows.values()]
        print(
            f"{name}: scenes not at rest {sum(not f.is_at_rest for f in found)} of {len(found)}, objects moved "
            f"{sum(f.moved for f in found)} of {sum(f.objects for f in found)}, tipped {sum(f.tipped for f in found)}, "
            f"penetration median {np.median([f.penetration_mm for f in found]):.2f} mm, worst "
            f"{max(f.penetration_mm for f in found):.2f} mm, parts over {VERTICES} vertices "
            f"{100 * sum(f.large_parts for f in found) / max(1, sum(f.parts for f in found)):.0f} % of "
            f"{sum(f.parts for f in found)}"
        )
    return int(any(not row["f3sr"].is_at_rest for row in rows.values()))


if __name__ == "__main__":
    sys.exit(main())
