"""Laws of the modules: none imports itself by way of others, however late."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

SOURCES = Path(__file__).parents[1] / "src"


def name_of(file: Path) -> str:
    return ".".join(file.relative_to(SOURCES).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(file): file for file in sorted((SOURCES / "f3sr").rglob("*.py"))}


def imported(file: Path) -> Iterator[str]:
    """Modules of f3sr that a file names in any import: at its top, in a function, for types only."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            both = ((f"{node.module}.{alias.name}", node.module) for alias in node.names)
            yield from (part if part in MODULES else whole for part, whole in both)


def test_no_module_imports_itself_by_way_of_others():
    arrows = {name: {i for i in imported(file) if i in MODULES and i != name} for name, file in MODULES.items()}
    assert sum(map(len, arrows.values())) > 300
    TopologicalSorter(arrows).prepare()  # CycleError names the modules
