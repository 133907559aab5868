"""The stages: each one file, each ``stage(scene, ..., config) -> (scene, report)``, none importing another."""
