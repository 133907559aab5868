"""The job folder of f3sr, seen from the worker: read the request, write each answer, tell progress.

It needs numpy and Pillow only, and runs in the environment of the model (docs: workers). A generator is

    from job import Job
    job = Job.from_arguments(__doc__)
    model = ...                       # once for all objects
    for item in job.open_items():     # what is answered already is left out
        ...
        job.answer(item, write_glb, model="NAME", licence="LICENCE", up="+y")

and a geometry model

    job.answer_geometry(depth, meaning="metric", K=K, model="NAME", licence="LICENCE")
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

PROTOCOL = 1

# Scripts here have names of packages that they import: their own folder must not hide these.
sys.path[:] = [place for place in sys.path if Path(place or ".").resolve() != Path(__file__).resolve().parent]


class Job:
    """A job folder: ``request`` as read, files by the methods."""

    def __init__(self, folder, arguments):
        self.folder = Path(folder)
        self.arguments = arguments
        self.request = json.loads((self.folder / "request.json").read_text())
        if self.request.get("protocol") != PROTOCOL:
            raise SystemExit(f"protocol {self.request.get('protocol')!r}; this worker speaks {PROTOCOL}")
        self.seed = int(self.request["seed"])
        self.began = time.monotonic()

    @classmethod
    def from_arguments(cls, about, *, weights=None, **options):
        """The job of ``--job DIR``; ``--weights`` and further options are in ``arguments``."""
        parser = argparse.ArgumentParser(description=(about or "").splitlines()[0])
        parser.add_argument("--job", required=True, help="the job folder, given by f3sr")
        parser.add_argument("--weights", default=weights, help="a local folder, or a name on the hub")
        for name, default in options.items():
            parser.add_argument("--" + name.replace("_", "-"), default=default, type=type(default))
        arguments = parser.parse_args()
        return cls(arguments.job, arguments)

    def image(self):
        """The photo, (H, W, 3) uint8 sRGB."""
        return self._pixels(self.request["image"], "RGB")

    def mask(self, item):
        """(H, W) bool."""
        return self._pixels(item["mask"], "L") > 127

    def cutout(self, item):
        """The photo with the mask as alpha, a PIL image RGBA; models remove no background from it."""
        from PIL import Image

        return Image.open(self.folder / item["cutout"]).convert("RGBA")

    def pointmap(self):
        """(h, w, 3) float32 [m], PyTorch3D camera axes, NaN where unknown; None where f3sr knows no geometry."""
        import numpy as np

        name = self.request.get("pointmap")
        return np.load(self.folder / name, allow_pickle=False) if name else None

    def intrinsics(self):
        """K (3, 3) in pixels of the photo, or None."""
        return self.request.get("K")

    def camera(self):
        """K (3, 3) float32 in pixels of the photo: the one that somebody tells, else f3sr's estimate."""
        import numpy as np

        return np.array(self.request["K"], np.float32)

    def told_camera(self):
        """K (3, 3) float32 in pixels of the photo where somebody tells it, else None."""
        return self.camera() if self.request.get("K_told_by") else None

    def open_items(self):
        """The objects that have no answer yet, each with a line of progress."""
        for item in self.request["objects"]:
            if not (self.folder / f"{item['id']:02d}.json").exists():
                self.began = time.monotonic()
                self.say(item["id"], "started")
                yield item

    def answer(self, item, export, *, model, licence="", weights="", up=None, pose=None):
        """Write NN.glb by ``export(path)``, then NN.json in one step, so that a killed worker leaves no half answer."""
        name = f"{item['id']:02d}.glb"
        part = self.folder / f"part_{name}"
        export(str(part))
        part.replace(self.folder / name)
        self._write(f"{item['id']:02d}.json", {
            "id": item["id"], "mesh": name, "pose": pose or {"convention": "none"}, "up": up, "model": model,
            "weights": weights, "licence": licence, "seconds": time.monotonic() - self.began,
        })  # fmt: skip
        self.say(item["id"], "done")

    def answer_geometry(self, depth, *, meaning, model, K=None, valid=None, licence="", weights=""):
        """Write geometry.npz, then geometry.json.

        ``depth`` (h, w) covers the whole photo at any resolution. ``meaning`` is "metric" [m], "scaled" (depths times
        an unknown factor) or "relative" (inverse depths of unknown scale and shift). ``K`` (3, 3) in pixels of the
        map, whose corner is (0, 0); ``valid`` (h, w) bool."""
        import numpy as np

        arrays = {"depth": np.asarray(depth, np.float32)}
        if K is not None:
            arrays["K"] = np.asarray(K, np.float64)
        if valid is not None:
            arrays["valid"] = np.asarray(valid, bool)
        part = self.folder / "part_geometry.npz"
        np.savez_compressed(part, **arrays)
        part.replace(self.folder / "geometry.npz")
        self._write("geometry.json", {
            "arrays": "geometry.npz", "meaning": meaning, "model": model, "weights": weights, "licence": licence,
            "seconds": time.monotonic() - self.began,
        })  # fmt: skip
        self.say(None, "done")

    def say(self, id, state):
        """One line of progress on stdout; whatever else libraries print belongs on stderr."""
        print(json.dumps({"id": id, "state": state}), flush=True)

    def _pixels(self, name, mode):
        import numpy as np
        from PIL import Image

        return np.asarray(Image.open(self.folder / name).convert(mode))

    def _write(self, name, value):
        part = self.folder / f"part_{name}"
        part.write_text(json.dumps(value))
        part.replace(self.folder / name)
