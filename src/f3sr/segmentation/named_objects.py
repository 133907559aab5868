"""Objects that words name: what a detector finds for each phrase, without duplicates, as prompts and masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.backends.protocols import Detection, Detector, GroundSegmenter, Prompt, Segmenter
from f3sr.backends.registry import Backend, Kind
from f3sr.errors import InputError
from f3sr.files.bounds import MAX_OBJECTS
from f3sr.io.answers import checked_detections, checked_ground
from f3sr.io.masks import MIN_PIXELS
from f3sr.scene import Photo
from f3sr.segmentation.selection import MIN_BOX, Outlines, Selection, outlined, told_apart

MAX_PHRASES = 50
"""Most phrases: a detector takes a pass for each."""
MAX_PHRASE = 100
"""Most characters of a phrase: detectors read some thirty words."""
SAME = 0.7
"""Intersection over union from which on two boxes, or two masks, are of one object. Not measured on real models."""


@dataclass(frozen=True, eq=False, kw_only=True)
class NamedObjects:
    """A prompt and a mask for every object that was found, and what a user should know."""

    selection: Selection
    outlines: Outlines
    told: tuple[str, ...]


def phrases_of(text: str) -> tuple[str, ...]:
    """Phrases of a comma-separated text, each once, spaces between words single. Raises InputError for none, too many
    and too long ones."""
    phrases = tuple(dict.fromkeys(filter(None, (" ".join(part.split()) for part in text.split(",")))))
    accepted = f"1 to {MAX_PHRASES} phrases of at most {MAX_PHRASE} printable characters, comma separated"
    if not 1 <= len(phrases) <= MAX_PHRASES:
        raise InputError("--segment", found=f"{len(phrases)} phrases", accepted=accepted)
    if bad := [phrase for phrase in phrases if len(phrase) > MAX_PHRASE or not phrase.isprintable()]:
        raise InputError("--segment", found=f"the phrase {bad[0]!r:.60}", accepted=accepted)
    return phrases


def back_ends_of(spec: str, segmenters: Kind[Segmenter]) -> tuple[str, str | None]:
    """The detector and the segmenter of ``DETECTOR[:MODEL][+SEGMENTER[:MODEL]]``; a ``+`` within a model's path
    parts nothing."""
    places = [k for k, letter in enumerate(spec) if letter == "+"]
    for k in reversed(places):
        if spec[k + 1 :].partition(":")[0] in segmenters.names():
            return spec[:k], spec[k + 1 :]
    if places and not any(c in spec for c in ":/"):
        segmenters.find(spec[places[0] + 1 :])  # says which names there are
    return spec, None


def named_objects(
    photo: Photo,
    phrases: Sequence[str],
    detector: Backend[Detector],
    segmenter: Backend[Segmenter] | None,
    default: Backend[Segmenter],
    *,
    ground: Prompt | None = None,
) -> NamedObjects:
    """The objects of a photo that phrases name, several for a phrase that names several.

    Masks are those of ``segmenter`` for the detector's boxes. Without it they are the detector's own, where it gives
    one for all, else those of the ``default``. ``ground`` points at what they stand on. Raises InputError where nothing
    is found, and for wrong answers.
    """
    answer = detector.asked(lambda d: d.detect(photo, phrases))
    every = _large(checked_detections(str(detector), answer, photo, phrases))
    found = distinct(every)
    if not found:
        words = ", ".join(phrases)
        raise InputError(
            "--segment", found=f"nothing for {words} by {detector.told}", accepted="words for what the photo shows"
        )
    if len(found) > MAX_OBJECTS:
        raise InputError("--segment", found=f"{len(found)} objects", accepted=f"at most {MAX_OBJECTS}")
    found = sorted(found, key=lambda d: (phrases.index(d.label), d.box))
    prompts = tuple(Prompt(label=d.label, box=d.box) for d in found)
    selection = Selection(prompts=prompts, ground=ground or Prompt())
    masks = [d.mask for d in found if d.mask is not None]
    if segmenter is None and len(masks) == len(found):
        made_by = f"boxes and masks by {detector.told}"
        outlines = told_apart(photo, masks, selection)
    else:
        chosen = segmenter or default
        outlines = outlined(photo, selection, chosen)
        made_by = f"boxes by {detector.told}; masks by {chosen.told}"
    told = [made_by, *_told(phrases, found, len(every))]
    return NamedObjects(selection=replace(selection, made_by=made_by), outlines=outlines, told=tuple(told))


def distinct(found: Sequence[Detection]) -> list[Detection]:
    """Detections without duplicates, whatever phrase named them: of two that are SAME the higher score stays."""
    kept: list[Detection] = []
    for d in sorted(found, key=lambda d: (-d.score, d.label, d.box)):
        if all(_overlap(d, other) < SAME for other in kept):
            kept.append(d)
    return kept


def with_ground(photo: Photo, outlines: Outlines, segmenter: Backend[GroundSegmenter]) -> Outlines:
    """The ground by a back end, less the objects. Raises InputError where it shows none."""
    answer = segmenter.asked(lambda s: s.ground(photo))
    ground = checked_ground(str(segmenter), answer, photo) & ~np.any(outlines.masks, axis=0)
    if int(ground.sum()) < MIN_PIXELS:
        found = f"{int(ground.sum())} pixels of ground beside the objects"
        raise InputError(str(segmenter), found=found, accepted=f"at least {MIN_PIXELS}")
    return replace(outlines, ground=ground)


def _large(found: Sequence[Detection]) -> list[Detection]:
    """Those that a mask can be cut out of, or has enough pixels of."""
    return [
        d
        for d in found
        if min(d.box[2] - d.box[0], d.box[3] - d.box[1]) >= MIN_BOX
        and (d.mask is None or int(d.mask.sum()) >= MIN_PIXELS)
    ]


def _overlap(a: Detection, b: Detection) -> float:
    """Intersection over union, of masks where both have one."""
    if a.mask is not None and b.mask is not None:
        return _share(float((a.mask & b.mask).sum()), float((a.mask | b.mask).sum()))
    width = min(a.box[2], b.box[2]) - max(a.box[0], b.box[0])
    height = min(a.box[3], b.box[3]) - max(a.box[1], b.box[1])
    both = max(0.0, width) * max(0.0, height)
    return _share(both, _area(a) + _area(b) - both)


def _share(both: float, either: float) -> float:
    return both / either if either else 0.0


def _area(d: Detection) -> float:
    left, top, right, bottom = d.box
    return (right - left) * (bottom - top)


def _told(phrases: Sequence[str], found: Sequence[Detection], every: int) -> list[str]:
    """Phrases without an object, and how many detections were duplicates."""
    labels = {d.label for d in found}
    told = [f"nothing found for {phrase!r}" for phrase in phrases if phrase not in labels]
    return told + ([f"duplicates left out: {every - len(found)}"] if every > len(found) else [])
