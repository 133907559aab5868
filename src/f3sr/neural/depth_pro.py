"""Depth Pro (Bochkovskii et al. 2024): metric depth and the field of view of one photo."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from f3sr.backends.protocols import EstimatedGeometry, PromptedImage
from f3sr.errors import InputError
from f3sr.neural.model_loading import LocalModel, ModelFamily, torch_library
from f3sr.neural.photo_tensors import HALF, at_photo, stretched
from f3sr.neural.pixel_rays import camera_matrix, rays

NEAREST, FARTHEST = 1e-4, 1e4
"""Range of depths [m] of the processor. What lies at an end of it is no depth."""


class DepthProGeometry(LocalModel):
    """The GeometryEstimator ``depth-pro``."""

    family: ClassVar[ModelFamily] = ModelFamily(
        title="Depth Pro", types=("depth_pro",), default="apple/DepthPro-hf", gigabytes=6.0, usual="float16"
    )

    def estimate(self, image: PromptedImage) -> EstimatedGeometry:
        """Points [m] at every pixel of the photo. A known focal length takes the place of the network's: its inverse
        depths are those of a camera as wide as the photo, so depths grow with it. Raises InputError for a field of
        view that no lens has."""
        torch, photo = torch_library(self.family.title), image.photo
        model = self.transformer("DepthProForDepthEstimation")
        with torch.inference_mode():
            pixels = stretched(photo, _side(model.config), HALF, antialias=False)
            out = model(pixel_values=pixels.to(model.device, model.dtype))
        told = math.nan if out.field_of_view is None else float(out.field_of_view.float().reshape(-1)[0])
        focal = image.focal.pixels if image.focal else _focal(told, photo.width)
        inverse = at_photo(out.predicted_depth[0].float() * (photo.width / focal), photo)
        valid = (inverse > 1 / FARTHEST) & (inverse < 1 / NEAREST)  # NaN is not
        depth = 1 / np.where(valid, inverse, 1)
        centre = (image.focal and image.focal.centre) or (photo.width / 2, photo.height / 2)
        K = camera_matrix(focal, centre)
        source = f"told by {image.focal.source}" if image.focal else f"by its field of view of {told:.1f} degrees"
        return EstimatedGeometry(
            points=(rays(K, photo.width, photo.height) * depth[..., None]).astype(np.float32),
            valid=valid,
            K=K,
            told=f"metric depths of {self.name}; focal length {focal:.0f} px, {source}",
        )


def _focal(degrees: float, width: int) -> float:
    """Of a horizontal field of view."""
    if not 1 <= degrees <= 175:  # false for NaN too
        raise InputError("Depth Pro", found=f"a field of view of {degrees:.3g} degrees", accepted="1 to 175")
    return width / 2 / math.tan(math.radians(degrees) / 2)


def _side(config: object) -> int:
    """Side of the square input [px]: the patches' side over the smallest scale of the pyramid."""
    patch, ratios = getattr(config, "patch_size", 384), getattr(config, "scaled_images_ratios", [0.25, 0.5, 1])
    return round(patch / min(ratios))
