# SPDX-License-Identifier: Apache-2.0
"""What the soak says at its end, and what it must not take for a check that holds."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from lithe.errors import Refused
from soak import __main__ as command
from soak import actions, run
from soak.judge import INVARIANTS, Broken, Judge, codes_of_the_page, corpus_stage

ROOT = Path(__file__).parents[3]
RANDOM: Any = SimpleNamespace(
    choice=lambda all: all[0], randrange=lambda _: 0, random=lambda: 0.0, uniform=lambda *_: 0.0
)


def lived(seconds: int = 1200, per_hour: float = 0.0, names: tuple[str, ...] = ("spine", "supervisor")) -> Any:
    """Samples of the memory of processes that lived so long, and grew so fast [kB]."""
    samples = [[1, t_s, 20_000 + per_hour * t_s / 3600] for t_s in range(0, seconds, 5)]
    return {f"{name}_rss_kb": samples for name in names}


def whole(**more: Any) -> run.State:
    """What a soak has come to in which each invariant was checked."""
    return run.State("robots/arm.toml", 7, 60.0, next=20, actions={"swap": 20}, checked=dict.fromkeys(INVARIANTS, 1),
                     **({"series": lived()} | more))  # fmt: skip


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
    monkeypatch.setattr(actions, "InThread", lambda *_: SimpleNamespace(wait=lambda: ("", {})))
    rig = SimpleNamespace(name="arm", status=lambda: {"lawd_pid": 0, "trial_pid": 0})
    with pytest.raises(Broken, match="lawd was killed was never answered"):
        actions.helper_kill(SimpleNamespace(rig=rig, judge=judge), RANDOM)  # type: ignore[arg-type]


def refuses() -> dict[str, Any]:
    """A supervisor whose compiler was killed."""
    raise Refused("compile_failed", "it ended", detail={"swap": {"request_id": 5}})


@pytest.mark.parametrize(
    ("answer", "code", "told"),
    [(lambda: {"request_id": 5}, "ok", {"request_id": 5}), (refuses, "compile_failed", {"swap": {"request_id": 5}})],
)
def test_the_answer_to_a_swap_whose_helper_was_killed_is_compared_with_its_certificate(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, answer: Callable[[], Any], code: str, told: dict[str, Any]
) -> None:
    client = SimpleNamespace(call=lambda *_: answer(), close=lambda: None)
    monkeypatch.setattr(actions, "connect_control", lambda *_: client)
    pids = iter([0, 9])
    rig = SimpleNamespace(name="arm", out=tmp_path, status=lambda: {"lawd_pid": next(pids)})
    compared: list[Any] = []
    watch = SimpleNamespace(swap_answered=lambda *both: compared.append(both))
    soak = actions.Soak(rig, watch, Judge(codes_of_the_page()), False)  # type: ignore[arg-type]
    actions.helper_kill(soak, RANDOM)
    ((seen, answered),) = compared
    assert seen == code and answered | told == answered and ("source_sha256" in answered) == (code == "ok")


def test_a_broken_soak_names_invariant_action_seed_and_how_to_repeat_it() -> None:
    state = whole()
    told = run.report(state, Broken("ticking", "it stands"), interrupted=False)
    line = run.one_line(told)
    assert told["verdict"] == "broken"
    assert line.startswith(f"BROKEN at action 20 ({actions.drawn(7, 20)[0]}), seed 7: ticking: it stands\n")
    assert "--robot robots/arm.toml --seed 7 --seconds 36000 --first 12 --last 20 (or all: --first 0)" in line
    assert "--seconds 36000 --whole-machine --first 12" in run.repeat(whole(whole_machine=True))
    assert run.one_line(run.report(state, None, interrupted=True)).startswith("held so far")
    assert run.one_line(run.report(state, None, interrupted=False)).startswith("held: 20 actions")
    state.series = lived(per_hour=30_000)
    assert run.report(state, None, interrupted=False)["broken"]["invariant"] == "growth"


@pytest.mark.parametrize(
    ("series", "who"),
    [
        ({}, "the Spine and the supervisor"),
        (lived(names=("spine",)), "the supervisor"),
        (lived(600), "the supervisor"),  # its log of events fills
    ],
)
def test_growth_is_checked_only_when_the_memory_of_spine_and_supervisor_was_judged(series: Any, who: str) -> None:
    told = run.report(whole(series=series), None, interrupted=False)
    assert told["verdict"] == "incomplete" and told["invariants"]["growth"]["checked"] == 0
    assert run.one_line(told).endswith(f"; not checked: growth (the memory of {who}: no process lived long enough)")


def test_what_was_never_checked_does_not_hold_and_is_named() -> None:
    state = run.State("robots/arm.toml", 7, 60.0, actions={"swap": 20}, checked={"inside": 9})
    told = run.one_line(run.report(state, None, interrupted=False))
    assert told.startswith("INCOMPLETE, held so far") and "not checked: torque, ticking" in told
    assert "20 actions" in told and "inside," not in told
    assert run.report(whole(), None, interrupted=False)["verdict"] == "held"


@pytest.mark.parametrize(("checked", "code"), [(1, 0), (0, 1)])
def test_the_exit_code_of_a_soak_that_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, checked: int, code: int
) -> None:
    class Quiet:
        """A soak that saw nothing wrong."""

        watch = SimpleNamespace(broken=None)

        def __init__(self, state: run.State, *_: object) -> None:
            state.checked, state.series = dict.fromkeys(INVARIANTS, checked), lived()

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


def test_a_resumed_soak_tells_what_broke_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class BreaksOnce:
        """A soak that breaks when it is new, and holds when it is resumed."""

        watch = SimpleNamespace(broken=None)

        def __init__(self, state: run.State, *_: object) -> None:
            self.new = state.next == 0
            state.checked, state.series, state.next = dict.fromkeys(INVARIANTS, 1), lived(), 4

        def start(self) -> None: ...
        def close(self) -> None: ...
        def go_on(self) -> None:
            if self.new:
                raise Broken("ticking", "it stands")

    monkeypatch.setattr(command, "Run", BreaksOnce)
    assert command.main(["--out", str(tmp_path), "--seed", "1", "--whole-machine"]) == 1
    assert "broke before" not in capsys.readouterr().out
    assert command.main(["--out", str(tmp_path), "--resume"]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert line.startswith("held: ") and line.endswith("; broke before at action 4: ticking: it stands; resumed")
    told = json.loads((tmp_path / "soak.json").read_text())
    assert told["broke_before"] == [{"action": 4, "invariant": "ticking", "why": "it stands"}]
    assert told["whole_machine"], "--resume goes on with the same actions"
