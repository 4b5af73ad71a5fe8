# SPDX-License-Identifier: Apache-2.0
"""The runner of the models fails whenever SPIN has not proved, or not refuted, what the model says it must."""

from pathlib import Path

import pytest

import models

# Two processes count; a claim says that no count is lost, another that there are two at most.
COUNTING = """
//: model
//: twin LOAD_THEN_STORE  sum   the two count without excluding each other
//: twin COUNT_TWICE      most  one of them counts twice
byte counted, ended;
bool sum, most;
#define CLAIM(name, holds) assert(name || (holds))
active [2] proctype Count() {
  byte seen;
#ifdef TWIN_LOAD_THEN_STORE
  seen = counted;
  counted = seen + 1;
#else
  atomic { seen = counted; counted = seen + 1 }
#endif
#ifdef TWIN_COUNT_TWICE
  if
  :: _pid == 0 -> counted++
  :: else
  fi;
#endif
  d_step {
    CLAIM(most, counted <= 2);
    ended++;
    CLAIM(sum, ended < 2 || counted == 2)
  }
}
"""


def check(tmp_path: Path, text: str) -> int:
    model = tmp_path / "counting.pml"
    model.write_text(text)
    return models.check([model], jobs=2)


def changed(old: str, new: str) -> str:
    assert old in COUNTING
    return COUNTING.replace(old, new)


def test_a_model_that_holds_and_whose_twins_are_refuted_passes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert check(tmp_path, COUNTING) == 0
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == 4
    assert printed[-1].startswith("models: 1 searches and 2 twins of 1 models")
    assert "0 failed" in printed[-1]


REFUSED = [
    ("seen = counted; counted = seen + 1 }", "seen = counted; counted = seen }", "the claim 'sum' does not hold"),
    ("  seen = counted;\n  counted = seen + 1;\n", "  atomic { counted++ };\n", "LOAD_THEN_STORE", "is not refuted"),
    ("COUNT_TWICE      most ", "COUNT_TWICE      sum  ", "is broken in 'most', not in 'sum'"),
    ("  d_step {", "  counted < 3;\n  d_step {", "is broken in 'endstate'"),
    ("active [2]", "actve [2]", "spin failed"),
    ("byte seen;", "byte seen;\n  if\n  :: counted == 9 -> counted = 0\n  :: else\n  fi;", "never reached: "),
    ("//: model\n", "", "no line '//: model'"),
    ("//: twin COUNT_TWICE", "// twin COUNT_TWICE", "1 twins, 2 at least"),
    ("#ifdef TWIN_COUNT_TWICE", "#ifdef TWIN_COUNT_THRICE", "COUNT_THRICE, COUNT_TWICE"),
    ("byte counted", "/* stands for spine/law/gone.hpp */ byte counted", "files that are gone: spine/law/gone.hpp"),
]


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case[-1])
def test_what_is_not_proved_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: tuple[str, ...]) -> None:
    assert check(tmp_path, changed(case[0], case[1])) == 1
    printed = capsys.readouterr().out
    assert all(words in printed for words in case[2:]), printed


def test_a_search_that_is_cut_short_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(models, "DEPTH", 4)
    assert check(tmp_path, COUNTING) == 1
    assert "not every state was seen: max search depth too small" in capsys.readouterr().out


def test_a_search_that_runs_out_of_memory_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(models, "MEMORY_MB", 1)
    assert check(tmp_path, COUNTING) == 1
    assert "ok   counting  model " not in capsys.readouterr().out


def test_the_way_to_a_broken_claim_can_be_shown(tmp_path: Path) -> None:
    model = tmp_path / "counting.pml"
    model.write_text(COUNTING)
    twin = next(run for run in models.runs_of(model) if run.claim == "most")
    shown = models.trace(twin)
    assert "counted = (counted+1)" in shown
    assert "text of failed assertion: assert((most||(counted<=2)))" in shown


def test_every_model_of_the_tree_can_be_run() -> None:
    found = sorted((models.ROOT / "models").glob("*.pml"))
    assert len(found) >= 3
    for model in found:
        assert len(list(models.runs_of(model))) >= 3
