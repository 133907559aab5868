"""Meshes from masks without a network: boxes, solids of revolution and inflated silhouettes, each on its support."""
