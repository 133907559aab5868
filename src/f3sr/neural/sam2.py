"""SAM 2 (Ravi et al. 2024): boxes and strokes to masks."""

from __future__ import annotations

from typing import ClassVar

from f3sr.neural.model_loading import ModelFamily
from f3sr.neural.photo_tensors import IMAGENET
from f3sr.neural.prompted_masks import PromptedMasks


class Sam2Segmenter(PromptedMasks):
    """The Segmenter ``sam2``; weights of images and of videos."""

    family: ClassVar[ModelFamily] = ModelFamily(
        title="SAM 2",
        types=("sam2", "sam2_video"),
        default="facebook/sam2.1-hiera-small",
        gigabytes=1.5,
        usual="bfloat16",
    )
    model_class: ClassVar[str] = "Sam2Model"
    spread = IMAGENET
