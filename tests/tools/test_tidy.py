# SPDX-License-Identifier: Apache-2.0
"""A slip in a clang-tidy check name must not switch a group off in silence."""

from pathlib import Path

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
