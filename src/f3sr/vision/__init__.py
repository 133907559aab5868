"""Scenes against photos: rasterising, silhouettes with derivatives, what colour and depth add, occlusion."""
