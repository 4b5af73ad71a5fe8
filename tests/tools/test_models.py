# SPDX-License-Identifier: Apache-2.0
"""The runner of the models fails whenever SPIN has not proved, or not refuted, what the model says it must."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from cpp_text import named_functions

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
    ("#ifdef TWIN_COUNT_TWICE", "#ifdef TWIN_COUNT_THRICE", "TWIN_COUNT_THRICE, TWIN_COUNT_TWICE"),
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


# A flag is passed by release and acquire. The model stands for this code.
CODE = """
template <class T>
class Flag {
 public:
  Flag() { word_.store(0, std::memory_order_relaxed); }
  // acquire, with memory_order_release in set().
  bool get() const { return word_.load(std::memory_order_acquire) != 0; }
  void set() { std::atomic_ref(word_).store(1, std::memory_order_release); }
};
"""
PASSING = """
//: code spine/ipc/flag.hpp Flag::Flag clear
//: code spine/ipc/flag.hpp Flag::get get
//: code spine/ipc/flag.hpp Flag::set set
//: model
//: twin SET_RELAXED  passed  the flag is stored without release
//: twin GET_RELAXED  passed  the flag is loaded without acquire
#define OBJECTS 2
#define MESSAGES 3
#define USES 1
#include "memory.inc"
bool passed;
byte flag, data;
inline clear() {
  store(0, 0, 0, relaxed)
}
inline get() {
  load(1, 0, ORDER(acquire, TWIN_GET_RELAXED), flag)
}
inline set() {
  store(0, 0, 1, ORDER(release, TWIN_SET_RELAXED))
}
active proctype Writer() {
  clear();
  store(0, 1, 1, relaxed);
  set()
}
active proctype Reader() {
  get();
  load(1, 1, relaxed, data);
  CLAIM(passed, data >= flag)
}
"""


@pytest.fixture
def check_passing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], int]:
    """Checks the model of a tree that has only that and the flag's code."""
    (tmp_path / "spine/ipc").mkdir(parents=True)
    (tmp_path / "memory.inc").write_text((models.ROOT / "models/memory.inc").read_text())
    monkeypatch.setattr(models, "ROOT", tmp_path)

    def run(code: str, model: str) -> int:
        (tmp_path / "spine/ipc/flag.hpp").write_text(code)
        (tmp_path / "flag.pml").write_text(model)
        return models.check([tmp_path / "flag.pml"], jobs=2)

    return run


def test_a_model_in_step_with_its_code_passes(
    check_passing: Callable[[str, str], int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert check_passing(CODE, PASSING) == 0
    assert "2 twins of 1 models" in capsys.readouterr().out


OUT_OF_STEP = [
    ("acquire) != 0", "relaxed) != 0", "get is 'load acquire', but Flag::get in spine/ipc/flag.hpp is 'load relaxed'"),
    ("std::memory_order_acquire", "", "get is 'load acquire', but Flag::get in spine/ipc/flag.hpp is 'load'"),
    (
        "  void set() {",
        "  void set() { std::atomic_thread_fence(std::memory_order_release);",
        "is 'fence release store release'",
    ),
    ("void set()", "void put()", "Flag::put in spine/ipc/flag.hpp has memory orders, but no line '//: code'"),
    (
        "ORDER(acquire, TWIN_GET_RELAXED), flag",
        "acquire, flag); load(1, 0, ORDER(relaxed, TWIN_GET_RELAXED), flag",
        "get: an order that nothing weakens",
    ),
    ("ORDER(release, TWIN_SET_RELAXED)", "ORDER(release, SPARE_SET)", "SPARE_SET, TWIN_SET_RELAXED"),
    ("//: model\n", "//: model -DSPARE_GET\n", "in the code or in the table only: SPARE_GET"),
]


@pytest.mark.parametrize("case", OUT_OF_STEP, ids=lambda case: case[-1])
def test_code_and_model_that_differ_fail(
    check_passing: Callable[[str, str], int], capsys: pytest.CaptureFixture[str], case: tuple[str, str, str]
) -> None:
    old, new, words = case
    assert old in CODE + PASSING
    assert check_passing(CODE.replace(old, new), PASSING.replace(old, new)) == 1
    assert words in capsys.readouterr().out


def test_some_model_weakens_every_order_of_a_shared_file() -> None:
    folder = models.ROOT / "models"
    asked = {flag for model in folder.glob("*.pml") for flag in models.asked_flags(model.read_text())}
    shared = {flag for file in folder.glob("*.inc") for flag in models.flags_of(file.read_text())}
    assert len(shared) >= 4
    assert shared <= asked


def orders_in(file: str) -> dict[str, str]:
    """Accesses and orders of each function. The copy of a payload is written where it is called."""
    functions: dict[str, str] = {}
    for name, body in named_functions((models.ROOT / file).read_text()):
        functions[name] = functions.get(name, "") + body
    for copy in ("copy_in", "copy_out"):
        if copy in functions:
            functions = {name: re.sub(rf"\b{copy}\([^;]*;", functions[copy], body) for name, body in functions.items()}
    return {name: " ".join(models.accesses(models.IN_CPP, body)) for name, body in functions.items()}


SAME_ORDERS = [
    ("read_record", "words", "Record::read"),
    ("write_record", "words", "Record::write"),
    ("lithe_channel_write", "channel", "ChannelWriter::write"),
    ("lithe_channel_read", "ring", "RingReader::latest"),  # asks `latest` only, as the Ring's asks `head`
    ("lithe_ring_head", "ring", "RingReader::next"),
    ("lithe_mailbox_send", "mailbox", "MailboxSender::send"),
    ("lithe_mailbox_poll", "mailbox", "MailboxSender::poll"),
]


@pytest.mark.parametrize("case", SAME_ORDERS, ids=lambda case: case[0])
def test_the_c_code_of_the_brain_has_the_orders_of_the_spine(case: tuple[str, str, str]) -> None:
    ours, file, theirs = case
    found = orders_in("brain/lithe/_shm/lithe_shm.c")[ours]
    assert found
    assert found == orders_in(f"spine/ipc/{file}.hpp")[theirs]
