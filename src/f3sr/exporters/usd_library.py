"""OpenUSD's Python modules, imported on use, and a layer's text."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any

from f3sr.runtime.extras import library

MODULES = ("Gf", "Kind", "Sdf", "Tf", "Usd", "UsdGeom", "UsdLux", "UsdPhysics", "UsdSemantics", "UsdShade", "Vt")

Stage = Prim = Material = Any
"""Classes of OpenUSD, which carries no type information."""


@cache
def pxr() -> Any:
    """The modules of ``pxr`` by name. Raises F3srError where usd-core is not installed."""
    named = {name: library(f"pxr.{name}", extra="usd", why="the format usd") for name in MODULES}
    return SimpleNamespace(**named)


def new_stage(root: str, *, kind: str) -> tuple[Stage, Prim]:
    """A stage in metres and kilograms, Z up, and its default prim, an Xform of the name ``root``."""
    usd = pxr()
    stage = usd.Usd.Stage.CreateInMemory()
    usd.UsdGeom.SetStageUpAxis(stage, usd.UsdGeom.Tokens.z)
    usd.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    usd.UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    prim = usd.UsdGeom.Xform.Define(stage, f"/{root}").GetPrim()
    stage.SetDefaultPrim(prim)
    usd.Usd.ModelAPI(prim).SetKind(kind)
    return stage, prim


def text_of(stage: Stage, references: Mapping[str, str] | None = None) -> bytes:
    """The root layer as ``.usda``, the same for the same calls. ``references`` are files by the path of their prim."""
    sdf = pxr().Sdf
    layer = sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    # A stage would look for the files at once, before they are written.
    for path, file in (references or {}).items():
        layer.GetPrimAtPath(path).referenceList.Prepend(sdf.Reference(file))
    text: str = layer.ExportToString()
    return text.encode()
