"""Segmenters, detectors and ground segmenters by name: ours, and what other packages add in the entry point groups
``f3sr.segmentation``, ``f3sr.detection`` and ``f3sr.ground``."""

from __future__ import annotations

from f3sr.backends.protocols import Detector, GroundSegmenter, Segmenter
from f3sr.backends.registry import Kind

DEFAULT_SEGMENTER = "grabcut"
"""Where nobody names another."""
SEGMENTERS = Kind(
    name="segmentation",
    protocol=Segmenter,
    built_in={
        DEFAULT_SEGMENTER: "f3sr.segmentation.grabcut:GrabCut",
        "sam2": "f3sr.neural.sam2:Sam2Segmenter",
        "sam3": "f3sr.neural.sam3:Sam3Segmenter",
    },
)
DETECTORS = Kind(
    name="detection",
    protocol=Detector,
    built_in={
        "sam3": "f3sr.neural.sam3:Sam3Detector",
        "grounding-dino": "f3sr.neural.grounding_dino:GroundingDinoDetector",
        "owlv2": "f3sr.neural.owlv2:Owlv2Detector",
    },
)
GROUND_SEGMENTERS = Kind(
    name="ground",
    protocol=GroundSegmenter,
    built_in={
        "sam3": "f3sr.neural.sam3:Sam3Ground",
        "mask2former": "f3sr.neural.class_maps:Mask2FormerGround",
        "eomt": "f3sr.neural.class_maps:EomtGround",
    },
)
