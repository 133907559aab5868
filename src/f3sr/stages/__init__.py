"""The stages, each a file or a folder: ``stage(scene, ..., config) -> (scene, outcome)``; none imports another."""
