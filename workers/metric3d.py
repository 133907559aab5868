"""Metric3D as a worker of f3sr: depths in metres for the camera that f3sr hands in.

Run it in the environment of YvanYin/Metric3D; ``--code`` is a clone of it, or nothing for torch.hub's own download:

    export F3SR_WORKER_METRIC3D="conda run --no-capture-output -n metric3d python -u \
        /path/to/workers/metric3d.py --code /path/to/Metric3D"

``--weights`` is a name of torch.hub: metric3d_vit_small, metric3d_vit_large, metric3d_vit_giant2 or a ConvNeXt.
"""

from job import Job

VIT, CONVNEXT = (616, 1064), (544, 1216)
"""Height and width of the networks' input [px]."""
MEAN, STD = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)
CANONICAL_FOCAL = 1000.0
"""Focal length of the camera whose depths the network gives [px of its input]."""
FARTHEST = 300.0
"""Depths [m] from here on are none, as its authors cut them."""


def main():
    job = Job.from_arguments(__doc__, weights="metric3d_vit_large", code="", device="")
    import cv2
    import numpy as np
    import torch

    device = job.arguments.device or ("cuda" if torch.cuda.is_available() else "cpu")
    job.say(None, "loading")
    place = {"repo_or_dir": job.arguments.code, "source": "local"} if job.arguments.code else {
        "repo_or_dir": "yvanyin/metric3d"
    }  # fmt: skip
    model = torch.hub.load(model=job.arguments.weights, pretrain=True, **place).to(device).eval()
    job.say(None, "estimating")
    photo, K = job.image(), job.camera()
    height, width = VIT if "vit" in job.arguments.weights else CONVNEXT
    scale = min(height / photo.shape[0], width / photo.shape[1])
    w, h = int(photo.shape[1] * scale), int(photo.shape[0] * scale)
    top, left = (height - h) // 2, (width - w) // 2
    padded = cv2.copyMakeBorder(
        cv2.resize(photo, (w, h), interpolation=cv2.INTER_LINEAR),
        top, height - h - top, left, width - w - left, cv2.BORDER_CONSTANT, value=MEAN,
    )  # fmt: skip
    x = (padded.astype(np.float32) - np.float32(MEAN)) / np.float32(STD)
    with torch.no_grad():
        out, _, _ = model.inference({"input": torch.from_numpy(x).permute(2, 0, 1)[None].to(device)})
    canonical = out.squeeze().float().cpu().numpy()[top : top + h, left : left + w]
    depth = canonical * (K[0, 0] + K[1, 1]) / 2 * scale / CANONICAL_FOCAL
    job.answer_geometry(
        depth, meaning="metric", valid=(depth > 0) & (depth < FARTHEST), model=f"Metric3D {job.arguments.weights}",
        weights=job.arguments.code or "yvanyin/metric3d", licence="BSD-2-Clause",
    )  # fmt: skip


if __name__ == "__main__":
    main()
