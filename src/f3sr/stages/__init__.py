"""The stages, each a file or a folder: ``stage(scene, ..., config) -> (scene, report)``; none imports another."""
