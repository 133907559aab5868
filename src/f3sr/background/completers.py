"""Completers of the photo's background by name: ours, and what other packages add in the entry point group
``f3sr.background``."""

from __future__ import annotations

from f3sr.backends.protocols import BackgroundCompleter
from f3sr.backends.registry import Kind

DEFAULT_COMPLETER = "patchmatch"
"""Where nobody names another, with the settings of ``inpaint.completion``."""
BACKGROUND_COMPLETERS = Kind(
    name="background",
    protocol=BackgroundCompleter,
    built_in={DEFAULT_COMPLETER: "f3sr.background:PatchMatch", "lama": "f3sr.neural.lama:LamaCompleter"},
)
