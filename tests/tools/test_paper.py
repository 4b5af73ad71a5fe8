# SPDX-License-Identifier: Apache-2.0
"""docs/paper.md and the numbers of docs/rt.md name what exists, and a page that does not is found."""

import re
import subprocess
from pathlib import Path

import paper
import pytest
from paper import ROOT

TEXT = (ROOT / paper.PAGE).read_text(encoding="utf-8")


def test_every_claim_says_where_it_stands_and_what_shows_it() -> None:
    assert paper.troubles(TEXT, ROOT) == []


@pytest.mark.parametrize(
    ("shown_by", "words"),
    [
        ("`make nothing`", "no target 'nothing'"),
        ("`make`", "`make` alone shows nothing"),
        ("`make bench-isolation QUICK=1`", "the Makefile does not read QUICK"),
        ("`make test`", "runs everything: name the room or the test"),
        ("`make test ROOM=cellar`", "there is no room cellar"),
        ("`make test-arm64`", "runs everything"),
        ("`ctest --preset release -R Ring.WhatNobodyTests`", "no C++ test is called Ring.WhatNobodyTests"),
        ("`ctest --preset release -R 'Ring.SlowReader\\|Ring.Nothing'`", "no C++ test is called Ring.Nothing"),
        ("`ctest --preset slow -R Ring`", "no test preset 'slow'"),
        ("`ctest --preset release`", "`ctest` without -R names no test"),
        ("`build/release/bin/ipc_tests --gtest_filter=Ring.Nothing*`", "ipc_tests has no test Ring.Nothing*"),
        ("`build/release/bin/ipc_tests --gtest_filter=Slot.*`", "ipc_tests has no test Slot.*"),
        ("`build/release/bin/cellar_tests --gtest_filter=Ring.*`", "no room makes the program cellar_tests"),
        ("`build/release/bin/ipc_tests`", "without --gtest_filter names no test"),
        ("`pytest tests/system/test_nothing.py`", "there is no file tests/system/test_nothing.py"),
        (
            "`pytest tests/system/cli/test_cli.py::test_nothing`",
            "tests/system/cli/test_cli.py has no test test_nothing",
        ),
        ("`pytest tests/system/robot_rig.py`", "tests/system/robot_rig.py has no test"),
        ("`pytest tests/system`", "there is no file tests/system"),
        ("`python -m tools.nothing`", "no module tools.nothing"),
        ("`python -m bench.isolation --nothing`", "bench.isolation knows no --nothing"),
        ("`python -m bench.report cellar`", "bench.report knows no cellar"),
        ("`python tools/nothing.py`", "there is no file tools/nothing.py"),
        ("`lithe fly`", "no verb 'fly'"),
        ("`lithe law fly`", "`lithe law` has no verb 'fly'"),
        ("`lithe param`", "`lithe param` has no verb ''"),
        ("`lithe status --fast`", "`lithe status` has no option --fast"),
        ("`lithe bus plan robots/nobody.toml`", "there is no file robots/nobody.toml"),
        ("`spine/nothing.cpp`", "there is no file spine/nothing.cpp"),
        ("`spine/ipc/channel.hpp`", "is a file, which shows nothing: name a command"),
        ("`make demo`, `docs/swap.md`", "docs/swap.md is a file, which shows nothing"),
        ("ask somebody", "neither a command nor a file"),
    ],
)
def test_a_command_that_shows_nothing_is_found(shown_by: str, words: str) -> None:
    wrong = paper.troubles(f"{TEXT}| a | yes | | {shown_by} |\n", ROOT)
    assert len(wrong) == 1 and words in wrong[0], wrong


@pytest.mark.parametrize(
    "shown_by",
    [
        "`make test ROOM=guard`",
        "`make test ROOM=hal_bus_slcan`",
        "`make bench-isolation SHORT=1 PAPER=1`",
        "`ctest --preset release -R '^Ring[.]SlowReaderLearnsHowMuchItLost$'`",
        "`ctest --preset release -R Determinism.TwoRunsAndAReplayGiveTheSameBits`",  # a TEST_P
        "`build/release/bin/ipc_tests --gtest_filter=Ring.*:Channel.ReaderGivesUp*`",
        "`build/release/bin/step_tests --gtest_filter=*/Determinism.*`",
        "`build/release/bin/limits_limits --gtest_filter=LimitsTwin.*`",
        "`pytest tests/system/laws/test_hostile_contained.py::test_what_the_law_does_is_contained[hangs_delayed]`",
        "`python tools/check.py models`",
        "`LICENSE`, `python tools/check.py lint`",
        "`lithe doctor`, `make demo`",
    ],
)
def test_a_command_that_fails_without_the_claim_shows_it(shown_by: str) -> None:
    assert paper.troubles(f"{TEXT}| a | yes | | {shown_by} |\n", ROOT) == []


@pytest.mark.parametrize(
    "shown_by",
    [
        "`lithe --json --robot arm status`",
        "`lithe tune shield -- make bench`",
        "`lithe sim robots/arm.toml --truth`",
        "`python -m bench.isolation --workload stress`",
        "`python -m bench.report run`",
        "`LICENSE`",
        "`docs/img/architecture.svg`",
    ],
)
def test_what_only_prints_or_measures_does_not_show_a_claim(shown_by: str) -> None:
    for stands in ("yes", "more"):
        (wrong,) = paper.troubles(f"{TEXT}| a | {stands} | | {shown_by} |\n", ROOT)
        assert "none of its commands fails" in wrong
    assert paper.troubles(f"{TEXT}| a | partly | | {shown_by} |\n", ROOT) == []


def test_the_pictures_name_what_there_is() -> None:
    """Files, and the laws in the list of the first picture."""
    for name in ("brain_spine_tasks", "architecture"):
        text = (ROOT / f"docs/img/{name}.svg").read_text(encoding="utf-8")
        shown = [word for line in re.findall(r">([^<>]+)<", text) for word in line.split()]
        files = [word for word in shown if re.fullmatch(r"[\w/]+\.(toml|cpp|py|hpp)", word)]
        assert all(any(ROOT.glob(file) if "/" in file else ROOT.rglob(file)) for file in files), files
    words = re.findall(r">([^<>]+)</text>", (ROOT / "docs/img/brain_spine_tasks.svg").read_text(encoding="utf-8"))
    laws = words[words.index("control law, one of") + 1 : words.index("...")]
    assert len(laws) >= 5 and all((ROOT / f"laws/{law}.cpp").is_file() for law in laws), laws
    assert sum(word.startswith("robots/") for word in words) >= 4


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("| a | surely | | `LICENSE` |", "'surely'; say one of yes, more, partly, no"),
        ("| a | yes | `LICENSE` |", "3 columns"),
        ("| a | partly | | `LICENSE`, `README.md` |", "README.md is a file"),
    ],
)
def test_a_row_that_is_not_whole_is_found(row: str, words: str) -> None:
    wrong = paper.troubles(f"{TEXT}{row}\n", ROOT)
    assert len(wrong) == 1 and words in wrong[0], wrong


def test_what_is_not_done_needs_no_command_but_no_wrong_one_either() -> None:
    assert paper.troubles(f"{TEXT}| a | no | | |\n| b | no | | `README.md` |\n", ROOT) == []
    assert "no file READMYOU.md" in paper.troubles(f"{TEXT}| a | no | | `READMYOU.md` |\n", ROOT)[0]


def test_a_page_that_drops_claims_is_found() -> None:
    assert f"{paper.LEAST_ROWS} or more" in paper.troubles("\n".join(TEXT.splitlines()[:40]), ROOT)[-1]


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
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    page = Path("ARCHITECTURE.md")
    there = "`spine/loop/tick.cpp`, `spine/loop/`, `spine/*/tick.cpp`, `out/x`"
    assert paper.path_troubles(page, there, tmp_path) == []
    wrong = paper.path_troubles(page, "one\n`spine/loop/tock.cpp`\n", tmp_path)
    assert wrong == ["ARCHITECTURE.md:2: there is no spine/loop/tock.cpp; name what is there, or leave it out"]
    assert paper.path_troubles(page, "read tick.cpp, spine/loop/tick.cpp\n\n    tock.cpp\n", tmp_path) == []
    assert "no tock.cpp" in paper.path_troubles(page, "the clock (tick.cpp, tock.cpp)\n", tmp_path)[0]
    assert ROOT / page in paper.pages(ROOT) and ROOT / "docs/swap.md" in paper.pages(ROOT)


def test_a_lithe_command_that_a_page_names_and_the_program_lacks_is_found() -> None:
    page = Path("docs/laws.md")
    good = "`lithe law`, `lithe run FILE --no-arm`\n\n    build/release/bin/lithe swap my.cpp --param kp=1  # --none\n"
    assert paper.cli_troubles(page, good, ROOT) == []
    bad = "one\n`lithe law chek x.cpp`\n\n    sudo lithe run x.toml --shielded\n```\nlithe dance\n```\n"
    assert paper.cli_troubles(page, bad, ROOT) == [
        "docs/laws.md:2: `lithe law` has no verb 'chek'",
        "docs/laws.md:4: `lithe run` has no option --shielded",
        "docs/laws.md:6: `lithe` has no verb 'dance'",
    ]


@pytest.mark.parametrize("path", ["`keys/moteus_key.cpp`", "`core/acts.hpp`", "`cia402_reports.cpp`", "`robos/`"])
def test_a_name_without_its_folders_that_no_file_has_is_found(path: str) -> None:
    there = "`keys/moteus_keys.cpp`, `core/act.hpp`, `cia402_report.cpp`, `robots/`, `KIND/sim/`, `x.hpp`, `out/demo/`"
    assert paper.path_troubles(Path("ARCHITECTURE.md"), there, ROOT) == []
    assert len(paper.path_troubles(Path("ARCHITECTURE.md"), path, ROOT)) == 1


STATED = paper.stated(ROOT)


@pytest.mark.parametrize(("page", "pattern", "counted", "slack"), STATED)
def test_a_number_of_a_page_that_is_not_what_is_counted_is_found(
    page: str, pattern: str, counted: int, slack: float
) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    assert paper.stated_troubles(page, text, [(page, pattern, counted, slack)]) == []
    wrong = paper.stated_troubles(page, text, [(page, pattern, round(counted * 1.2) + 1, slack)])
    assert len(wrong) == 1 and "are counted" in wrong[0], wrong
    assert "does not state" in paper.stated_troubles(page, "", [(page, pattern, counted, slack)])[0]
