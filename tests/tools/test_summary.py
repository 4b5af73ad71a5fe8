# SPDX-License-Identifier: Apache-2.0
"""The last line of `make test` says what each runner counted, also what failed."""

from pathlib import Path

import pytest
import summary

CTEST = '<testsuite name="x" tests="12" failures="1" disabled="0" skipped="2"><testcase name="a"/></testsuite>'
PYTEST = (
    '<testsuites><testsuite errors="1" failures="2" skipped="3" tests="10">'
    '<testcase name="b"><skipped message="INCONCLUSIVE: the core was away"/></testcase></testsuite></testsuites>'
)


def test_both_kinds_of_files_are_read_and_a_missing_one_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ctest.xml").write_text(CTEST)
    (tmp_path / "pytest.xml").write_text(PYTEST)
    names = [str(tmp_path / f"{name}.xml") for name in ("ctest", "pytest", "again")]
    monkeypatch.setattr("sys.argv", ["summary.py", *names])
    assert summary.main() == 0
    assert capsys.readouterr().out == (
        "test: ctest 9 passed, 1 failed, 2 skipped · pytest 4 passed, 3 failed, 2 skipped, 1 inconclusive\n"
    )
