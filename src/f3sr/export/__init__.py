"""Writers of scenes in the formats of other programs; each one is a pure function from values to bytes."""
