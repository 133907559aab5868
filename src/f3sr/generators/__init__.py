"""Generators of meshes as asset generators: others' processes and services, their answers posed in the photo."""
