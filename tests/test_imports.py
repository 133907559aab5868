"""Laws of the modules: which may import which, and one meaning for every name."""

from __future__ import annotations

import ast
import importlib
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from types import SimpleNamespace

import pytest

from f3sr.runtime import kernels

SOURCES = Path(__file__).parents[1] / "src"


def name_of(file: Path) -> str:
    return ".".join(file.relative_to(SOURCES).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(file): file for file in sorted((SOURCES / "f3sr").rglob("*.py"))}


@cache
def nodes_of(file: Path) -> tuple[ast.AST, ...]:
    """The nodes of a file that the laws are about."""
    kinds = (ast.Import, ast.ImportFrom, ast.Call, ast.ClassDef)
    return tuple(node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, kinds))


@cache
def imported(file: Path) -> tuple[str, ...]:
    """Modules of f3sr that a file names in any import: at its top, in a function, for types only."""
    return tuple(_imported(file))


def _imported(file: Path) -> Iterator[str]:
    for node in nodes_of(file):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            both = ((f"{node.module}.{alias.name}", node.module) for alias in node.names)
            yield from (part if part in MODULES else whole for part, whole in both)


def test_no_module_imports_itself_by_way_of_others():
    arrows = {name: {i for i in imported(file) if i in MODULES and i != name} for name, file in MODULES.items()}
    assert sum(map(len, arrows.values())) > 300
    TopologicalSorter(arrows).prepare()  # CycleError names the modules


FLOORS = (
    ("f3sr", "errors", "options", "report", "core", "example"),
    ("scene",),
    ("files",),
    ("settings", "runtime", "backends"),
    ("physics", "io", "models"),
    ("vision",),
    ("neural", "hosted", "workers"),
    ("contact", "background", "web", "metrology", "segmentation"),
    ("mesh_poses", "rendering"),
    ("generators", "exporters"),
    ("metrics", "proxies", "scene_package", "mask_page", "importing"),
    ("goals", "uncertainty"),
    ("language.grammar",),
    ("stages", "launches", "lifting"),
    ("pipeline_config",),
    ("contact_retries",),
    ("pipeline",),
    ("language", "report_page"),
    ("play", "delivery", "scene_samples", "scene_export", "photo_inputs"),
    ("film", "dataset", "agents", "edits"),
    ("batch", "env", "certificate", "mcp_server"),
    ("studio",),
    ("cli",),
    ("__main__",),
)
"""A folder or a module at the top imports only what stands on lines above its own: docs/architecture.md draws them."""
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
STAGES = "f3sr.stages."


def room_of(module: str) -> str:
    """The folder that a module lies in, or the module itself at the top."""
    inside = module.removeprefix("f3sr").removeprefix(".")
    return "language.grammar" if inside.startswith("language.grammar") else inside.partition(".")[0] or "f3sr"


def test_imports_lead_downward_only():
    upward = [
        f"{module} imports {name}"
        for module, file in MODULES.items()
        for name in imported(file)
        if name in MODULES and room_of(name) != room_of(module) and FLOOR[room_of(name)] >= FLOOR[room_of(module)]
    ]
    assert not upward


def test_tables_of_implementations_name_no_higher_room():
    """``module:attribute`` in a string is an import too, made later; each leads to something."""
    found = 0
    for module, file in MODULES.items():
        for name, attribute in re.findall(r'"(f3sr\.[\w.]+):(\w+)"', file.read_text()):
            assert FLOOR[room_of(name)] <= FLOOR[room_of(module)], f"{module} names {name}"
            assert hasattr(importlib.import_module(name), attribute), f"{module} names {name}:{attribute}"
            found += 1
    assert found >= 4


def test_no_stage_imports_another():
    """What two stages share lies in a folder below them."""
    across = [
        f"{module} imports {name}"
        for module, file in MODULES.items()
        if module.startswith(STAGES)
        for name in imported(file)
        if name.startswith(STAGES) and name.split(".")[2] != module.split(".")[2]
    ]
    assert not across


def test_names_of_modules_and_classes_are_used_once():
    """A name means one thing; every folder has its ``__init__`` and may have its ``config``."""
    modules = Counter(file.name for file in MODULES.values())
    shared = {"__init__.py", "__main__.py", "config.py"}
    classes = Counter(
        node.name for file in MODULES.values() for node in nodes_of(file) if isinstance(node, ast.ClassDef)
    )
    assert [name for name, count in modules.items() if count > 1 and name not in shared] == []
    assert [name for name, count in classes.items() if count > 1] == []


def test_warming_up_calls_every_module_that_can_be(monkeypatch: pytest.MonkeyPatch):
    """No kernel is left to compile in the middle of a stage, and every file with kernels is in their cache's key."""
    with_kernels = {name for name, file in MODULES.items() if "\n@kernel\n" in file.read_text()}
    able = {name for name, file in MODULES.items() if "\ndef warm_up() " in file.read_text()}
    called = set[str]()

    def imported_module(name: str) -> SimpleNamespace:
        return SimpleNamespace(warm_up=lambda: called.add(name))

    monkeypatch.setattr(kernels.importlib, "import_module", imported_module)
    kernels._call(kernels._warm_ups(film=True))
    assert called == able and len(able) > 8
    assert {name_of(file) for file in kernels.kernel_sources()} == with_kernels and len(with_kernels) > 12


# --- tests ------------------------------------------------------------------------------------------------------

TESTS = Path(__file__).parent
BENCHMARKS = TESTS.parent / "benchmarks"
TOPICS = {"docs", "durability", "forked", "imports", "limits", "memory", "prose", "referee", "studio_pages"}
"""Subjects of tests that no single module or folder has."""


def named(file: Path) -> Iterator[str]:
    """The first part of every module that a file imports, also by name in a call of ``import_module``."""
    for node in nodes_of(file):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.partition(".")[0]
        elif isinstance(node, ast.Call) and called(node) == "import_module":
            yield from (a.value.partition(".")[0] for a in node.args if isinstance(a, ast.Constant))


def called(call: ast.Call) -> str:
    """The last name of what is called."""
    return getattr(call.func, "attr", "") or getattr(call.func, "id", "")


def test_no_test_imports_a_test_or_a_benchmark():
    """What two tests share is a maker without ``test_``; benchmarks may use the makers, never the other way round."""
    scripts = {"benchmarks", *(file.stem for file in BENCHMARKS.rglob("*.py") if file.stem != "conftest")}
    tests = [*sorted(TESTS.glob("*.py")), *sorted(BENCHMARKS.glob("tests/*.py"))]
    wrong = [
        f"{file.name} imports {name}"
        for file in tests
        for name in named(file)
        if name.startswith("test_") or (file.parent == TESTS and name in scripts)
    ]
    assert len(tests) > 50 and not wrong


def test_a_test_has_the_name_of_what_it_tests():
    """A module or a folder of f3sr, or one of a few topics."""
    subjects = TOPICS | {part for name in MODULES for part in name.split(".")}
    assert [f.name for f in TESTS.glob("test_*.py") if f.stem.removeprefix("test_") not in subjects] == []
