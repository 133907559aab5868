"""Maps of classes to the support surface: Mask2Former (Cheng et al. 2022) and EoMT (Kerssies et al. 2025)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from f3sr.errors import InputError
from f3sr.neural.model_loading import LocalModel, ModelFamily, torch_library, transformers_part
from f3sr.scene import Photo

SURFACES = frozenset(
    (
        *("floor", "table", "desk", "countertop", "counter", "ground", "earth", "rug", "carpet"),
        *("road", "sidewalk", "pavement", "grass", "sand", "dirt"),
    )
)
"""Words that name what objects stand on, in classes of ADE20K and COCO."""


class ClassMapGround(LocalModel):
    """A GroundSegmenter: of the classes that name a surface, the one with the most pixels."""

    model_class: ClassVar[str]

    def ground(self, photo: Photo) -> NDArray[np.bool_]:
        """(H, W). Raises InputError for a model without such a class."""
        torch = torch_library(self.family.title)
        model = self.transformer(self.model_class)
        weights = self.weights()
        surfaces = surface_classes(model.config.id2label)
        if not surfaces:
            found = f"{len(model.config.id2label)} classes, none of them a surface"
            raise InputError(weights.path, found=found, accepted=f"a class named after {', '.join(sorted(SURFACES))}")
        pictures = transformers_part("AutoImageProcessor", weights, backend="pil")
        inputs = pictures(images=Image.fromarray(photo.rgb), return_tensors="pt")
        parts = {"patch_offsets": offsets} if (offsets := inputs.get("patch_offsets")) is not None else {}
        with torch.inference_mode():
            out = model(pixel_values=inputs["pixel_values"].to(model.device, model.dtype), **parts)
        (found,) = pictures.post_process_semantic_segmentation(out, target_sizes=[(photo.height, photo.width)])
        classes = np.asarray(found.cpu().numpy())
        return classes == max(surfaces, key=lambda k: int(np.count_nonzero(classes == k)))


class Mask2FormerGround(ClassMapGround):
    """The GroundSegmenter ``mask2former``."""

    family: ClassVar[ModelFamily] = ModelFamily(
        title="Mask2Former",
        types=("mask2former",),
        default="facebook/mask2former-swin-small-ade-semantic",
        gigabytes=2.0,
    )
    model_class: ClassVar[str] = "Mask2FormerForUniversalSegmentation"


class EomtGround(ClassMapGround):
    """The GroundSegmenter ``eomt``."""

    family: ClassVar[ModelFamily] = ModelFamily(
        title="EoMT", types=("eomt",), default="tue-mps/ade20k_semantic_eomt_large_512", gigabytes=3.0
    )
    model_class: ClassVar[str] = "EomtForUniversalSegmentation"


def surface_classes(names: Mapping[int, str]) -> list[int]:
    """Classes with a word of SURFACES in their name, as "floor-wood" and "dining table" have."""
    return [int(k) for k, name in names.items() if _words(name) & SURFACES]


def _words(name: str) -> set[str]:
    words: Iterable[str] = re.split(r"[^a-z]+", name.lower())
    return set(words)
