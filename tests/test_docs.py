"""The examples of the documents do what they say: all python blocks of a file run in order, in an empty folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from f3sr import example
from f3sr.io import inputs
from folders import part_of_example

ROOT = Path(__file__).parents[1]


STORED = """
import functools, os, pathlib, f3sr, f3sr.example
f3sr.example.folder = lambda: pathlib.Path({example!r})
f3sr.Store.default = lambda: f3sr.Store(pathlib.Path({folder!r}))
f3sr.reconstruct = functools.partial(f3sr.reconstruct, store=f3sr.Store.default())
"""
"""Before the examples: a part of the bundled scene, and what one document reconstructs, the next takes from a store."""


TWO = ("06_dotted_mug", "09_lemon")
"""The object of the bundled scene that the examples name, and one beside it."""


def test_the_bundled_example_is_whole() -> None:
    given = inputs.read(example.folder())
    assert len(given.instances) == len(given.assets) == 10 and not [d for d in given.decisions if d.fallback]


@pytest.mark.slow
def test_the_examples_run(tmp_path: Path) -> None:
    stored = STORED.format(folder=str(tmp_path / "stages"), example=str(part_of_example(tmp_path / "part", TWO)))
    script = [stored]
    for name in ("README.md", "docs/python.md"):
        blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / name).read_text(), flags=re.DOTALL | re.MULTILINE)
        assert blocks
        place = tmp_path / Path(name).stem
        place.mkdir()
        script.append(f"os.chdir({str(place)!r}); exec(compile({''.join(blocks)!r}, {name!r}, 'exec'), {{}})")
    done = subprocess.run(
        [sys.executable, "-W", "error::SyntaxWarning", "-c", "\n".join(script)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT / "src")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert all((tmp_path / name / "out/table/scene.xml").exists() for name in ("README", "python"))


PAGES = sorted(str(p.relative_to(ROOT)) for p in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])


@pytest.mark.parametrize("file", PAGES)
def test_links_lead_to_files_and_headings(file: str) -> None:
    for target, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", (ROOT / file).read_text()):
        page = (ROOT / file).parent / target if target else ROOT / file
        assert page.exists(), target
        assert not anchor or anchor in anchors(page), f"{target}#{anchor}"


def anchors(page: Path) -> set[str]:
    """Anchors that mkdocs gives to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", h).strip().lower()) for h in headings}


def test_every_page_is_in_the_navigation() -> None:
    named = set(re.findall(r": ([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(), flags=re.MULTILINE))
    assert named == {str(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md")}


def named_pages() -> list[tuple[str, str]]:
    """Pages of docs/ that sources and pages name, by path or as "docs: page"."""
    files = [*(ROOT / "src").rglob("*.py"), *(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "mkdocs.yml"]
    files += [*(ROOT / "benchmarks").rglob("*.py"), *(ROOT / "benchmarks").glob("*.md"), *(ROOT / "tests").glob("*.py")]
    found: list[tuple[str, str]] = []
    for file in files:
        text = file.read_text()
        names = [*re.findall(r"\bdocs/([\w/.-]+\.\w+)", text), *(f"{n}.md" for n in re.findall(r"\(docs: (\w+)", text))]
        names += re.findall(r"^ +- .*: ([\w/]+\.md)$", text, flags=re.MULTILINE) if file.suffix == ".yml" else []
        found += [(str(file.relative_to(ROOT)), name) for name in names]
    return found


def test_pages_that_are_named_exist() -> None:
    assert len(named_pages()) > 30
    assert [where for where in named_pages() if not (ROOT / "docs" / where[1]).exists()] == []
