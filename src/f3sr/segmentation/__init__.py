"""Masks of objects and of the ground from boxes, clicks and strokes in a photo, without a network."""
