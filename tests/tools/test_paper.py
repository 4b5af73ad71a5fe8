# SPDX-License-Identifier: Apache-2.0
"""docs/paper.md and the numbers of docs/rt.md name what exists, and a page that does not is found."""

from pathlib import Path

import paper
import pytest
from paper import ROOT

TEXT = (ROOT / paper.PAGE).read_text(encoding="utf-8")


def test_every_claim_says_where_it_stands_and_what_shows_it() -> None:
    assert paper.troubles(TEXT, ROOT) == []


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("| a | yes | | `make nothing` |", "no target 'nothing'"),
        ("| a | yes | | `lithe fly` |", "no verb 'fly'"),
        ("| a | yes | | `pytest tests/system/test_nothing.py` |", "there is no file tests/system/test_nothing.py"),
        ("| a | yes | | `spine/nothing.cpp` |", "there is no file spine/nothing.cpp"),
        ("| a | yes | | `python -m tools.nothing` |", "no module tools.nothing"),
        ("| a | yes | | ask somebody |", "neither a command nor a file"),
        ("| a | surely | | `LICENSE` |", "'surely'; say one of yes, more, partly, no"),
        ("| a | yes | `LICENSE` |", "3 columns"),
        ("| a | yes | ![x](img/nothing.svg) | `LICENSE` |", "docs/img/nothing.svg"),
    ],
)
def test_a_page_that_promises_what_is_not_there_is_found(row: str, words: str) -> None:
    wrong = paper.troubles(TEXT + row + "\n", ROOT)
    assert len(wrong) == 1 and words in wrong[0], wrong


def test_a_page_that_drops_claims_is_found() -> None:
    assert "50 or more" in paper.troubles("\n".join(TEXT.splitlines()[:40]), ROOT)[-1]


NUMBERS = (ROOT / paper.NUMBERS).read_text(encoding="utf-8")


def test_every_number_names_its_command_or_its_day() -> None:
    assert paper.number_troubles(NUMBERS, ROOT) == []
    assert "python -m bench.host" in NUMBERS


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("| 2 us | none yet: by hand |", "name a command"),
        ("| 2 us | measured once |", "name a command"),
        ("| 2 us | `cyclictest` |", "name a command"),
        ("| 2 us | `make benches` |", "no target 'benches'"),
        ("| 2 us | `python -m bench.hosts` |", "no module bench.hosts"),
    ],
)
def test_a_number_that_nobody_can_measure_is_found(row: str, words: str) -> None:
    wrong = paper.number_troubles(f"{NUMBERS}{row}\n", ROOT)
    assert len(wrong) == 1 and words in wrong[0], wrong


def test_a_page_without_the_table_is_found() -> None:
    assert len(paper.number_troubles("# Real time\n", ROOT)) == 1


def test_a_path_that_a_page_names_and_the_tree_lacks_is_found(tmp_path: Path) -> None:
    (tmp_path / "spine/loop").mkdir(parents=True)
    (tmp_path / "spine/loop/tick.cpp").write_text("")
    page = Path("ARCHITECTURE.md")
    there = "`spine/loop/tick.cpp`, `spine/loop/`, `spine/*/tick.cpp`, `out/x`"
    assert paper.path_troubles(page, there, tmp_path) == []
    wrong = paper.path_troubles(page, "one\n`spine/loop/tock.cpp`\n", tmp_path)
    assert wrong == ["ARCHITECTURE.md:2: there is no spine/loop/tock.cpp; name what is there, or leave it out"]
    assert ROOT / page in paper.pages(ROOT) and ROOT / "docs/swap.md" in paper.pages(ROOT)
