"""Photos as tensors of a network, and its maps back at the photo's pixels; both resized about pixel centres."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.neural.model_loading import torch_library
from f3sr.scene import Photo

IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
"""Mean and standard deviation of RGB/255."""
HALF = ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
"""The same of models that were trained on -1 to 1."""


def stretched(photo: Photo, size: int, spread: tuple[tuple[float, ...], tuple[float, ...]], *, antialias: bool) -> Any:
    """The photo as (1, 3, size, size) float32, its aspect not kept, less the mean, by the standard deviation.

    With ``antialias`` grey levels are rounded after resizing, as the processors of SAM do.
    """
    torch = torch_library("a network")
    x = torch.from_numpy(np.array(photo.rgb)).permute(2, 0, 1)[None]
    mean, std = (torch.tensor(values)[:, None, None] for values in spread)
    if antialias:
        x = torch.nn.functional.interpolate(x, (size, size), mode="bilinear", antialias=True, align_corners=False)
        return (x.float() / 255 - mean) / std
    x = (x.float() / 255 - mean) / std
    return torch.nn.functional.interpolate(x, (size, size), mode="bilinear", align_corners=False)


def at_photo(values: Any, photo: Photo, mode: str = "bilinear") -> NDArray[np.float32]:
    """A map (h, w) of the whole photo, read at the photo's pixels (H, W)."""
    torch = torch_library("a network")
    shape = (photo.height, photo.width)
    whole = torch.nn.functional.interpolate(values.float()[None, None], shape, mode=mode, align_corners=False)
    return np.asarray(whole[0, 0].cpu().numpy(), np.float32)
