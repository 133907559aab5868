"""SAM 3 (Carion et al. 2025): boxes, strokes and words to masks, and the support surface by words.

Its weights are gated: the user agrees to the SAM License on the hub before fetching them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import Detection
from f3sr.neural.model_loading import LocalModel, ModelFamily, torch_library, transformers_part
from f3sr.neural.photo_tensors import HALF, at_photo, stretched
from f3sr.neural.prompted_masks import PromptedMasks
from f3sr.scene import Photo

SCORE = 0.3
"""Least score of a detection: the processor's default."""
TOKENS = 32
"""Tokens of a phrase, padded."""
SURFACES = ("table top", "floor", "ground")
"""What objects stand on."""

Box = tuple[float, float, float, float]


class Sam3Segmenter(PromptedMasks):
    """The Segmenter ``sam3``: its tracker, asked about one photo."""

    family: ClassVar[ModelFamily] = ModelFamily(
        title="SAM 3",
        types=("sam3_tracker", "sam3_tracker_video", "sam3_video"),
        default="facebook/sam3",
        gigabytes=5.0,
        usual="bfloat16",
    )
    model_class: ClassVar[str] = "Sam3TrackerModel"
    spread = HALF


class WordedSam3(LocalModel):
    """SAM 3 asked by words: the photo is encoded once, then every phrase by itself."""

    family: ClassVar[ModelFamily] = ModelFamily(
        title="SAM 3", types=("sam3", "sam3_video"), default="facebook/sam3", gigabytes=5.0, usual="bfloat16"
    )

    def answers(self, photo: Photo, phrases: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """The network's output for every phrase."""
        torch = torch_library(self.family.title)
        model = self.transformer("Sam3Model")
        words = transformers_part("AutoTokenizer", self.weights())
        side = int(model.config.vision_config.backbone_config.image_size)
        with torch.inference_mode():
            pixels = stretched(photo, side, HALF, antialias=True).to(model.device, model.dtype)
            seen = model.get_vision_features(pixel_values=pixels)
            for phrase in phrases:
                tokens = words(
                    [phrase], padding="max_length", max_length=TOKENS, truncation=True, return_tensors="pt"
                ).to(model.device)
                yield (
                    phrase,
                    model(vision_embeds=seen, input_ids=tokens.input_ids, attention_mask=tokens.attention_mask),
                )


class Sam3Detector(WordedSam3):
    """The Detector ``sam3``: boxes and masks of every instance that a phrase names."""

    def detect(self, photo: Photo, phrases: Sequence[str]) -> Sequence[Detection]:
        """Instances with a score above SCORE whose mask has a pixel; boxes lie within the photo."""
        return [found for phrase, out in self.answers(photo, phrases) for found in _instances(photo, phrase, out)]


class Sam3Ground(WordedSam3):
    """The GroundSegmenter ``sam3``: the largest of the surfaces that SURFACES name."""

    def ground(self, photo: Photo) -> NDArray[np.bool_]:
        """(H, W); the semantic map of one phrase, more likely than not."""
        maps = [at_photo(out.semantic_seg[0, 0].sigmoid(), photo) > 0.5 for _, out in self.answers(photo, SURFACES)]
        return max(maps, key=lambda surface: int(surface.sum()))


def _instances(photo: Photo, phrase: str, out: Any) -> Iterator[Detection]:
    scores = (out.pred_logits.float().sigmoid() * out.presence_logits.float().sigmoid())[0]
    size = np.array([photo.width, photo.height] * 2, float)
    for k in np.flatnonzero(scores.cpu().numpy() > SCORE):
        mask = at_photo(out.pred_masks[0, k].float().sigmoid(), photo) > 0.5
        if mask.any():
            corners = np.clip(out.pred_boxes[0, k].float().cpu().numpy() * size, 0, size)
            yield Detection(label=phrase, score=float(scores[k]), box=_box(corners), mask=mask)


def _box(corners: NDArray[np.floating]) -> Box:
    left, top, right, bottom = map(float, corners)
    return left, top, right, bottom
