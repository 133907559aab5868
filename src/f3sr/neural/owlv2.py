"""OWLv2 (Minderer et al. 2023): words to boxes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from PIL import Image

from f3sr.backends.protocols import Detection
from f3sr.neural.model_loading import LocalModel, ModelFamily, torch_library, transformers_part
from f3sr.neural.relative_boxes import detections
from f3sr.scene import Photo

SCORE = 0.2
"""Least score of a detection: the authors' threshold; the processor's is .1. Not measured."""
TEMPLATE = "a photo of a {}"
"""Sentence that the network was trained on."""


class Owlv2Detector(LocalModel):
    """The Detector ``owlv2``: all phrases in one pass, and a box has the phrase that fits it best."""

    family: ClassVar[ModelFamily] = ModelFamily(
        title="OWLv2", types=("owlv2",), default="google/owlv2-base-patch16-ensemble", gigabytes=3.0
    )

    def detect(self, photo: Photo, phrases: Sequence[str]) -> Sequence[Detection]:
        """Boxes that score above SCORE. The network sees the photo padded to a square, right and below: its boxes are
        shares of that square."""
        torch = torch_library(self.family.title)
        model = self.transformer("Owlv2ForObjectDetection")
        weights = self.weights()
        words = transformers_part("AutoTokenizer", weights)
        pictures = transformers_part("AutoImageProcessor", weights, backend="pil")
        pixels = pictures(images=Image.fromarray(photo.rgb), return_tensors="pt").to(model.device)
        length = int(model.config.text_config.max_position_embeddings)
        tokens = words(
            [TEMPLATE.format(phrase) for phrase in phrases],
            padding="max_length",
            max_length=length,
            truncation=True,
            return_tensors="pt",
        ).to(model.device)
        with torch.inference_mode():
            out = model(
                pixel_values=pixels["pixel_values"].to(model.dtype),
                input_ids=tokens["input_ids"],
                attention_mask=tokens["attention_mask"],
            )
        best = out.logits[0].float().max(-1)
        scores = best.values.sigmoid()
        kept = scores > SCORE
        side = float(max(photo.width, photo.height))
        labels: list[str] = [phrases[int(k)] for k in best.indices[kept].tolist()]
        boxes = out.pred_boxes[0][kept].float().cpu().numpy()
        return list(detections(photo, labels, scores[kept].cpu().numpy(), boxes, (side, side)))
