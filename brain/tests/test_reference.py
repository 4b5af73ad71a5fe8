# SPDX-License-Identifier: Apache-2.0
"""The reference pages say all there is: every variable, every verb, every code, every name."""

import re
from collections.abc import Iterator
from pathlib import Path

import lithe
import pyref
import pytest
from lithe._wire import CommandResult, StageResult
from lithe.gateway import FIRST
from lithe.vocabulary import BY_NAME
from system.robot_rig import ROOT

REFERENCE = ROOT / "docs" / "reference"
ROOMS = ("spine", "supervisor", "lawd", "bench", "brain", "tools")
ENDINGS = {".cpp", ".hpp", ".py", ".c"}


def texts(*folders: str) -> Iterator[str]:
    """Sources, without the tests."""
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in ENDINGS and "test" not in path.name and "tests" not in path.relative_to(ROOT).parts:
                yield path.read_text(encoding="utf-8")


def found(pattern: str, *folders: str) -> set[str]:
    return {match for text in texts(*folders) for match in re.findall(pattern, text)}


def first_column(page: str) -> set[str]:
    """The names in the first column of a page's tables."""
    lines = (REFERENCE / page).read_text(encoding="utf-8").splitlines()
    return {name for line in lines if line.startswith("| `") for name in re.findall(r"`(\w+)`", line.split("|")[1])}


def test_every_environment_variable_is_on_its_page_and_no_other() -> None:
    read = found(r'(?:getenv|environment|environ\.get|environ)[(\[]"(LITHE_[A-Z_]+)"', *ROOMS)
    assert {"LITHE_RUN_DIR", "LITHE_CXX", "LITHE_BENCH_CORES", "LITHE_SHM_LIB"} <= read, "the search finds them"
    assert first_column("environment.md") == read


def test_every_verb_is_on_its_page() -> None:
    text = (ROOT / "supervisor/serve/verbs.cpp").read_text(encoding="utf-8")
    verbs = set(re.findall(r'verbs_\["(\w+)"\]', text))
    verbs |= set(re.findall(r'\{"(\w+)", wire::CommandKind::', text))
    gateway = (ROOT / "brain/lithe/gateway/__init__.py").read_text(encoding="utf-8")
    verbs |= set(re.findall(r'^ {12}"(\w+)": (?:self\.(?:_|records\.)\w+,|lambda )', gateway, re.M))
    assert {"swap", "arm", "estop", "history"} <= verbs, "the search finds them"
    assert verbs - first_column("verbs.md") == set()
    assert verbs == set(BY_NAME), "the gateway refuses what is not in its table"


def test_every_code_of_a_refusal_is_on_its_page() -> None:
    codes = found(r'Refusal\{\s*"(\w+)"', "supervisor")
    codes |= found(r'Refused\(\s*"(\w+)"', "brain/lithe") | found(r'_refusal\(\w+, "(\w+)"', "brain/lithe")
    codes |= {f"{stage}_failed" for stage in found(r'refuse(?:_whole)?\("(\w+)"', "lawd")}
    codes |= {each.name for each in CommandResult if each.name.startswith("refused_")}
    codes |= {each.name for each in StageResult} - {"pending", "staged"}
    assert {"compile_failed", "hostile", "refused_unknown", "usage", "busy"} <= codes, "the search finds them"
    assert codes - first_column("verbs.md") == set()


def test_the_python_page_is_what_the_docstrings_say(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert pyref.main(["--check"]) == 0
    page = pyref.page()
    assert [name for name in lithe.__all__ if f"lithe.{name}" not in page and f"## `{name}`" not in page] == []
    monkeypatch.setattr(pyref, "PAGE", tmp_path / "python.md")
    assert pyref.main(["--check"]) == 1
    assert pyref.main(["--write"]) == 0 and pyref.main(["--check"]) == 0
    assert pyref.main([]) == 2


def test_a_public_name_without_words_is_not_let_through(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lithe.Robot, "dance", lambda self: None, raising=False)
    with pytest.raises(pyref.Undocumented, match=r"Robot\.dance"):
        pyref.page()


def test_the_verbs_that_come_first_are_those_of_the_page() -> None:
    text = (ROOT / "docs/reference/verbs.md").read_text()
    told = re.search(r"verbs that move or stop the robot\s+\(`([a-z_ ]+)`\)", text)
    assert told is not None
    assert {*told[1].split(), "estop"} == set(FIRST)
    assert {"recover", "set_params"} <= set(FIRST), "both can move the robot"
