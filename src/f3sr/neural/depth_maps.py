"""Networks that give a depth or an inverse depth per pixel and no camera: Depth Anything (Yang et al. 2024) and DPT
(Ranftl et al. 2021)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from f3sr.neural.model_loading import LocalModel, ModelFamily, torch_library, transformers_part
from f3sr.neural.photo_tensors import at_photo
from f3sr.scene import Photo


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthMap:
    """``values`` (H, W) at the photo's pixels: depth along the optical axis [m] where ``metric``, else inverse depth
    of unknown scale and shift, larger where nearer."""

    values: NDArray[np.float32]
    metric: bool


class DepthNetwork(LocalModel):
    """A network that maps a photo to a DepthMap."""

    def predict(self, photo: Photo) -> DepthMap:
        """The map, resized to the photo as the library's processor does (bicubic, about pixel centres)."""
        torch = torch_library(self.family.title)
        model = self.transformer("AutoModelForDepthEstimation")
        pictures = transformers_part("AutoImageProcessor", self.weights(), backend="pil")
        pixels = pictures(images=Image.fromarray(photo.rgb), return_tensors="pt")["pixel_values"]
        with torch.inference_mode():
            depth = model(pixel_values=pixels.to(model.device, model.dtype)).predicted_depth[0]
        metric = getattr(model.config, "depth_estimation_type", "relative") == "metric"
        return DepthMap(values=at_photo(depth, photo, "bicubic"), metric=metric)


class DepthAnythingNetwork(DepthNetwork):
    """Depth Anything V1 and V2; its configuration tells whether it is metric."""

    family: ClassVar[ModelFamily] = ModelFamily(
        title="Depth Anything",
        types=("depth_anything",),
        default="depth-anything/Depth-Anything-V2-Small-hf",
        gigabytes=1.0,
    )


class DptNetwork(DepthNetwork):
    """DPT, as MiDaS: relative."""

    family: ClassVar[ModelFamily] = ModelFamily(title="DPT", types=("dpt",), default="Intel/dpt-large", gigabytes=2.0)
