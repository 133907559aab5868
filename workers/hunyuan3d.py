"""Hunyuan3D-2.1 as a worker of f3sr: a textured mesh for every mask, without a pose.

Its licence excludes the EU, the UK and South Korea. Run it in the environment of Tencent-Hunyuan/Hunyuan3D-2.1:

    export F3SR_WORKER_HUNYUAN3D="conda run --no-capture-output -n hunyuan3d python -u \
        /path/to/workers/hunyuan3d.py --code /path/to/Hunyuan3D-2.1"
"""

import os
import sys
import tempfile
from pathlib import Path

from job import Job

LICENCE = "Tencent Hunyuan 3D 2.1 Community License, not for the EU, the UK and South Korea"


def main():
    job = Job.from_arguments(__doc__, weights="tencent/Hunyuan3D-2.1", code=".", texture=1)
    for part in ("hy3dshape", "hy3dpaint"):
        sys.path.insert(0, str(Path(job.arguments.code, part)))
    os.chdir(job.arguments.code)
    import torch
    import trimesh
    from hy3dshape.pipelines import Hunyuan3DDiTFlowMatchingPipeline

    job.say(None, "loading")
    shape = Hunyuan3DDiTFlowMatchingPipeline.from_pretrained(job.arguments.weights)
    paint = None
    if job.arguments.texture:
        from textureGenPipeline import Hunyuan3DPaintConfig, Hunyuan3DPaintPipeline

        paint = Hunyuan3DPaintPipeline(Hunyuan3DPaintConfig(6, 512))
    for item in job.open_items():
        picture = job.cutout(item)
        mesh = shape(image=picture, generator=torch.Generator().manual_seed(job.seed))[0]
        if paint is not None:
            with tempfile.TemporaryDirectory() as place:
                plain, seen, painted = (f"{place}/{name}" for name in ("plain.glb", "seen.png", "painted.obj"))
                mesh.export(plain)
                picture.save(seen)
                mesh = trimesh.load(paint(mesh_path=plain, image_path=seen, output_mesh_path=painted), force="mesh")
        job.answer(item, mesh.export, model="Hunyuan3D-2.1", licence=LICENCE, weights=job.arguments.weights, up="+y")


if __name__ == "__main__":
    main()
