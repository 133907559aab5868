"""Kinds of back ends without a built-in implementation. Entry point groups are ``f3sr.NAME``, as in ``f3sr.labels``.

Other kinds are declared next to their implementations: GEOMETRY_ESTIMATORS in ``metrology/``, ASSET_GENERATORS in
``lifting/``, SEGMENTERS, DETECTORS and GROUND_SEGMENTERS in ``segmentation/``, BACKGROUND_COMPLETERS in
``background/``, LANGUAGES in ``play/``, EXPORTERS in ``exporters/``.
"""

from __future__ import annotations

from f3sr.backends.protocols import Labeler, SceneGrapher
from f3sr.backends.registry import Kind

LABELERS = Kind(name="labels", protocol=Labeler)
SCENE_GRAPHERS = Kind(name="scene_graph", protocol=SceneGrapher)
