"""MoGe-2 (Wang et al. 2025): metric points, normals and intrinsics of one photo. MoGe is a package of its own."""

from __future__ import annotations

import importlib.util
import math
from typing import Any, ClassVar

import numpy as np

from f3sr.backends.protocols import EstimatedGeometry, PromptedImage
from f3sr.errors import F3srError, InputError, one_line
from f3sr.neural.model_loading import REMEDY, LocalModel, ModelFamily, torch_library
from f3sr.neural.model_source import Weights, find_file
from f3sr.runtime.extras import library

CHECKPOINT = "model.pt"
INSTALL = "pip install --no-deps dlr-moge dlr-utils3d opencv-python-headless"


class MogeGeometry(LocalModel):
    """The GeometryEstimator ``moge``."""

    family: ClassVar[ModelFamily] = ModelFamily(
        title="MoGe-2",
        default="Ruicheng/moge-2-vitl-normal",
        gigabytes=3.0,
        usual="float16",
        packages={"torch": REMEDY, "moge": INSTALL},
    )

    def weights(self) -> Weights:
        """A checkpoint file, read with ``weights_only``."""
        return find_file(
            self.name, file=CHECKPOINT, title=self.family.title, allow_downloads=self.choice.allow_downloads
        )

    def estimate(self, image: PromptedImage) -> EstimatedGeometry:
        """Points [m] and normals towards the camera at every pixel of the photo; none where the network masks it.
        A known focal length is handed in as the horizontal field of view."""
        torch, photo = torch_library(self.family.title), image.photo
        model = self.loaded(self._read)
        device, precision = self.place()
        known = {"fov_x": math.degrees(2 * math.atan(photo.width / 2 / image.focal.pixels))} if image.focal else {}
        pixels = torch.from_numpy(np.array(photo.rgb)).permute(2, 0, 1).float().to(device) / 255
        with torch.inference_mode():
            out = model.infer(pixels, use_fp16=precision == "float16", **known)
        points, told = _array(out["points"]), _array(out["intrinsics"]).astype(float)
        valid = _array(out["mask"]).astype(bool) & np.isfinite(points).all(-1) & (points[..., 2] > 0)
        normals = _array(out["normal"]) if out.get("normal") is not None else None
        K = told * [[photo.width], [photo.height], [1]]
        return EstimatedGeometry(
            points=np.where(valid[..., None], points, 0),
            valid=valid,
            K=K,
            normals=None if normals is None else _facing(normals, points, valid),
            told=f"metric points of {self.name}; focal length {K[0, 0]:.0f} px"
            + (f", told by {image.focal.source}" if image.focal else "")
            + ("; its principal point is not taken" if image.focal and image.focal.centre else ""),
        )

    def _read(self, weights: Weights) -> Any:
        torch = torch_library(self.family.title)
        if not importlib.util.find_spec("moge"):
            raise F3srError(f"{self.family.title} needs moge, which is not installed: {INSTALL}")
        moge = library("moge.model.v2", extra="models", why=self.family.title)
        try:
            held = torch.load(weights.path, map_location="cpu", weights_only=True)
            model = moge.MoGeModel(**held["model_config"])
            model.load_state_dict(held["model"], strict=True)
        except (OSError, ValueError, KeyError, TypeError, RuntimeError, EOFError, _unpickling()) as error:
            found = one_line(f"{type(error).__name__}: {error}")
            raise InputError(weights.path, found=found, accepted="a checkpoint of MoGe-2") from error
        return model


def _unpickling() -> type[Exception]:
    from pickle import UnpicklingError

    return UnpicklingError


def _array(tensor: Any) -> Any:
    return tensor.float().cpu().numpy()


def _facing(normals: Any, points: Any, valid: Any) -> Any:
    """Unit normals (h, w, 3) that face the camera; zero where there is no point."""
    away = (normals * np.where(valid[..., None], points, 0)).sum(-1) > 0
    turned = np.where(away[..., None], -normals, normals)
    return np.where(valid[..., None] & np.isfinite(turned), turned, 0).astype(np.float32)
