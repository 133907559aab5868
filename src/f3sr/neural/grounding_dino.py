"""Grounding DINO (Liu et al. 2023): words to boxes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from PIL import Image

from f3sr.backends.protocols import Detection
from f3sr.neural.model_loading import LocalModel, ModelFamily, torch_library, transformers_part
from f3sr.neural.relative_boxes import detections
from f3sr.scene import Photo

SCORE = 0.3
"""Least score of a detection: that of the authors' demonstration is .35, the processor's .25. Not measured."""


class GroundingDinoDetector(LocalModel):
    """The Detector ``grounding-dino``. A phrase a pass: over several its labels are spans that mix them."""

    family: ClassVar[ModelFamily] = ModelFamily(
        title="Grounding DINO",
        types=("grounding-dino",),
        default="IDEA-Research/grounding-dino-tiny",
        gigabytes=3.0,
    )

    def detect(self, photo: Photo, phrases: Sequence[str]) -> Sequence[Detection]:
        """Boxes whose best token scores above SCORE."""
        torch = torch_library(self.family.title)
        model = self.transformer("GroundingDinoForObjectDetection")
        weights = self.weights()
        words = transformers_part("AutoTokenizer", weights)
        pictures = transformers_part("AutoImageProcessor", weights, backend="pil")
        pixels = pictures(images=Image.fromarray(photo.rgb), return_tensors="pt").to(model.device)
        found: list[Detection] = []
        with torch.inference_mode():
            for phrase in phrases:
                tokens = words([f"{phrase.lower()}."], return_tensors="pt").to(model.device)
                out = model(
                    pixel_values=pixels["pixel_values"].to(model.dtype), pixel_mask=pixels["pixel_mask"], **tokens
                )
                scores = out.logits[0].float().sigmoid().amax(-1)
                kept = scores > SCORE
                found += detections(
                    photo,
                    [phrase] * int(kept.sum()),
                    scores[kept].cpu().numpy(),
                    out.pred_boxes[0][kept].float().cpu().numpy(),
                    (photo.width, photo.height),
                )
        return found
