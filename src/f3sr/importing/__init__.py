"""Scenes of other programs as prompted-image folders: their photo, camera, meshes and poses, masks drawn if absent."""
