"""Workers by name: what each generator gives, and the script in ``workers/`` that runs it (docs: workers)."""

from __future__ import annotations

from typing import ClassVar

from f3sr.backends.model_choice import ModelChoice
from f3sr.generators.mesh_worker import MeshWorker, WorkerModel
from f3sr.generators.posed_assets import PosedAssets


class WorkerAssets(PosedAssets):
    """Any program that keeps to the job folder; its meshes say themselves which axis points up."""

    takes_model: ClassVar[bool] = True
    model: ClassVar[WorkerModel] = WorkerModel(name="worker", script="YOUR_WORKER.py")

    def __init__(self, choice: ModelChoice | None = None) -> None:
        super().__init__(MeshWorker(self.model, choice))


class Sam3dAssets(WorkerAssets):
    """SAM 3D Objects: meshes with poses in one point map's camera."""

    model = WorkerModel(name="sam3d", up="+y", licence="SAM Licence", memory_gb=32, script="workers/sam3d_objects.py")


class Trellis2Assets(WorkerAssets):
    """TRELLIS.2: textured meshes without a pose."""

    model = WorkerModel(name="trellis2", up="+y", licence="MIT", memory_gb=24, script="workers/trellis2.py")


class Hunyuan3dAssets(WorkerAssets):
    """Hunyuan3D-2.1: textured meshes without a pose."""

    model = WorkerModel(
        name="hunyuan3d",
        up="+y",
        licence="Tencent Hunyuan 3D 2.1 Community License, not for the EU, the UK and South Korea",
        memory_gb=31,
        script="workers/hunyuan3d.py",
    )


class TripoSrAssets(WorkerAssets):
    """TripoSR: meshes with vertex colours without a pose, on a CPU too."""

    model = WorkerModel(name="triposr", up="+z", licence="MIT", script="workers/triposr.py")
