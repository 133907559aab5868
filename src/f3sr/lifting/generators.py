"""Generators of meshes by name: ours, and what other packages add in the entry point group ``f3sr.assets``."""

from __future__ import annotations

from f3sr.backends.protocols import AssetGenerator
from f3sr.backends.registry import Kind

DEFAULT_GENERATOR = "lifted"
"""Where a folder has no assets and nobody names another."""
ASSET_GENERATORS = Kind(
    name="assets",
    protocol=AssetGenerator,
    built_in={
        DEFAULT_GENERATOR: "f3sr.lifting.lifted_assets:LiftedAssets",
        "sam3d": "f3sr.generators.workers:Sam3dAssets",
        "trellis2": "f3sr.generators.workers:Trellis2Assets",
        "hunyuan3d": "f3sr.generators.workers:Hunyuan3dAssets",
        "triposr": "f3sr.generators.workers:TripoSrAssets",
        "worker": "f3sr.generators.workers:WorkerAssets",
    },
)
