"""Segmenters by name: ours, and what other packages add in the entry point group ``f3sr.segmentation``."""

from __future__ import annotations

from f3sr.backends.protocols import Segmenter
from f3sr.backends.registry import Kind

DEFAULT_SEGMENTER = "grabcut"
"""Where nobody names another."""
SEGMENTERS = Kind(
    name="segmentation", protocol=Segmenter, built_in={DEFAULT_SEGMENTER: "f3sr.segmentation.grabcut:GrabCut"}
)
