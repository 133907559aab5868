"""Environments of packages: steps per second beside raw MuJoCo, resets, rest after resets, and scripted grasps.

usage: python benchmarks/environments.py PACKAGE [PACKAGE ...] [--samples FOLDER ...] [--resets N] [--only-resets]

``--samples`` gives, in the packages' order, what ``f3sr sample`` wrote of each: resets draw from it.
Exit codes: 0 all bounds hold, 1 one does not.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np

from f3sr.env.gripper import GripperConfig
from f3sr.env.resets import Randomization
from f3sr.env.scene_env import RATE, SAMPLE, SAMPLES, SceneEnv
from f3sr.env.scripted_grasp import grasp_of, pick
from f3sr.physics.mujoco_model import engine

STEPS = 200
"""Steps that are timed."""
SHARE = 0.7
"""Least of raw MuJoCo's steps per second."""
RESET_S = 0.05
"""Most that a reset may take [s]."""
REST_S, REST_M = 1.0, 1e-3
"""How long objects are watched after a reset [s], and how far they may move [m]."""
DEEPEST_M = 1e-4
"""Most that objects may overlap at a reset [m]."""
LIFT = 0.1
"""[m]"""


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("packages", nargs="+", type=Path)
    parser.add_argument("--resets", type=int, default=200, help="of every package")
    parser.add_argument("--samples", nargs="+", type=Path, help="a folder of samples for each package")
    parser.add_argument("--only-resets", action="store_true", help="no steps per second and no grasps")
    args = parser.parse_args()
    if args.samples and len(args.samples) != len(args.packages):
        parser.error(f"{len(args.samples)} folders of samples for {len(args.packages)} packages")
    if args.only_resets:
        return resets_alone(args.packages, args.samples or [None] * len(args.packages), args.resets)
    shares, resets, restless, held, fitting = list[float](), list[float](), 0, 0, 0
    for folder, samples in zip(args.packages, args.samples or [None] * len(args.packages), strict=True):
        share, rate = speed(folder)
        seconds, moved, same, _ = rest_after_resets(folder, args.resets, samples)
        lifted, fit = grasps(folder)
        shares.append(share)
        resets.append(median(seconds))
        held, fitting = held + lifted, fitting + fit
        restless_here = sum(m > REST_M for m in moved)
        restless += restless_here
        print(
            f"{folder.name}: {rate:.0f} steps/s, {share:.2f} of raw MuJoCo; reset {1000 * median(seconds):.1f} ms; "
            f"{restless_here} of {args.resets} resets move, most {1000 * max(moved):.2f} mm; "
            f"same bytes {same}; grasps {lifted} of {fit}",
            flush=True,
        )
    print(f"share of raw MuJoCo, least: {min(shares):.2f} (at least {SHARE}); resets that move: {restless} (at most 0)")
    print(f"reset: {1000 * max(resets):.1f} ms (at most {1000 * RESET_S:.0f}); grasps: {held} of {fitting}")
    return int(min(shares) < SHARE or max(resets) > RESET_S or restless > 0 or held < fitting)


def resets_alone(packages: list[Path], banks: list[Path | None], count: int) -> int:
    """Resets that draw from banks: at rest, free of penetration, the same bytes. 0 where all are."""
    failed = 0
    for folder, samples in zip(packages, banks, strict=True):
        seconds, moved, same, deepest = rest_after_resets(folder, count, samples)
        restless = sum(m > REST_M for m in moved)
        failed += restless + (deepest > DEEPEST_M) + (not same)
        print(
            f"{folder.name}: reset {1000 * median(seconds):.1f} ms; {restless} of {count} move, "
            f"median {1000 * median(moved):.3f}, most {1000 * max(moved):.2f} mm; "
            f"deepest contact {1000 * deepest:.3f} mm; same bytes {same}",
            flush=True,
        )
    return int(failed > 0)


def speed(folder: Path) -> tuple[float, float]:
    """Our steps per second over those of MuJoCo alone on the same motion of the gripper, and ours. In turns: the
    machine's speed changes."""
    env = SceneEnv(folder)
    env.action_space.seed(0)
    actions = [0.3 * env.action_space.sample() for _ in range(STEPS)]
    model, data = env.playable.model, env.playable.data
    ours, raw = list[float](), list[float]()
    for _ in range(3):
        env.reset(seed=0)
        start = perf_counter()
        targets = list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
        for action in actions:
            env.step(action)
            targets.append((data.mocap_pos.copy(), data.mocap_quat.copy(), data.ctrl.copy()))
        ours.append(perf_counter() - start)
        env.reset(seed=0)
        start = perf_counter()
        for place, turn, control in targets:
            data.mocap_pos[:], data.mocap_quat[:], data.ctrl[:] = place, turn, control
            engine().mj_step(model, data, SAMPLE * SAMPLES)
        raw.append(perf_counter() - start)
    return median(raw) / median(ours), STEPS / median(ours)


def rest_after_resets(folder: Path, count: int, samples: Path | None) -> tuple[list[float], list[float], bool, float]:
    """Seconds of every reset, how far anything moves in the second after it [m], whether seeds repeat, and the deepest
    overlap of objects at a reset [m], without the margin that contacts begin with."""
    env = SceneEnv(folder, samples=samples, randomization=Randomization(mass=0.3, friction=0.2))
    seconds, moved, digests, deepest = list[float](), list[float](), list[str](), 0.0
    for seed in [*range(count), 0]:
        start = perf_counter()
        first, _ = env.reset(seed=seed)
        seconds.append(perf_counter() - start)
        digests.append(hashlib.sha256(b"".join(a.tobytes() for a in first.values())).hexdigest())
        digests[-1] += str(env.playable.model.body_mass.tobytes())
        contacts = env.playable.data.contact
        deepest = max(deepest, -float(np.min(contacts.dist, initial=0.0)))
        engine().mj_step(env.playable.model, env.playable.data, round(REST_S / env.playable.model.opt.timestep))
        moved.append(float(np.linalg.norm(env.playable.states()[:, :3] - first["poses"][:, :3], axis=1).max()))
    return seconds[1:], moved, digests[0] == digests[-1], deepest


def grasps(folder: Path) -> tuple[int, int]:
    """How many objects a scripted grasp lifts and holds, of those that fit the gripper."""
    env, config, held, fitting = SceneEnv(folder, control="pose", seconds=60), GripperConfig(), 0, 0
    for o in env.package.scene:
        if o.mobility == "fixed" or grasp_of(env.package.scene, o.id, config) is None:
            continue
        fitting += 1
        first, _ = env.reset(seed=0)
        k, last = env.playable.ids.index(o.id), first
        for action in pick(env.scene, o.id, config, rate=RATE, lift=LIFT):
            last, *_ = env.step(action)
        rise = float(last["poses"][k, 2] - first["poses"][k, 2])
        held += rise > 0.8 * LIFT
        if rise <= 0.8 * LIFT:
            print(f"{folder.name}: {o.label} lost, {rise:.3f} m up", flush=True)
    return held, fitting


if __name__ == "__main__":
    sys.exit(main())
