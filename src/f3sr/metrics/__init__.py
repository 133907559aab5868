"""The measures of a scene, and what they are computed with."""
