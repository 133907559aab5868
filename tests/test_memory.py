"""How much memory a run of middling size may take: nothing is held per object, stage and pixel that need not be."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import manifold3d as mf
import numpy as np
import pytest

from f3sr.core.mesh import Material, Mesh
from f3sr.core.transforms import rotation_about
from f3sr.scene import SceneObject
from folders import camera, write_folder
from scenes import box

FACES, TEXTURE = 20_000, 512
EYE = camera().resized(1200, 900)
PEAK_MB = 448
"""Of the whole process with kernels loaded, not compiled, which takes 180 more: measured 431 to 441 in eight runs, of
which imports take 265. One more picture of floats at the photo's size (26 MB) breaks it."""
RETURNED = {"MALLOC_ARENA_MAX": "1", "MALLOC_MMAP_THRESHOLD_": "4000000", "MALLOC_TRIM_THRESHOLD_": "131072"}
"""For glibc: what is freed goes back at once. Else the peak hangs on which thread frees when, by 120 MB."""

SCRIPT = """
import sys
from f3sr.cli.main import main
code = main(sys.argv[1:])
status = open("/proc/self/status").read()
print("peak", status.split("VmHWM:")[1].split()[0])
sys.exit(code)
"""


def dense_box(id: int, x: float) -> SceneObject:
    """A box of 20,000 triangles with a noisy texture, standing on the table at ``x`` [m]."""
    size = np.array([0.09, 0.07, 0.08 + 0.01 * id])
    solid = mf.Manifold.cube(size.tolist(), True).refine(int(np.sqrt(FACES / 12)) + 1).to_mesh()
    vertices = np.asarray(solid.vert_properties[:, :3], float)
    texture = np.random.default_rng(id).integers(0, 256, (TEXTURE, TEXTURE, 3), np.uint8)
    mesh = Mesh(
        vertices=vertices,
        faces=np.asarray(solid.tri_verts, np.int32),
        uv=vertices[:, :2] / size[:2] + 0.5,
        materials=(Material(texture=texture),),
    )
    shown = box(id, size=size.tolist(), at=(x, 0.0, size[2] / 2), R=rotation_about([0, 0, 1], 0.2 * id))
    assert len(mesh.faces) >= FACES
    return SceneObject(**{**{k: getattr(shown, k) for k in shown.__dataclass_fields__}, "mesh": mesh})


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from Linux's /proc")
def test_peak_memory_of_a_run_of_middling_size(compiled: Path, tmp_path: Path) -> None:
    objects = [dense_box(id, x) for id, x in enumerate((-0.07, 0.07))]
    write_folder(tmp_path / "input", perturb=0.02, objects=objects, eye=EYE)
    env = {
        **os.environ,
        **RETURNED,
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "F3SR_CACHE_DIR": str(tmp_path / "cache"),
    }
    shutil.copytree(compiled, tmp_path / "cache" / compiled.name)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, "reconstruct", str(tmp_path / "input"), "-o", str(tmp_path / "out")],
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = {file.name for file in (tmp_path / "cache" / compiled.name).glob("*.kernel")}
    late = found - {file.name for file in compiled.glob("*.kernel")}
    assert not late, f"compiled during the run, which takes 180 MB: {late}"
    peak_mb = int(done.stdout.rsplit("peak ", 1)[1]) * 1024 / 1e6
    assert peak_mb < PEAK_MB
