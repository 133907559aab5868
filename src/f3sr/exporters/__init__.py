"""Scenes in the formats of other programs: one file a format, from values to bytes."""
