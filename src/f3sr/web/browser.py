"""The user's browser, where there is one that opens a window."""

from __future__ import annotations

import os
import sys
import webbrowser

WINDOWS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
"""Environment variables of which one is set where a browser can open a window, or the user named one."""


def shown_in_browser(address: str) -> bool:
    """Whether a browser was asked to open the address. None is on a machine without a screen: a browser of the terminal
    would take the terminal."""
    if sys.platform != "darwin" and not any(os.environ.get(name) for name in WINDOWS):
        return False
    try:
        return webbrowser.open(address)
    except (OSError, webbrowser.Error):
        return False
