"""The kinds that have no built-in implementation yet. Others stand beside theirs: BACKGROUND_COMPLETERS in
``background/``, LANGUAGES in ``play/``, EXPORTERS in ``exporters/``."""

from __future__ import annotations

from f3sr.backends.protocols import AssetGenerator, GeometryEstimator, SceneGrapher, Segmenter
from f3sr.backends.registry import Kind

SEGMENTERS = Kind(name="segmentation", protocol=Segmenter)
GEOMETRY_ESTIMATORS = Kind(name="geometry", protocol=GeometryEstimator)
ASSET_GENERATORS = Kind(name="assets", protocol=AssetGenerator)
SCENE_GRAPHERS = Kind(name="scene_graph", protocol=SceneGrapher)
