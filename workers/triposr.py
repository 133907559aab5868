"""TripoSR as a worker of f3sr: a mesh with vertex colours for every mask, without a pose; it runs on a CPU.

Run it in the environment of VAST-AI-Research/TripoSR:

    export F3SR_WORKER_TRIPOSR="conda run --no-capture-output -n triposr python -u \
        /path/to/workers/triposr.py --code /path/to/TripoSR"
"""

import sys

from job import Job

SHARE = 0.85
"""Of the square frame that the object fills, as its authors train it."""


def main():
    job = Job.from_arguments(__doc__, weights="stabilityai/TripoSR", code=".", device="", resolution=256)
    sys.path.insert(0, job.arguments.code)
    import torch
    from tsr.system import TSR

    device = job.arguments.device or ("cuda:0" if torch.cuda.is_available() else "cpu")
    job.say(None, "loading")
    model = TSR.from_pretrained(job.arguments.weights, config_name="config.yaml", weight_name="model.ckpt")
    model.renderer.set_chunk_size(8192)
    model.to(device)
    for item in job.open_items():
        with torch.no_grad():
            codes = model([_framed(job.cutout(item))], device=device)
        mesh = model.extract_mesh(codes, True, resolution=job.arguments.resolution)[0]
        job.answer(item, mesh.export, model="TripoSR", licence="MIT", weights=job.arguments.weights, up="+z")


def _framed(rgba):
    """The object in the middle of a square, on grey."""
    from PIL import Image

    cut = rgba.crop(rgba.getchannel("A").getbbox())
    side = round(max(cut.size) / SHARE)
    square = Image.new("RGB", (side, side), (127, 127, 127))
    square.paste(cut, ((side - cut.width) // 2, (side - cut.height) // 2), cut.getchannel("A"))
    return square


if __name__ == "__main__":
    main()
