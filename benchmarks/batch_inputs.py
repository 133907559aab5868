"""Inputs of batches: real scenes of three objects of the bundled example, and stubs, each varied by a seed."""

from __future__ import annotations

import json
import random
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from f3sr import example

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from stub_batches import write_stub

OBJECTS, OF = 3, 10
BROKEN_SHARE = 0.15
BROKEN: tuple[dict[str, Any], ...] = (
    {"fail": "bad"},
    {"fail": "error"},
    {"fail": "crash"},
    {"fail": "crash", "once": True},
    {"fail": "bad"},
    {"fail": "memory"},
    {"fail": "error", "once": True},
)
"""Ways of being broken, one after another; one more stub hangs."""


def write_real(folder: Path, seed: int) -> Path:
    """Three objects of the example, each at another depth along its rays by up to 2 %."""
    source, rng = example.folder(), np.random.default_rng(seed)
    poses = json.loads((source / "assets" / "poses.json").read_text())
    entries = [poses["objects"][k] for k in sorted(rng.choice(OF, OBJECTS, replace=False))]
    for name in ("masks", "assets"):
        (folder / name).mkdir(parents=True)
    for entry in entries:
        shutil.copy(source / "masks" / entry["mask"], folder / "masks")
        shutil.copy(source / "assets" / entry["mesh"], folder / "assets")
        entry["translation"] = (np.array(entry["translation"]) * rng.uniform(0.98, 1.02)).tolist()
    document = {"convention": poses["convention"], "objects": entries}
    (folder / "assets" / "poses.json").write_text(json.dumps(document))
    for name in ("image.jpg", "geometry.npz", "ground.png"):
        shutil.copy(source / name, folder)
    return folder


def write_inputs(folder: Path, *, real: int, stubs: int, seed: int = 0) -> Path:
    """Real scenes and stubs in one folder, in a random order of names; a share of the stubs is broken."""
    rng = random.Random(seed)
    names = [f"{k:05d}" for k in range(real + stubs)]
    rng.shuffle(names)
    broken = round(BROKEN_SHARE * stubs)
    for k, name in enumerate(names):
        if k < real:
            write_real(folder / f"{name}-real", k)
        elif k - real < broken:
            asked = BROKEN[(k - real) % len(BROKEN)] if k > real else {"fail": "hang"}
            write_stub(folder / f"{name}-broken", k, **asked)
        else:
            write_stub(folder / f"{name}-stub", k, seconds=rng.uniform(0, 0.2), bytes=rng.randrange(1000, 200_000))
    return folder
