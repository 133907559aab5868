"""A second engine's opinion: packages released from rest in SAPIEN (PhysX), how far every object travels.

usage: VENV/bin/python benchmarks/sapien_release.py PACKAGE ... [--seconds S] [--json FILE]
VENV is one with sapien==3.0.3 and nothing of f3sr: this script reads the package as any user would. Every package is
released in SAPIEN's metres, and in centimetres with its rest offset of nothing and of .17 mm, the contact margin that
our scenes rest with. PhysX has tolerances of its own for things of about one unit, and SAPIEN leaves them there:
between parts of a centimetre, a metre being the unit, it finds overlaps of ten millimetres that are not there.
Exit codes: 0 done (or SAPIEN is not installed, which is said), 1 fewer than five of six packages hold still.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

TIMESTEP = 0.002
"""[s], the product's."""
MARGIN = 1.7e-4
"""[m], the product's contact margin of each body."""
GRAVITY = 9.81
"""[m/s2]"""
BOUNCE = 2.0
"""Speed [m/s] below which nothing bounces, SAPIEN's."""
STILL = 0.5
"""Travel of a centre of mass below which an object has held still [cm]."""
SHARE = 5 / 6
"""Of the packages that must hold still: ten of twelve."""
ITERATIONS = (32, 4)
"""Of position and velocity: PhysX's ten and one leave stacks creeping."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """What a package is released with: units of length per metre, and at which distance things rest [m]."""

    units: float
    rest: float
    contact: float = 5e-4
    """At which distance contacts are made [m]."""


KINDS = {
    "metres": Kind(units=1.0, rest=MARGIN),
    "no margin": Kind(units=100.0, rest=0.0),
    "our margin": Kind(units=100.0, rest=MARGIN),
}


def main() -> int:
    args = _arguments()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import sapien  # noqa: F401
    except ImportError as error:
        print(f"skipped: {error} (pip install sapien==3.0.3, in a virtual environment of its own)")
        return 0
    rows: dict[str, dict[str, Any]] = {}
    for package in args.packages:
        found = {name: released(package, kind, args.seconds) for name, kind in KINDS.items()}
        rows[package.name] = found
        worst = {kind: max(row, key=lambda name: row[name]) for kind, row in found.items()}
        said = (f"{kind}: D_max {found[kind][name]:.3f} cm ({name})" for kind, name in worst.items())
        print(f"{package.name}: {', '.join(said)}", flush=True)
        if args.each:
            for name in next(iter(found.values())):
                print(f"  {name:32} " + "  ".join(f"{row[name]:8.4f}" for row in found.values()))
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n")
    still = {kind: sum(max(row[kind].values()) <= STILL for row in rows.values()) for kind in KINDS}
    for kind, count in still.items():
        print(f"{kind}: {count} of {len(rows)} hold still, within {STILL} cm in {args.seconds:g} s")
    return int(still["our margin"] < SHARE * len(rows))


def released(package: Path, kind: Kind, seconds: float) -> dict[str, float]:
    """The largest travel of every centre of mass [cm] by object, released from rest, none of them damped or asleep."""
    import sapien
    from sapien import physx

    document = json.loads((package / "scene.json").read_text())
    units = kind.units
    physx.set_shape_config(contact_offset=kind.contact * units, rest_offset=kind.rest * units)
    physx.set_body_config(ITERATIONS[0], ITERATIONS[1], 0.0)
    physx.set_scene_config(gravity=np.array([0, 0, -GRAVITY * units], np.float32), bounce_threshold=BOUNCE * units)
    scene = sapien.Scene([physx.PhysxCpuSystem()])
    scene.set_timestep(TIMESTEP)
    scene.add_ground(0, render=False, material=material(0.6))
    bodies = {f"{o['id']} {o['label']}": added(scene, package, o, units) for o in document["objects"]}
    start = {name: center(body) for name, body in bodies.items()}
    travel = dict.fromkeys(bodies, 0.0)
    for step in range(round(seconds / TIMESTEP)):
        scene.step()
        if step % 10 == 9:
            for name, body in bodies.items():
                travel[name] = max(travel[name], 100 / units * float(np.linalg.norm(center(body) - start[name])))
    return travel


def added(scene: Any, package: Path, record: dict[str, Any], units: float) -> Any:
    """An object of the package as a body with its convex parts, mass and inertia, in units per metre."""
    import sapien
    from sapien import physx

    fixed = record["mobility"] == "fixed"
    body = physx.PhysxRigidStaticComponent() if fixed else physx.PhysxRigidDynamicComponent()
    for file in record["collision"]:
        vertices = (corners(package / file) * units).astype(np.float32)
        body.attach(physx.PhysxCollisionShapeConvexMesh(vertices, np.ones(3, np.float32), material(record["friction"])))
    if not fixed:
        moments, axes = np.linalg.eigh(np.array(record["inertia"]))
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        body.mass = record["mass"]
        body.inertia = (moments * units**2).astype(np.float32)
        body.cmass_local_pose = sapien.Pose(matrix(axes, np.array(record["center_of_mass"]) * units))
        body.linear_damping = body.angular_damping = 0.0
    entity = sapien.Entity()
    entity.add_component(body)
    pose = np.array(record["T_world_object"])
    entity.set_pose(sapien.Pose(matrix(pose[:3, :3], pose[:3, 3] * units)))
    scene.add_entity(entity)
    return body


def material(friction: float) -> Any:
    """The same static and dynamic friction; of a pair PhysX takes the mean, MuJoCo the larger. No restitution."""
    from sapien import physx

    return physx.PhysxMaterial(friction, friction, 0.0)


def center(body: Any) -> Any:
    """The centre of mass in the world (3,), in units; of what is fixed its origin."""
    pose = body.entity_pose
    return (pose * body.cmass_local_pose).p if hasattr(body, "cmass_local_pose") else pose.p


def matrix(R: Any, t: Any) -> Any:
    T = np.eye(4, dtype=np.float32)
    T[:3, :3], T[:3, 3] = R, t
    return T


def corners(file: Path) -> Any:
    """The vertices (n, 3) of an OBJ file."""
    lines = (line.split() for line in file.read_text().splitlines() if line.startswith("v "))
    return np.array([[float(x) for x in line[1:4]] for line in lines])


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("packages", nargs="+", type=Path, metavar="PACKAGE")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--each", action="store_true", help="a line per object")
    parser.add_argument("--json", type=Path, metavar="FILE")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
