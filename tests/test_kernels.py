"""Compiled kernels: all are compiled ahead, one type each; who calls one early waits for it, and for no other."""

from __future__ import annotations

import ast
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numba import njit

import forked
from f3sr.contact.sort_order import sort_order
from f3sr.runtime import kernels
from f3sr.runtime.daemon_thread import begun


def called_from_python() -> Iterator[str]:
    """Module and name of every function under ``@kernel``."""
    for file in kernels.kernel_sources():
        module = ".".join(("f3sr", *file.relative_to(kernels.HERE).with_suffix("").parts))
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef) and "kernel" in map(ast.unparse, node.decorator_list):
                yield f"{module}.{node.name}"


COUNTED = """
import sys
from f3sr.runtime import kernels

kernels._call(kernels._warm_ups(film=True))
for module in [name for name in sys.modules if name.startswith("f3sr.")]:
    for name, value in vars(sys.modules[module]).items():
        if hasattr(value, "signatures") and value.py_func.__module__ == module:
            print(f"{module}.{name}", len(value.signatures))
"""


def test_each_kernel_is_compiled_ahead_with_one_type(compiled: Path):
    told = forked.run([sys.executable, "-c", COUNTED], check=True).stdout
    found = {name: int(count) for name, count in map(str.split, told.splitlines())}
    assert {name: found.get(name) for name in called_from_python()} == dict.fromkeys(called_from_python(), 1)


def test_a_kernel_for_other_kernels_refuses_python():
    """numba would crash."""

    @kernels.inline_kernel
    def twice(x: float) -> float:
        return 2 * x

    @njit
    def four_times(x: float) -> float:
        return twice(twice(x))

    assert four_times(1.5) == 6
    with pytest.raises(TypeError, match="twice is for other kernels only"):
        twice(1.0)


def test_a_reconstruction_imports_no_kernel_of_films():
    code = "import sys, f3sr.pipeline, f3sr.delivery; assert not [m for m in sys.modules if 'rendering' in m]"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert {m.split(".")[1] for m in kernels._warm_ups(film=True)} - {
        m.split(".")[1] for m in kernels._warm_ups(film=False)
    } == {"rendering"}


@pytest.fixture
def compiler(monkeypatch: pytest.MonkeyPatch) -> Iterator[subprocess.Popen[bytes]]:
    """A process that is said to compile the kernels of one folder."""
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        monkeypatch.setitem(kernels._compiled_by, "contact", process)
        yield process
        process.kill()


def test_a_kernel_is_waited_for_until_it_is_there(compiler: subprocess.Popen[bytes], tmp_path: Path):
    file = tmp_path / "f3sr.contact.x.f-1.kernel"
    waiting = begun(kernels._await, file)
    time.sleep(0.1)
    assert not waiting.done()
    file.touch()
    waiting.result(timeout=2)
    assert compiler.poll() is None


def test_no_kernel_is_waited_for_that_nobody_compiles(compiler: subprocess.Popen[bytes], tmp_path: Path):
    kernels._await(tmp_path / "f3sr.vision.x.f-1.kernel")
    waiting = begun(kernels._await, tmp_path / "f3sr.contact.x.f-1.kernel")
    compiler.kill()
    waiting.result(timeout=2)


def test_two_processes_compile_all_kernels_and_those_needed_first_first():
    modules = kernels._warm_ups(film=True)
    shares = kernels._shares(modules)
    assert len(shares) == 2 and sorted(shares[0] + shares[1]) == sorted(modules)
    assert shares[0][0].startswith("f3sr.vision.") and shares[0][-1].startswith("f3sr.rendering.")


@pytest.mark.parametrize("seed", range(20))
def test_equal_keys_are_ordered_as_numba_orders_them(seed: int):
    """Films and scenes of earlier versions rest on it."""
    rng = np.random.default_rng(seed)
    for n in (0, 1, 2, 15, 16, 17, 40, 200):
        keys = rng.integers(0, max(n // 2, 1), n).astype(float)
        assert np.array_equal(sort_order(keys), numbas(keys))


@njit
def numbas(keys: np.ndarray) -> np.ndarray:
    return np.argsort(keys)
