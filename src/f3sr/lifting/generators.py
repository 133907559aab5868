"""Generators of meshes by name: ours, and what other packages add in the entry point group ``f3sr.assets``."""

from __future__ import annotations

from f3sr.backends.protocols import AssetGenerator
from f3sr.backends.registry import Kind

DEFAULT_GENERATOR = "lifted"
"""Where a folder has no assets and nobody names another."""
ASSET_GENERATORS = Kind(
    name="assets", protocol=AssetGenerator, built_in={DEFAULT_GENERATOR: "f3sr.lifting.lifted_assets:LiftedAssets"}
)
