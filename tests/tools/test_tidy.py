# SPDX-License-Identifier: Apache-2.0
"""A slip in a clang-tidy check name must not switch a group off in silence."""

from pathlib import Path

import pytest
import tidy

KNOWN = ["bugprone-use-after-move", "cppcoreguidelines-slicing", "readability-identifier-naming"]


def test_a_wrong_group_is_noticed() -> None:
    config = (
        "Checks: >\n  -*,\n  bugprone-*,\n  corecppguidelines-*,\n  -bugprone-use-after-mov\nWarningsAsErrors: '*'\n"
    )
    globs = tidy.globs_of(config)
    assert globs == ["bugprone-*", "corecppguidelines-*", "-bugprone-use-after-mov"]
    assert tidy.unknown_globs(globs, KNOWN) == ["corecppguidelines-*", "-bugprone-use-after-mov"]


def test_right_names_pass() -> None:
    assert tidy.unknown_globs(["bugprone-*", "-cppcoreguidelines-slicing"], KNOWN) == []


def test_the_real_configuration_is_read() -> None:
    globs = tidy.globs_of((Path(tidy.__file__).parent.parent / ".clang-tidy").read_text())
    assert "bugprone-*" in globs
    assert "readability-identifier-naming" in globs
    assert "-*" not in globs


def test_sources_that_are_read_in_one_step_are_all_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tidy, "ROOT", tmp_path)
    (tmp_path / ".clang-tidy").touch()
    product, test = tmp_path / "host/boot.cpp", tmp_path / "host/boot_test.cpp"
    product.parent.mkdir()
    product.write_text("int a;\n")
    test.write_text("int b;\n")
    unity = tmp_path / "build/clang/Unity/unity_0_cxx.cxx"
    unity.parent.mkdir(parents=True)
    unity.write_text(f'/* made */\n#include "{product}"\n\n#include "{test}"\n')
    assert tidy.members(unity) == [product, test]
    assert tidy.members(product) == [product]
    assert tidy.wanted(unity)
    before = tidy.digest(unity)
    product.write_text("int c;\n")
    assert tidy.digest(unity) != before


def test_tests_and_what_a_build_wrote_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tidy, "ROOT", tmp_path)
    unity = tmp_path / "build/clang/Unity/unity_0_cxx.cxx"
    unity.parent.mkdir(parents=True)
    unity.write_text(f'#include "{tmp_path}/host/boot_test.cpp"\n')
    assert not tidy.wanted(unity)
    assert not tidy.wanted(tmp_path / "build/clang/made.cpp")
    assert not tidy.wanted(tmp_path / "tests/fuzz/driver.cpp")
    assert tidy.wanted(tmp_path / "host/boot.cpp")
