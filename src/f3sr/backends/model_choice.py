"""Which weights a back end runs, where, and what it needs before it can answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Device = Literal["auto", "cpu", "cuda", "mps"]
Precision = Literal["auto", "float32", "float16", "bfloat16"]


@dataclass(frozen=True, kw_only=True)
class ModelChoice:
    """What the user says of a back end's model."""

    model: str = ""
    """A local folder or file, or a name on the hub; empty is the one that the back end usually runs."""
    device: Device = "auto"
    """``auto`` is the first of cuda, mps and cpu that is there."""
    precision: Precision = "auto"
    """``auto`` is float32 on a CPU, and what the model's authors use elsewhere."""
    allow_downloads: bool = False
    """Whether weights may be fetched. Without it, only what is on this machine is used."""
    axes: str = ""
    """Axes of the normals that a network gives, as "rdf"; empty where they are to be found."""


@dataclass(frozen=True, kw_only=True)
class Need:
    """One thing that a back end cannot answer without."""

    what: str
    """As "package transformers", "weights", "key"."""
    met: bool
    found: str
    """What is there: a version, a path, "none"."""
    remedy: str = ""
    """The command that helps, where it is not met."""
