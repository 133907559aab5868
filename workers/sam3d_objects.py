"""SAM 3D Objects as a worker of f3sr: a mesh and a pose for every mask, all in one point map's camera.

Run it in the environment of facebookresearch/sam-3d-objects, from anywhere:

    export F3SR_WORKER_SAM3D="conda run --no-capture-output -n sam3d-objects python -u \
        /path/to/workers/sam3d_objects.py --code /path/to/sam-3d-objects --weights /path/to/pipeline.yaml"

``--texture 1`` bakes a texture onto a simplified mesh instead of vertex colours.
"""

import os
import sys
from pathlib import Path

from job import Job


def main():
    job = Job.from_arguments(__doc__, weights="checkpoints/hf/pipeline.yaml", code=".", texture=0)
    sys.path.insert(0, str(Path(job.arguments.code, "notebook")))
    os.environ.setdefault("CONDA_PREFIX", sys.prefix)  # their module reads it when it is imported
    import numpy as np
    import torch
    from inference import Inference

    os.chdir(job.arguments.code)
    job.say(None, "loading")
    inference = Inference(job.arguments.weights, compile=False)
    image, given = job.image(), job.pointmap()
    pointmap = None if given is None else torch.from_numpy(_at_photo_size(given, image.shape[:2]))
    for item in job.open_items():
        mask = job.mask(item)
        if job.arguments.texture:
            rgba = np.dstack([image, mask.astype(np.uint8) * 255])
            made = inference._pipeline.run(
                rgba, None, job.seed, stage1_only=False, with_mesh_postprocess=True, with_texture_baking=True,
                with_layout_postprocess=True, use_vertex_color=False, pointmap=pointmap,
            )  # fmt: skip
        else:
            made = inference(image, mask, seed=job.seed, pointmap=pointmap)
        if pointmap is None:
            # Poses of one scene must share a camera: what the first object's run estimated serves the others.
            pointmap = torch.as_tensor(_at_photo_size(_numbers(made["pointmap"]), image.shape[:2]))
        pose = {
            "convention": "sam3d",
            "rotation": _numbers(made["rotation"]).reshape(4).tolist(),
            "translation": _numbers(made["translation"]).reshape(3).tolist(),
            "scale": _numbers(made["scale"]).reshape(-1)[:3].tolist(),
        }
        job.answer(item, made["glb"].export, model="SAM 3D Objects", licence="SAM Licence",
                   weights=Path(job.arguments.weights).resolve().parent.name,
                   up="+y", pose=pose)  # fmt: skip


def _numbers(tensor):
    return tensor.detach().float().cpu().numpy() if hasattr(tensor, "detach") else tensor


def _at_photo_size(points, shape):
    """A point map (h, w, 3) at the photo's size, nearest."""
    import numpy as np

    rows = ((np.arange(shape[0]) + 0.5) * points.shape[0] / shape[0]).astype(int)
    columns = ((np.arange(shape[1]) + 0.5) * points.shape[1] / shape[1]).astype(int)
    return np.ascontiguousarray(points[rows][:, columns], dtype=np.float32)


if __name__ == "__main__":
    main()
