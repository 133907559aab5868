"""The page of durations, from a run made by hand."""

from __future__ import annotations

from pathlib import Path

import durations

RUN = """<testsuites><testsuite time="90">
<testcase classname="tests.test_a" name="test_quick" time="9"><properties>
<property name="processor_s" value="0.25"/></properties></testcase>
<testcase classname="tests.test_a" name="test_slow[1|2]" time="9"><properties>
<property name="other" value="7"/><property name="processor_s" value="1.5"/></properties></testcase>
<testcase classname="benchmarks.tests.test_b" name="test_slower" time="2"><properties>
<property name="processor_s" value="3"/></properties></testcase>
<testcase classname="benchmarks.tests.test_b" name="test_slowest" time="2"><properties>
<property name="processor_s" value="9"/><property name="slow" value="yes"/></properties></testcase>
</testsuite></testsuites>"""


def test_files_are_summed_and_tests_are_sorted(tmp_path: Path) -> None:
    (tmp_path / "run.xml").write_text(RUN)
    page = durations.page(tmp_path / "run.xml")
    assert "4 tests in 1.5 minutes, 14 s of processor time.\nOf these 1 with 9 s are slow" in page
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| `")]
    files, tests = rows[:2], rows[2:]
    assert files == [["`benchmarks/tests/test_b.py`", "12.0"], ["`tests/test_a.py`", "1.8"]]
    assert [time for _, time in tests] == ["9.0", "3.0", "1.5", "0.2"] and tests[2][0] == "`test_a::test_slow[1 2]`"
    assert [name for name, _ in tests if name.endswith(", to be marked")] == ["`test_b::test_slower`, to be marked"]
