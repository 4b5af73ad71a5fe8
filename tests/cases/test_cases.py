# SPDX-License-Identifier: Apache-2.0
"""The table of cases names tests that exist, and lines that the product has; each of the main kinds has a twin."""

import re

from cases.run import ROOT, table

SOURCES = [
    path for room in ("spine", "supervisor", "lawd", "trial", "host", "tests") for path in (ROOT / room).rglob("*.cpp")
]
TWINS = {
    "answers as events",
    "adoption",
    "folders of others",
    "trial and probation with one measure",
    "actions as a torque",
    "reasons that do not travel",
    "exit codes that lie",
    "start-up checks that circle",
}


def test_every_test_of_the_table_exists() -> None:
    texts = "\n".join(path.read_text() for path in SOURCES)
    have = {f"{suite}.{name}" for suite, name in re.findall(r"^TEST(?:_F|_P)?\((\w+),\s*(\w+)", texts, re.MULTILINE)}
    assert len(have) > 1000
    for case in table():
        assert case["tests"], case["says"]
        for name in case["tests"]:
            file, _, function = name.partition("::")
            if ".py" not in name:
                assert name in have, name
            else:
                assert f"def {function}" in (ROOT / file).read_text(), name


def test_every_twin_is_one_line_of_the_product_and_every_kind_has_one() -> None:
    for case in table():
        if twin := case.get("twin"):
            assert (ROOT / twin["file"]).read_text().count(twin["was"]) == 1, case["says"]
            assert twin["was"] != twin["becomes"]
    assert {case["kind"] for case in table() if "twin" in case} >= TWINS
