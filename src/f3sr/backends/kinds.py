"""Kinds of back ends without a built-in implementation. Entry point groups are ``f3sr.NAME``, as in ``f3sr.geometry``.

Other kinds are declared next to their implementations: BACKGROUND_COMPLETERS in ``background/``, LANGUAGES in
``play/``, EXPORTERS in ``exporters/``.
"""

from __future__ import annotations

from f3sr.backends.protocols import AssetGenerator, GeometryEstimator, Labeler, SceneGrapher, Segmenter
from f3sr.backends.registry import Kind

SEGMENTERS = Kind(name="segmentation", protocol=Segmenter)
GEOMETRY_ESTIMATORS = Kind(name="geometry", protocol=GeometryEstimator)
ASSET_GENERATORS = Kind(name="assets", protocol=AssetGenerator)
LABELERS = Kind(name="labels", protocol=Labeler)
SCENE_GRAPHERS = Kind(name="scene_graph", protocol=SceneGrapher)
