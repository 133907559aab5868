"""Depth Anything 3 as a worker of f3sr: depths of one photo, and the camera where the model tells it.

Run it in the environment of ByteDance-Seed/Depth-Anything-3:

    export F3SR_WORKER_DEPTH_ANYTHING_3="conda run --no-capture-output -n da3 python -u \
        /path/to/workers/depth_anything3.py"

``--weights`` decides what comes: a nested model gives metres and a camera, DA3METRIC metres for the camera that f3sr
hands in, an any-view model depths up to a factor and a camera. DA3MONO is refused: its depths have a shift too.
"""

from job import Job

CANONICAL_FOCAL = 300.0
"""Focal length of the camera for which DA3METRIC gives metres [px of its input]."""
OPEN = ("SMALL", "BASE", "METRIC", "MONO")
"""In names of weights under Apache-2.0."""


def main():
    job = Job.from_arguments(__doc__, weights="depth-anything/DA3METRIC-LARGE", device="cuda", side=504)
    from depth_anything_3.api import DepthAnything3

    job.say(None, "loading")
    model = DepthAnything3.from_pretrained(job.arguments.weights).to(job.arguments.device).eval()
    name = model.model_name
    if "mono" in name:
        raise SystemExit(f"{name} gives depths with an unknown shift; accepted: DA3METRIC, a nested or any-view model")
    job.say(None, "estimating")
    photo = job.image()
    out = model.inference([photo], process_res=job.arguments.side)
    depth = out.depth[0]
    K, told = _of_map(job.camera(), photo, depth), job.told_camera()
    meaning = "metric" if "metric" in name or out.is_metric else "scaled"
    if "metric" in name:
        depth = depth * (K[0, 0] + K[1, 1]) / 2 / CANONICAL_FOCAL
    elif told is None:
        K = out.intrinsics[0]
    elif meaning == "metric":  # its metres are those of its own camera
        own = out.intrinsics[0]
        depth = depth * (K[0, 0] + K[1, 1]) / (own[0, 0] + own[1, 1])
    licence = "Apache-2.0" if any(word in job.arguments.weights.upper() for word in OPEN) else "CC BY-NC 4.0"
    job.answer_geometry(
        depth, meaning=meaning, K=K, valid=None if out.sky is None else ~out.sky[0], model=f"Depth Anything 3 {name}",
        weights=job.arguments.weights, licence=licence,
    )  # fmt: skip


def _of_map(K, photo, depth):
    """K of the photo in pixels of its map."""
    return K * [[depth.shape[1] / photo.shape[1]], [depth.shape[0] / photo.shape[0]], [1]]


if __name__ == "__main__":
    main()
