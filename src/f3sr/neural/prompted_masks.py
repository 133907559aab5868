"""Boxes and strokes to masks by a promptable network of SAM's kind: one embedding a photo, many prompts at a time."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.model_choice import ModelChoice
from f3sr.backends.protocols import Prompt, Stroke
from f3sr.neural.model_loading import LocalModel, torch_library
from f3sr.neural.photo_tensors import at_photo, stretched
from f3sr.scene import Photo

CLICKS = 6
"""Most points of the strokes on, and of those off, an object: such networks were trained on few clicks."""
AT_ONCE = 32
"""Most prompts of one call."""
INSIDE, OUTSIDE = 1, 0
"""Labels of points."""

Clicks = tuple[tuple[float, float, int], ...]


class PromptedMasks(LocalModel):
    """A Segmenter. A subclass names the model class and the spread of its input."""

    model_class: ClassVar[str]
    spread: ClassVar[tuple[tuple[float, ...], tuple[float, ...]]]

    def __init__(self, choice: ModelChoice | None = None) -> None:
        super().__init__(choice)
        self._seen: tuple[str, Any] = ("", None)

    def segment(self, photo: Photo, prompts: Sequence[Prompt]) -> Sequence[NDArray[np.bool_]]:
        """One mask (H, W) per prompt, each on its own: other prompts and their order change none.

        A mask is where the logits, resized to the photo, are above 0. It may be empty, which the caller refuses."""
        torch = torch_library(self.family.title)
        model = self.transformer(self.model_class)
        side = int(model.config.prompt_encoder_config.image_size)
        scale = (side / photo.width, side / photo.height)
        masks: dict[int, NDArray[np.bool_]] = {}
        with torch.inference_mode():
            embedded = self._embedded(model, photo, side)
            for numbers in _alike(prompts):
                asked = _asked(torch, [prompts[k] for k in numbers], scale, model)
                logits = model(image_embeddings=embedded, multimask_output=False, **asked).pred_masks[0, :, 0]
                masks |= {k: at_photo(values, photo) > 0 for k, values in zip(numbers, logits, strict=True)}
        return [masks[k] for k in range(len(prompts))]

    def _embedded(self, model: Any, photo: Photo, side: int) -> Any:
        """The photo's embeddings; those of the last photo are kept, for the next stroke on it."""
        digest = hashlib.sha256(repr(photo.rgb.shape).encode() + photo.rgb.tobytes()).hexdigest()
        if self._seen[0] != digest:
            pixels = stretched(photo, side, self.spread, antialias=True)
            self._seen = (digest, model.get_image_embeddings(pixels.to(model.device, model.dtype)))
        return self._seen[1]


def _alike(prompts: Sequence[Prompt]) -> Iterator[list[int]]:
    """Numbers of prompts with a box or without, and as many points: a call pads none of them."""
    groups = defaultdict[tuple[bool, int], list[int]](list)
    for k, prompt in enumerate(prompts):
        groups[prompt.box is not None, len(_clicks(prompt))].append(k)
    for numbers in groups.values():
        for start in range(0, len(numbers), AT_ONCE):
            yield numbers[start : start + AT_ONCE]


def _asked(torch: Any, prompts: Sequence[Prompt], scale: tuple[float, float], model: Any) -> dict[str, Any]:
    """Boxes (1, n, 4), points (1, n, k, 2) in pixels of the input and their labels (1, n, k)."""
    asked: dict[str, Any] = {}
    if prompts[0].box is not None:
        boxes = torch.tensor([[prompt.box for prompt in prompts]], dtype=torch.float32)
        asked["input_boxes"] = (boxes * torch.tensor([*scale, *scale])).to(model.device, model.dtype)
    clicks = [_clicks(prompt) for prompt in prompts]
    if clicks[0]:
        points = torch.tensor([[[(x, y) for x, y, _ in some] for some in clicks]], dtype=torch.float32)
        labels = torch.tensor([[[label for _, _, label in some] for some in clicks]])
        asked["input_points"] = (points * torch.tensor(scale)).to(model.device, model.dtype)
        asked["input_labels"] = labels.to(model.device)
    return asked


def _clicks(prompt: Prompt) -> Clicks:
    return (*_few(prompt.inside, INSIDE), *_few(prompt.outside, OUTSIDE))


def _few(strokes: Sequence[Stroke], label: int) -> Iterator[tuple[float, float, int]]:
    """At most CLICKS points of some strokes, evenly."""
    points = [point for stroke in strokes for point in stroke]
    kept = np.unique(np.linspace(0, len(points) - 1, min(CLICKS, len(points))).round().astype(int)) if points else []
    yield from ((*points[k], label) for k in kept)
