"""How well the poses of a scene are known, and other scenes that the same photo may show."""
