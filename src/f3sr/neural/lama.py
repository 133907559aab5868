"""LaMa (Suvorov et al. 2022): the photo behind its objects, by a TorchScript file."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from f3sr.errors import InputError
from f3sr.neural.model_loading import REMEDY, ModelFamily, torch_library
from f3sr.neural.torch_script import TorchScriptModel
from f3sr.scene import Photo

MULTIPLE = 8
"""Sides of the input are multiples of it [px]."""


class LamaCompleter(TorchScriptModel):
    """The BackgroundCompleter ``lama:FILE``."""

    family: ClassVar[ModelFamily] = ModelFamily(title="LaMa", gigabytes=4.0, packages={"torch": REMEDY})
    script: ClassVar[tuple[str, str]] = ("lama", "big-lama.pt")

    def complete(self, photo: Photo, hole: NDArray[np.bool_], support: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
        """The photo (H, W, 3) with the hole (H, W) by the network, and nothing else of it. The network sees the
        photo mirrored at its right and lower border, up to the next multiple of 8."""
        torch = torch_library(self.family.title)
        model = self.network()
        device, _ = self.place()
        pixels, mask = _padded(photo.rgb.astype(np.float32) / np.float32(255)), _padded(hole.astype(np.float32))
        with torch.inference_mode():
            seen = torch.from_numpy(pixels).permute(2, 0, 1)[None].to(device)
            out = model(seen, torch.from_numpy(mask)[None, None].to(device))
        if not isinstance(out, torch.Tensor) or tuple(out.shape) != tuple(seen.shape) or not out.isfinite().all():
            found = f"an answer of shape {tuple(getattr(out, 'shape', ()))}, or not finite"
            raise InputError(self.name, found=found, accepted=f"{tuple(seen.shape)}, finite, as LaMa gives it")
        filled = (out[0].permute(1, 2, 0).clamp(0, 1).cpu().numpy() * 255).round().astype(np.uint8)
        return np.where(hole[..., None], filled[: photo.height, : photo.width], photo.rgb)


def _padded(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(h, w, ...) mirrored to multiples of 8 at the end of both axes."""
    h, w = values.shape[:2]
    more = ((0, -h % MULTIPLE), (0, -w % MULTIPLE), *((0, 0),) * (values.ndim - 2))
    return np.pad(values, more, mode="symmetric")
