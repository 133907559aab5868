"""The bundled example: a table-top photo with masks, geometry, generated assets and the truth behind them."""

from pathlib import Path


def folder() -> Path:
    """The prompted-image folder that ships inside the package; made by ``examples/make_tabletop.py``."""
    return Path(__file__).parent / "tabletop"
