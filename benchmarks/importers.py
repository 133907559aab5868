"""Every producer's output of one rendered scene, imported and reconstructed by the command line.

usage: python benchmarks/importers.py SCENE OUT [NAME ...]
SCENE is a folder of ../shared/data/scenes. Layouts are written on the spot from its true objects, with its own photo
and masks (``producer_outputs``). Prints a row per producer: objects, and the visible mIoU that the package has.
Exit codes: 0 all were reconstructed, 1 one was not.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import producer_outputs as outputs
from f3sr.core.camera import Camera
from f3sr.io.mesh_files import load_mesh
from f3sr.scene import SceneObject
from producer_outputs import Laid

WRITERS: dict[str, Callable[[Laid, Path], Path]] = {
    "sam3d": outputs.write_sam3d,
    "comfyui": outputs.write_comfyui,
    "fal": outputs.write_fal,
    "trellis": outputs.write_trellis,
    "embodiedgen": lambda laid, p: outputs.write_embodiedgen(laid, p, layout=False),
    "layout": lambda laid, p: outputs.write_embodiedgen(laid, p, layout=True),
    "glb": lambda laid, p: outputs.write_composed(laid, p / "scene.glb", camera=False),
}
NAMED = ("fal", "trellis", "embodiedgen", "glb")
"""Those whose masks and photo the user names."""


def laid_of(scene: Path) -> Laid:
    """The true scene with its own photo and masks."""
    truth = json.loads((scene / "truth.json").read_text())
    width, height = truth["image_size"]
    camera = Camera(
        width=width, height=height, K=np.array(truth["K"]), T_world_camera=np.array(truth["T_world_camera"])
    )
    photo = np.asarray(Image.open(scene / "image.png").convert("RGB"))
    files = sorted((scene / "masks").glob("*.png"))
    masks = {k: np.asarray(Image.open(file).convert("L")) > 127 for k, file in enumerate(files)}
    objects = [
        SceneObject(
            id=k,
            label=o["name"].replace("_", " "),
            mask_name=files[k].name,
            mask=masks[k],
            mesh=load_mesh(scene.parents[1] / "objects" / f"{o['model']}.glb"),
            T_world_object=np.array(o["T_world_object"]),
        )
        for k, o in enumerate(truth["objects"])
    ]
    return replace(Laid.of(objects, camera), photo=photo, masks=masks)


def run(*command: str) -> str:
    """The output of f3sr's command line."""
    done = subprocess.run([sys.executable, "-m", "f3sr", *command], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"f3sr {command[0]}: {done.stderr[-500:]}")
    return done.stdout


def main() -> int:
    """Run the benchmark of the command line."""
    scene, out = Path(sys.argv[1]), Path(sys.argv[2])
    laid = laid_of(scene)
    out.mkdir(parents=True, exist_ok=True)
    outputs.write_photo(laid, out / "photo.png")
    masks = outputs.write_masks(laid, out / "masks")
    for name in sys.argv[3:] or WRITERS:
        place = WRITERS[name](laid, out / name)
        more = ["--photo", str(out / "photo.png"), "--masks", str(masks)] if name in NAMED else []
        if name in ("fal",):
            more = ["--masks", str(masks)]
        began = time.monotonic()
        told = json.loads(run("import", str(place), "-o", str(out / f"{name}_in"), "--json", *more))
        imported = time.monotonic() - began
        package = str(out / f"{name}_out")
        run("reconstruct", str(out / f"{name}_in"), "-o", package, "--json")
        seconds = time.monotonic() - began - imported
        measured = json.loads((Path(package) / "scene.json").read_text())["metrics"]
        print(json.dumps({
            "producer": name, "objects": told["objects"], "masks": told["masks"], "poses": told["poses"],
            "import_s": round(imported, 1), "reconstruct_s": round(seconds, 1),
            "mIoU_visible": round(measured["mIoU_visible"], 4),
        }), flush=True)  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
