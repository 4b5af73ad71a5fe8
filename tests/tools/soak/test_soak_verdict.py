# SPDX-License-Identifier: Apache-2.0
"""What the soak says at its end, and what it must not take for a check that holds."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from soak import __main__ as command
from soak import actions, run
from soak.judge import INVARIANTS, Broken, Judge, codes_of_the_page, corpus_stage

ROOT = Path(__file__).parents[3]


def test_a_hostile_law_that_another_stage_refuses_is_seen_and_a_busy_machine_says_nothing_of_it() -> None:
    judge = Judge(codes_of_the_page())
    law = ROOT / "tests/laws_hostile/global_counter.cpp"
    for code in ("busy", "timeout", "compile_starved"):
        judge.must_be_refused(law.name, corpus_stage(law), code)
    assert judge.checked["refused_law"] == 0
    judge.must_be_refused(law.name, corpus_stage(law), "admission_failed")
    assert judge.checked["refused_law"] == 1
    for code, told in (("ok", "accepted"), ("trial_failed", "refused as trial_failed")):
        with pytest.raises(Broken, match=f"global_counter.cpp was {told}; admission must refuse it"):
            judge.must_be_refused(law.name, corpus_stage(law), code)


def test_a_swap_that_is_never_answered_breaks_the_soak(monkeypatch: pytest.MonkeyPatch) -> None:
    """Though the supervisor, whose connection it is, was not killed."""
    judge = Judge(codes_of_the_page())
    monkeypatch.setattr(actions, "InThread", lambda *_: SimpleNamespace(wait=lambda: ""))
    rig = SimpleNamespace(name="arm", status=lambda: {"lawd_pid": 0, "trial_pid": 0})
    random = SimpleNamespace(
        choice=lambda all: all[0], randrange=lambda _: 0, random=lambda: 0.0, uniform=lambda *_: 0.0
    )
    with pytest.raises(Broken, match="lawd was killed was never answered"):
        actions.helper_kill(SimpleNamespace(rig=rig, judge=judge), random)  # type: ignore[arg-type]


def test_what_was_never_checked_does_not_hold_and_is_named() -> None:
    state = run.State("robots/arm.toml", 7, 60.0, actions={"swap": 20}, checked={"inside": 9})
    told = run.one_line(run.report(state, None, interrupted=False))
    assert told.startswith("INCOMPLETE, held so far") and "not checked: torque, ticking" in told
    assert "20 actions" in told and "inside," not in told
    state.checked = dict.fromkeys(INVARIANTS, 1)
    assert run.report(state, None, interrupted=False)["verdict"] == "held"


@pytest.mark.parametrize(("checked", "code"), [(1, 0), (0, 1)])
def test_the_exit_code_of_a_soak_that_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, checked: int, code: int
) -> None:
    class Quiet:
        """A soak that saw nothing wrong."""

        watch = SimpleNamespace(broken=None)

        def __init__(self, state: run.State, *_: object) -> None:
            state.checked = dict.fromkeys(INVARIANTS, checked)

        def start(self) -> None: ...
        def go_on(self) -> None: ...
        def close(self) -> None: ...

    monkeypatch.setattr(command, "Run", Quiet)
    assert command.main(["--out", str(tmp_path), "--seed", "1"]) == code


def test_ctrl_c_hides_nothing_that_was_seen_before_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Interrupted:
        """A soak whose thread has seen something when Ctrl-C comes."""

        watch = SimpleNamespace(broken=Broken("ticking", "it stands"))

        def __init__(self, *_: object) -> None: ...
        def start(self) -> None: ...
        def close(self) -> None: ...
        def go_on(self) -> None:
            raise KeyboardInterrupt

    monkeypatch.setattr(command, "Run", Interrupted)
    assert command.main(["--out", str(tmp_path), "--seed", "1"]) == 1
    assert json.loads((tmp_path / "soak.json").read_text())["broken"]["why"] == "it stands"
