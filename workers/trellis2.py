"""TRELLIS.2 as a worker of f3sr: a textured mesh for every mask, without a pose.

Run it in the environment of microsoft/TRELLIS.2:

    export F3SR_WORKER_TRELLIS2="conda run --no-capture-output -n trellis2 python -u /path/to/workers/trellis2.py"
"""

import sys

from job import Job


def main():
    job = Job.from_arguments(
        __doc__, weights="microsoft/TRELLIS.2-4B", code=".", faces=100_000, texture_size=2048, pipeline_type="1024"
    )
    sys.path.insert(0, job.arguments.code)
    import o_voxel
    from trellis2.pipelines import Trellis2ImageTo3DPipeline

    job.say(None, "loading")
    pipeline = Trellis2ImageTo3DPipeline.from_pretrained(job.arguments.weights)
    pipeline.cuda()
    for item in job.open_items():
        mesh = pipeline.run(job.cutout(item), seed=job.seed, pipeline_type=job.arguments.pipeline_type)[0]
        mesh.simplify(16_777_216)
        glb = o_voxel.postprocess.to_glb(
            vertices=mesh.vertices, faces=mesh.faces, attr_volume=mesh.attrs, coords=mesh.coords,
            attr_layout=mesh.layout, voxel_size=mesh.voxel_size, aabb=[[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]],
            decimation_target=job.arguments.faces, texture_size=job.arguments.texture_size, remesh=True,
        )  # fmt: skip
        job.answer(item, glb.export, model="TRELLIS.2", licence="MIT", weights=job.arguments.weights, up="+y")


if __name__ == "__main__":
    main()
