"""Generators of workers by name: what each gives, and the script in ``workers/`` that runs it (docs: workers)."""

from __future__ import annotations

from functools import partial

from f3sr.generators.posed_assets import PosedMaker
from f3sr.workers.mesh_worker import MeshModel, MeshWorker


def _assets(model: MeshModel) -> PosedMaker:
    return PosedMaker(partial(MeshWorker, model))


worker = _assets(MeshModel(name="worker", script="YOUR_WORKER.py"))
"""Any program that keeps to the job folder; its answers say which axis points up."""
sam3d = _assets(MeshModel(name="sam3d", up="+y", licence="SAM Licence", script="workers/sam3d_objects.py"))
"""Meshes with poses in one point map's camera."""
trellis2 = _assets(MeshModel(name="trellis2", up="+y", licence="MIT", script="workers/trellis2.py"))
hunyuan3d = _assets(
    MeshModel(
        name="hunyuan3d",
        up="+y",
        licence="Tencent Hunyuan 3D 2.1 Community License, not for the EU, the UK and South Korea",
        script="workers/hunyuan3d.py",
    )
)
triposr = _assets(MeshModel(name="triposr", up="+z", licence="MIT", script="workers/triposr.py"))
"""Meshes with vertex colours; it runs on a CPU too."""
