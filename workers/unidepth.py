"""UniDepth as a worker of f3sr: depths in metres and the camera of one photo.

Run it in the environment of lpiccinelli-eth/UniDepth:

    export F3SR_WORKER_UNIDEPTH="conda run --no-capture-output -n unidepth python -u /path/to/workers/unidepth.py"

``--weights lpiccinelli/unidepth-v1-vitl14`` runs version 1. A camera that somebody tells is handed in.
"""

from job import Job


def main():
    job = Job.from_arguments(__doc__, weights="lpiccinelli/unidepth-v2-vitl14", device="")
    import torch
    from unidepth.models import UniDepthV1, UniDepthV2

    device = job.arguments.device or ("cuda" if torch.cuda.is_available() else "cpu")
    is_first = "v1" in job.arguments.weights.rstrip("/").rpartition("/")[2]
    job.say(None, "loading")
    model = (UniDepthV1 if is_first else UniDepthV2).from_pretrained(job.arguments.weights).to(device).eval()
    told = job.told_camera()
    job.say(None, "estimating")
    out = model.infer(torch.from_numpy(job.image().copy()).permute(2, 0, 1), _camera(told, is_first))
    # The map has the photo's pixels. A camera that was handed in is not given back.
    job.answer_geometry(
        out["depth"].squeeze().float().cpu().numpy(),
        meaning="metric",
        K=out["intrinsics"].squeeze().float().cpu().numpy() if told is None else told,
        model="UniDepth V1" if is_first else "UniDepth V2",
        weights=job.arguments.weights,
        licence="CC BY-NC 4.0",
    )


def _camera(told, is_first):
    """The camera as each version takes it; None where nobody tells it."""
    if told is None:
        return None
    import torch

    if is_first:
        return torch.from_numpy(told)
    from unidepth.utils.camera import Pinhole

    return Pinhole(K=torch.from_numpy(told)[None])


if __name__ == "__main__":
    main()
