"""OpenUSD's Python modules, imported on use, and a layer's text."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any

from f3sr.runtime.extras import library

MODULES = ("Gf", "Kind", "Sdf", "Tf", "Usd", "UsdGeom", "UsdLux", "UsdPhysics", "UsdSemantics", "UsdShade", "Vt")

Stage = Prim = Material = Layer = Any
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


def text_of(stage: Stage, add_files: Callable[[Layer], None]) -> bytes:
    """The root layer as ``.usda``, the same for the same calls.

    ``add_files`` adds what names other layers: a stage would look for them at once, before they are written."""
    layer = pxr().Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    add_files(layer)
    text: str = layer.ExportToString()
    return text.encode()
