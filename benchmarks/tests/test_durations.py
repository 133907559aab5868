"""The page of durations, from a run made by hand."""

from __future__ import annotations

from pathlib import Path

import durations

RUN = """<testsuites><testsuite time="90">
<testcase classname="tests.test_a" name="test_quick" time="0.25"/>
<testcase classname="tests.test_a" name="test_slow[1|2]" time="1.5"/>
<testcase classname="benchmarks.tests.test_b" name="test_slower" time="2"/>
</testsuite></testsuites>"""


def test_files_are_summed_and_tests_are_sorted(tmp_path: Path) -> None:
    (tmp_path / "run.xml").write_text(RUN)
    page = durations.page(tmp_path / "run.xml")
    assert "3 tests in 1.5 minutes." in page
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| `")]
    files, tests = rows[:2], rows[2:]
    assert files == [["`benchmarks/tests/test_b.py`", "2.0"], ["`tests/test_a.py`", "1.8"]]
    assert [time for _, time in tests] == ["2.0", "1.5", "0.2"] and tests[1][0] == "`test_a::test_slow[1 2]`"
