"""The bundled example: a table-top photo with masks, geometry, generated assets and the truth behind them."""

from pathlib import Path

GOAL = "throw the lemon into the mug"
"""What the demo plays in it."""


def folder() -> Path:
    """The prompted-image folder that ships inside the package; made by ``examples/make_tabletop.py``."""
    return Path(__file__).parent / "tabletop"
