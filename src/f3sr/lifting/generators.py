"""Generators of meshes by name: ours, and what other packages add in the entry point group ``f3sr.assets``."""

from __future__ import annotations

from f3sr.backends.protocols import AssetGenerator
from f3sr.backends.registry import Kind
from f3sr.hosted.services import SERVICES

DEFAULT_GENERATOR = "lifted"
"""Where a folder has no assets and nobody names another."""
SAVED = "saved"
"""Meshes that a generator left in a folder, with or without poses."""
ASSET_GENERATORS = Kind(
    name="assets",
    protocol=AssetGenerator,
    built_in={
        DEFAULT_GENERATOR: "f3sr.lifting.lifted_assets:LiftedAssets",
        "sam3d": "f3sr.generators.worker_assets:sam3d",
        "trellis2": "f3sr.generators.worker_assets:trellis2",
        "hunyuan3d": "f3sr.generators.worker_assets:hunyuan3d",
        "triposr": "f3sr.generators.worker_assets:triposr",
        "worker": "f3sr.generators.worker_assets:worker",
        SAVED: "f3sr.generators.saved_meshes:saved",
        **{s.name: f"f3sr.generators.hosted_assets:{s.name.replace('-', '_')}" for s in SERVICES},
    },
)
