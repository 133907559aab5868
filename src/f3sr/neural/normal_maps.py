"""Networks that give a surface normal per pixel and no geometry, as TorchScript files: Omnidata (Eftekhar et al. 2021,
Kar et al. 2022) and DSINE (Bae and Davison 2024).

Both see the photo with square pixels about its middle: a stretched or cropped one would be another camera's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.errors import InputError, one_line
from f3sr.neural.model_loading import REMEDY, ModelFamily, torch_library
from f3sr.neural.photo_tensors import IMAGENET
from f3sr.neural.pixel_rays import camera_matrix
from f3sr.neural.torch_script import TorchScriptModel
from f3sr.scene import Photo

SHORTEST, LONGEST = 0.5, 1.5
"""Median length that normals of a network may have before they are made unit vectors."""
KNOWN = 0.5
"""Least share of pixels with a normal."""
LEAST = 0.1
"""Least length of a vector that is a direction."""


class NormalNetwork(TorchScriptModel):
    """A network that maps a photo to normals in axes of its own."""

    documented: ClassVar[str]
    """Its authors' axes, as "rdf"; empty where they contradict each other."""
    _last: tuple[Photo, bytes, NDArray[np.float32]] | None = None

    def predict(self, photo: Photo, K: Array) -> NDArray[np.float32]:
        """Unit vectors (h, w, 3) of the whole photo, zero where unknown. ``K`` (3, 3) [px of the photo].

        Raises InputError for a program that takes no such picture, and for an answer that holds no normals."""
        key = K.tobytes()
        if self._last is None or self._last[0] is not photo or self._last[1] != key:
            self._last = photo, key, self._predicted(photo, K)
        return self._last[2]

    def _predicted(self, photo: Photo, K: Array) -> NDArray[np.float32]:
        raise NotImplementedError

    def _answer(self, side: tuple[int, int], *inputs: Any) -> NDArray[np.float32]:
        """The first three channels (h, w, 3) of the network's last answer, of a ``side`` (h, w)."""
        torch = torch_library(self.family.title)
        device, _ = self.place()
        model = self.network()
        try:
            with torch.inference_mode():
                answer: Any = model(*(value.to(device) for value in inputs))
        except torch.OutOfMemoryError:
            raise
        except (RuntimeError, TypeError, ValueError) as error:
            found = one_line(f"{type(error).__name__}: {error}")[-200:]
            raise InputError(
                self.name, found=found, accepted=f"{self.family.title}'s inputs, {_shapes(inputs)}"
            ) from error
        out: Any = answer[-1] if isinstance(answer, list | tuple) and answer else answer
        shape = tuple(getattr(out, "shape", ()))
        if not isinstance(out, torch.Tensor) or len(shape) != 4 or (shape[0], shape[2:]) != (1, side) or shape[1] < 3:
            found = f"an answer of shape {shape}" if shape else f"an answer of type {type(out).__name__}"
            raise InputError(
                self.name, found=found, accepted=f"(1, 3, {side[0]}, {side[1]}), as {self.family.title} gives it"
            )
        return np.asarray(out[0, :3].permute(1, 2, 0).float().cpu().numpy(), np.float32)

    def _unit(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Unit vectors (h, w, 3), zero where there is no direction. Raises InputError where these are many."""
        lengths = np.linalg.norm(values, axis=2)
        known = np.isfinite(lengths) & (lengths > LEAST)
        accepted = f"vectors of length 1, as {self.family.title} gives them"
        if known.mean() < KNOWN:
            found = f"{100 * (1 - known.mean()):.0f} % of its normals not finite or of no length"
            raise InputError(self.name, found=found, accepted=accepted)
        if not SHORTEST <= (median := float(np.median(lengths[known]))) <= LONGEST:
            raise InputError(self.name, found=f"normals of length {median:.3g}, median", accepted=accepted)
        unit = np.where(known[..., None], values, 0) / np.where(known, lengths, 1)[..., None]
        return unit.astype(np.float32)


class OmnidataNetwork(NormalNetwork):
    """Omnidata's DPT: a square of 384 pixels with colours 0 to 1, normals as colours 0 to 1."""

    family: ClassVar[ModelFamily] = ModelFamily(title="Omnidata normals", gigabytes=2.0, packages={"torch": REMEDY})
    script: ClassVar[tuple[str, str]] = ("omnidata", "omnidata_dpt_normal_v2.pt")
    documented: ClassVar[str] = ""
    side: ClassVar[int] = 384
    """Of the network's square [px]."""

    def _predicted(self, photo: Photo, K: Array) -> NDArray[np.float32]:
        """The photo lies in the middle of the square, grey beside it."""
        torch = torch_library(self.family.title)
        h, w = _even_size(photo, self.side)
        top, left = (self.side - h) // 2, (self.side - w) // 2
        square = torch.full((1, 3, self.side, self.side), 0.5)
        square[..., top : top + h, left : left + w] = _resized(photo, h, w)
        values = 2 * self._answer((self.side, self.side), square) - 1
        return self._unit(values[top : top + h, left : left + w])


class DsineNetwork(NormalNetwork):
    """DSINE: a picture of any size and its intrinsics, a list of normals from -1 to 1, the last of which is best."""

    family: ClassVar[ModelFamily] = ModelFamily(title="DSINE", gigabytes=2.0, packages={"torch": REMEDY})
    script: ClassVar[tuple[str, str]] = ("dsine", "dsine.pt")
    documented: ClassVar[str] = "lub"
    longest: ClassVar[int] = 640
    """Longer side of the picture [px]: that of most of its training data."""
    multiple: ClassVar[int] = 32
    """Sides are padded to multiples of it, evenly on both sides [px]."""

    def _predicted(self, photo: Photo, K: Array) -> NDArray[np.float32]:
        torch = torch_library(self.family.title)
        h, w = _even_size(photo, min(self.longest, max(photo.width, photo.height)))
        high, wide = (math.ceil(n / self.multiple) * self.multiple for n in (h, w))
        top, left = (high - h) // 2, (wide - w) // 2
        mean, std = (torch.tensor(values)[:, None, None] for values in IMAGENET)
        picture = torch.zeros((1, 3, high, wide))
        picture[..., top : top + h, left : left + w] = _resized(photo, h, w)
        # Pixel (0, 0) is the middle of the first pixel there, and its corner here.
        seen = K * [[w / photo.width], [h / photo.height], [1]] + [[0, 0, left - 0.5], [0, 0, top - 0.5], [0, 0, 0]]
        intrinsics = torch.from_numpy(seen.astype(np.float32))[None]
        values = self._answer((high, wide), (picture - mean) / std, intrinsics)
        return self._unit(values[top : top + h, left : left + w])


def assumed_camera(photo: Photo, focal: float | None, centre: tuple[float, float] | None) -> Array:
    """K (3, 3) [px] of a photo whose camera is not found yet: 60 degrees across, as DSINE's authors assume."""
    middle = centre or (photo.width / 2, photo.height / 2)
    return camera_matrix(focal or max(photo.width, photo.height) / 2 / math.tan(math.radians(30)), middle)


def _even_size(photo: Photo, longest: int) -> tuple[int, int]:
    """Height and width [px] with a longer side of ``longest``, both even: then the photo's middle stays the middle."""
    factor = longest / max(photo.width, photo.height)
    return max(2, 2 * round(photo.height * factor / 2)), max(2, 2 * round(photo.width * factor / 2))


def _resized(photo: Photo, h: int, w: int) -> Any:
    """(1, 3, h, w) in 0..1, about pixel centres."""
    torch = torch_library("a network")
    x = torch.from_numpy(np.array(photo.rgb)).permute(2, 0, 1)[None].float() / 255
    return torch.nn.functional.interpolate(x, (h, w), mode="bilinear", antialias=True, align_corners=False)


def _shapes(inputs: Sequence[Any]) -> str:
    return " and ".join(str(tuple(value.shape)) for value in inputs)
