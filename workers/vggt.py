"""VGGT as a worker of f3sr: depths up to one factor, and the camera, of one photo.

Run it in the environment of facebookresearch/vggt:

    export F3SR_WORKER_VGGT="conda run --no-capture-output -n vggt python -u \
        /path/to/workers/vggt.py --code /path/to/vggt"

f3sr gives the depths a scale, by the height of the camera above the ground.
"""

import sys

from job import Job

LONGEST, PATCH = 518, 14
"""Longer side of the input, and what both sides are multiples of [px]."""


def main():
    job = Job.from_arguments(__doc__, weights="facebook/VGGT-1B", code="", device="")
    if job.arguments.code:
        sys.path.insert(0, job.arguments.code)
    import numpy as np
    import torch
    from PIL import Image
    from vggt.models.vggt import VGGT
    from vggt.utils.pose_enc import pose_encoding_to_extri_intri

    device = job.arguments.device or ("cuda" if torch.cuda.is_available() else "cpu")
    is_recent = device.startswith("cuda") and torch.cuda.get_device_capability()[0] >= 8
    job.say(None, "loading")
    model = VGGT.from_pretrained(job.arguments.weights).to(device).eval()
    job.say(None, "estimating")
    # As their loader for landscape photos; a portrait one is not cropped, which their loader does by default.
    photo = Image.fromarray(job.image())
    sides = [max(PATCH, round(n * LONGEST / max(photo.size) / PATCH) * PATCH) for n in photo.size]
    pixels = np.asarray(photo.resize(sides, Image.Resampling.BICUBIC), np.float32) / 255
    images = torch.from_numpy(pixels).permute(2, 0, 1)[None, None].to(device)
    with torch.no_grad():
        with torch.autocast(
            device.partition(":")[0],
            dtype=torch.bfloat16 if is_recent else torch.float16,
            enabled=device.startswith("cuda"),
        ):
            tokens, start = model.aggregator(images)
        _, K = pose_encoding_to_extri_intri(model.camera_head(tokens)[-1], images.shape[-2:])
        depth, _ = model.depth_head(tokens, images, start)
    job.answer_geometry(
        depth.squeeze().float().cpu().numpy(), meaning="scaled", K=K.squeeze().float().cpu().numpy(), model="VGGT",
        weights=job.arguments.weights, licence="VGGT License",
    )  # fmt: skip


if __name__ == "__main__":
    main()
