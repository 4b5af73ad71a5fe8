# SPDX-License-Identifier: Apache-2.0
"""The soak: each invariant can fail, actions come from the seed alone, a soak goes on where it ended."""

import fcntl
import json
import os
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lithe._wire import Fault, JointStatus, Mode
from lithe.shm import dtype
from soak import __main__ as command
from soak import actions, machine, rig, run, watch
from soak.judge import INVARIANTS, STILL_S, Broken, Joints, Judge, codes_of_the_page

ROOT = Path(__file__).parents[3]
ONE = Joints(np.array([-1.0]), np.array([1.0]), np.array([0.6]), overrun_rad=0.2)


@pytest.fixture
def judge() -> Judge:
    return Judge(codes_of_the_page())


def moving(ticks: int = 10, **fields: Any) -> npt.NDArray[Any]:
    """Records of one joint that a law moves, at rest; with these fields."""
    made = np.zeros(ticks, dtype("Telemetry"))
    made["tick"], made["mode"] = np.arange(1, ticks + 1), Mode.active
    made["joint_status"][:, 0] = JointStatus.fresh
    for name, value in fields.items():
        if made[name].ndim == 2:
            made[name][:, 0] = value
        else:
            made[name] = value
    return made


def breaks(invariant: str, check: Callable[[], object]) -> str:
    """That the check breaks this invariant; why."""
    assert invariant in INVARIANTS
    with pytest.raises(Broken) as caught:
        check()
    assert caught.value.invariant == invariant
    return caught.value.why


def test_a_robot_that_does_what_it_must_breaks_nothing(judge: Judge) -> None:
    judge.records(moving(position_rad=1.05, command_torque_nm=-0.6), ONE, blind=False)
    assert judge.checked["inside"] == judge.checked["torque"] == 10
    assert judge.worst == pytest.approx({"torque_share": 1.0, "outside_rad": 0.05})
    judge.records(moving(0), ONE, blind=False)


def test_a_joint_that_a_law_moves_outside_is_seen(judge: Judge) -> None:
    assert "tick 1: joint 0 at 1.2500 rad" in breaks(
        "inside", lambda: judge.records(moving(position_rad=1.25), ONE, False)
    )
    breaks("inside", lambda: judge.records(moving(position_rad=-1.25, mode=Mode.hold), ONE, False))


@pytest.mark.parametrize(
    ("fields", "blind"),
    [
        ({"mode": Mode.disarmed}, False),
        ({"joint_rung": 1}, False),  # the safe law: the guard has stopped it
        ({"joint_status": 0}, False),  # an old sample
        ({"joint_status": JointStatus.fresh | JointStatus.conflict}, False),
        ({}, True),  # a fault on the bus: whose position is it?
    ],
)
def test_nobody_is_blamed_for_a_joint_that_no_law_moves_or_nobody_knows(
    judge: Judge, fields: dict[str, Any], blind: bool
) -> None:
    judge.records(moving(position_rad=1.25, **fields), ONE, blind)
    assert judge.checked["inside"] == 0 and "outside_rad" not in judge.worst


def test_the_guard_may_need_a_tick_to_see_it(judge: Judge) -> None:
    records = moving()
    records["position_rad"][4:6, 0] = 1.25
    judge.records(records, ONE, blind=False)
    assert judge.worst["outside_rad"] == pytest.approx(0.25)


@pytest.mark.parametrize("reads", [(1, 2), (2, 1), (1, 1, 1)])
def test_three_samples_outside_are_seen_across_reads(judge: Judge, reads: tuple[int, ...]) -> None:
    *before, last = np.split(moving(3, position_rad=1.25), np.cumsum(reads)[:-1])
    for each in before:
        judge.records(each, ONE, blind=False)
    assert "joint 0 at 1.2500 rad" in breaks("inside", lambda: judge.records(last, ONE, blind=False))


@pytest.mark.parametrize("read", [True, False])
def test_samples_with_a_lost_or_blind_one_between_them_are_not_in_a_row(judge: Judge, read: bool) -> None:
    records = moving(5, position_rad=1.25)
    judge.records(records[:2], ONE, blind=False)
    judge.records(records[2:3][:read], ONE, blind=True)
    judge.records(records[3:], ONE, blind=False)
    assert judge.checked["inside"] == 4


@pytest.mark.parametrize("torque_nm", [0.61, -0.61, np.nan, np.inf])
def test_a_torque_beyond_the_joints_or_no_number_is_seen_also_during_a_fault(judge: Judge, torque_nm: float) -> None:
    records = moving()
    records["command_torque_nm"][7, 0] = torque_nm
    assert "tick 8" in breaks("torque", lambda: judge.records(records, ONE, blind=True))


def test_stops_are_counted_once_for_each_time_a_fault_is_latched(judge: Judge) -> None:
    records = moving()
    records["fault"][3:6] = records["fault"][8:] = Fault.drive_lost
    judge.records(records, ONE, blind=False)
    judge.records(moving(fault=Fault.drive_lost), ONE, blind=False)
    assert judge.stops == {"drive_lost": 2}


def test_a_spine_that_is_gone_replaced_stuck_or_back_in_time_is_seen(judge: Judge) -> None:
    judge.alive(7, 7, 100, 0.0)
    judge.alive(7, 7, 100, STILL_S - 1)  # a busy machine
    judge.alive(7, 7, 101, STILL_S)
    assert "gone" in breaks("ticking", lambda: judge.alive(8, 7, 102, 40.0))
    assert "gone" in breaks("ticking", lambda: judge.alive(7, 7, 102, 40.0, is_alive=False))
    assert "stands at tick 101" in breaks("ticking", lambda: judge.alive(7, 7, 101, 2 * STILL_S + 1))
    assert "tick 99 after tick 101" in breaks("ticking", lambda: judge.alive(7, 7, 99, 41.0))


def test_a_spine_that_was_killed_on_purpose_may_count_anew(judge: Judge) -> None:
    judge.alive(7, 7, 100, 0.0)
    judge.alive(0, 0, 0, 1.0)
    judge.alive(8, 8, 1, 100.0)
    judge.alive(8, 8, 2, 100.1)
    assert judge.checked["ticking"] == 1, "the first look at each process compares nothing"


def test_a_code_that_is_on_no_page_is_seen(judge: Judge) -> None:
    for code in ("ok", "trial_failed", "refused_estop", "recover_failed", "drive_lost"):
        judge.answer("swap", code)
    assert "'no_such_code'" in breaks("answers", lambda: judge.answer("swap", "no_such_code"))
    assert "swap" not in judge.codes, "a verb is no code"


GOOD = {"request_id": 5, "law_id": 3, "commit_tick": 99, "source_sha256": "aa", "verdict": "confirmed"}


@pytest.mark.parametrize(
    ("code", "certificate"),
    [
        ("ok", {"verdict": "refused"}),
        ("ok", {"verdict": "not_confirmed"}),
        ("ok", {"law_id": 4}),
        ("ok", {"commit_tick": 98}),
        ("ok", {"source_sha256": "bb"}),
        ("trial_failed", {"verdict": "committed"}),
        ("timeout", {"verdict": "submitted"}),
    ],
)
def test_a_certificate_that_says_otherwise_than_the_answer_is_seen(
    judge: Judge, code: str, certificate: dict[str, Any]
) -> None:
    judge.verdict("ok", GOOD, GOOD)
    judge.verdict("trial_failed", GOOD, GOOD | {"verdict": "refused"})
    judge.verdict("timeout", GOOD, GOOD | {"verdict": "not_confirmed"})
    breaks("certificates", lambda: judge.verdict(code, GOOD, GOOD | certificate))


def test_a_law_in_force_without_a_commit_is_seen(judge: Judge) -> None:
    judge.in_force(3, GOOD, excused=False)
    judge.in_force(4, None, excused=True)
    breaks("refused_law", lambda: judge.in_force(4, None, excused=False))
    breaks("refused_law", lambda: judge.in_force(4, {"verdict": "refused"}, excused=True))


class Stuck:
    """A rig whose robot never leaves its safe stop; time passes fast."""

    def __init__(self) -> None:
        self.processes = {"brain": subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)}

    def status(self) -> dict[str, Any]:
        return {
            "mode": "safe_stop",
            "fault": "drive_lost",
            "law": "pd",
            "recovering": False,
            "alarms": [],
            "joints": [],
        }

    def ask(self, verb: str, **_: Any) -> tuple[str, Any]:
        return "ok", {}


def test_a_robot_without_a_way_back_is_seen(judge: Judge, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(actions, "BACK_S", 0.01)
    stuck = Stuck()
    stuck.out = tmp_path  # type: ignore[attr-defined]
    soak = actions.Soak(stuck, None, judge, False)  # type: ignore[arg-type]
    assert "'mode': 'safe_stop'" in breaks("way_back", soak.way_back)
    stuck.processes["brain"].communicate()


class StopsLate:
    """A rig whose robot stops when a new Brain is started, as often as `stops` says; verbs lead back."""

    def __init__(self, stops: int, out: Path) -> None:
        self.out = out
        self.processes: dict[str, subprocess.Popen[Any]] = {}
        self.stops, self.brains, self.mode = stops, 0, "active"

    def status(self) -> dict[str, Any]:
        return status(self.mode)

    def ask(self, verb: str, **_: Any) -> tuple[str, Any]:
        self.mode = {"reset": "disarmed", "arm": "active"}[verb]
        return "ok", {}

    def start_brain(self) -> str:
        self.brains += 1
        if self.brains > self.stops:
            return ""
        self.mode = "safe_stop"
        return "refused_not_ready"


@pytest.mark.parametrize("stops", [0, 1, 4])
def test_a_stop_before_the_new_brain_is_led_back(judge: Judge, tmp_path: Path, stops: int) -> None:
    rig = StopsLate(stops, tmp_path)
    soak = actions.Soak(rig, None, judge, False)  # type: ignore[arg-type]
    soak.way_back()
    assert (rig.mode, rig.brains) == ("active", stops + 1)
    assert soak.codes["set_reference refused_not_ready"] == stops


def test_a_robot_that_refuses_each_new_brain_is_seen(judge: Judge, tmp_path: Path) -> None:
    soak = actions.Soak(StopsLate(1000, tmp_path), None, judge, False)  # type: ignore[arg-type]
    assert "refused_not_ready" in breaks("way_back", soak.way_back)


def status(mode: str, fault: str = "none", rung: str = "law", recovering: bool = False) -> dict[str, Any]:
    return {"mode": mode, "fault": fault, "recovering": recovering, "joints": [{"rung": rung}]}


@pytest.mark.parametrize(
    ("where", "told", "verb"),
    [
        (status("active"), "", "done"),
        (status("active", "drive_lost"), "", "reset"),
        (status("active", rung="brake"), "", "reset"),
        (status("safe_stop", "position_limit"), "", "reset"),
        (status("estop"), "refused_estop", "reset"),
        (status("disarmed"), "ok", "arm"),
        (status("hold"), "", "arm"),
        (status("disarmed"), "refused_outside", "recover"),
        (status("recover", recovering=True), "ok", "wait"),
        (status("recover"), "", "arm"),
        (status("disarmed"), "refused_law", "swap"),
        (status("safe_stop", "law_faulted"), "refused_fault", "swap"),
        (status("disarmed", "law_faulted"), "refused_fault", "reset"),
    ],
)
def test_the_way_back_goes_by_verbs(where: dict[str, Any], told: str, verb: str) -> None:
    assert actions.next_verb(where, told) == verb


def test_what_must_hold_of_processes_can_fail(judge: Judge) -> None:
    judge.holds("processes", True, "")
    assert breaks("processes", lambda: judge.holds("processes", False, "not adopted")) == "not adopted"


def test_the_book_tells_certificates_of_this_spine_from_those_before(tmp_path: Path) -> None:
    def write(number: int, **fields: Any) -> None:
        (tmp_path / f"{number:04}.json").write_text(json.dumps({"request_id": 100 + number} | fields))

    write(1, law_id=1, verdict="committed")
    book = watch.Book(tmp_path)
    book.begin()
    assert book.of_law(1) is None, "law 1 of a Spine that has ended"
    write(2, law_id=1, verdict="refused")
    assert (book.of_law(1) or {})["verdict"] == "refused" and book.count == 2
    write(2, law_id=1, verdict="rolled_back")
    assert book.of_request(102)["verdict"] == "rolled_back" and book.of_request(7) == {}


def test_actions_come_from_the_seed_and_their_number_alone() -> None:
    names = [actions.drawn(7, number)[0] for number in range(actions.ROUND)]
    assert not set(names[actions.WITH_KILLS :]) & set(actions.KILLS), "what is judged for its growth lives long"
    assert names[500:510] == [actions.drawn(7, number)[0] for number in range(500, 510)]
    assert set(names) == set(actions.ACTIONS), "each of them comes"
    assert names[:50] != [actions.drawn(8, number)[0] for number in range(50)]
    assert actions.drawn(7, 3)[1].random() == actions.drawn(7, 3)[1].random()


def test_what_changes_the_whole_machine_needs_to_be_permitted(judge: Judge, tmp_path: Path) -> None:
    stuck = Stuck()
    stuck.out = tmp_path  # type: ignore[attr-defined]
    soak = actions.Soak(stuck, None, judge, whole_machine=False)  # type: ignore[arg-type]
    assert not actions.do(soak, "clock_step", Random(1))
    assert "--whole-machine" in soak.not_done["clock_step"]
    stuck.processes["brain"].communicate()


def test_the_clock_is_stepped_and_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    set_to: list[float] = []
    monkeypatch.setattr(time, "clock_settime", lambda _, value: set_to.append(value))
    before = time.time()
    machine.step_clock(3600, 0.01)
    assert set_to[0] == pytest.approx(before + 3600, abs=60) and set_to[1] == pytest.approx(before, abs=60)

    def refuses(*_: object) -> None:
        raise PermissionError(1, "not permitted")

    monkeypatch.setattr(time, "clock_settime", refuses)
    with pytest.raises(machine.NotHere, match="not permitted"):
        machine.step_clock(1, 0)


def test_a_core_comes_back_and_the_last_one_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "CPUS", tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    with pytest.raises(machine.NotHere, match="no core"):
        machine.unplug_core(Random(1), 0)
    (tmp_path / "cpu1").mkdir()
    (core := tmp_path / "cpu1/online").write_text("1\n")
    monkeypatch.setattr(machine, "time", SimpleNamespace(sleep=lambda _: core.write_text("seen " + core.read_text())))
    machine.unplug_core(Random(1), 1)
    assert core.read_text() == "1"


def test_loads_end_when_they_are_told_to(tmp_path: Path) -> None:
    load = machine.Load(tmp_path / "log")
    load.start(1, 1, 60)
    load.take_memory(0.0001, 60)
    started = list(load._running)
    assert len(started) == 3
    load.close()
    assert all(each.poll() is not None for each in started)


TERMINALS = """name = "arm"
law = "../laws/pd.cpp"
[spine]  # it ticks
release = "spin"  # exact
[[bus]]
name = "can0"
kind = "loop"  # in memory
[[bus]]
name = "can1"
kind = "loop"
data_bitrate = 0
[[device]]
watchdog_s = 0.2  # short
"""


def test_a_robot_file_gets_terminals_and_patience(tmp_path: Path) -> None:
    told = tomllib.loads(rig.at_terminals(TERMINALS, ROOT / "robots/x.toml", tmp_path))
    assert [bus["kind"] for bus in told["bus"]] == ["fdcanusb", "slcan"]
    assert told["bus"][1]["path"] == str(tmp_path / "can1")
    assert told["spine"] == {"release": "sleep", "late_ticks_to_stop": 1000}
    assert told["guard"]["lost_after_misses"] == 300 and told["device"][0]["watchdog_s"] == 2.0
    assert told["law"] == str(ROOT / "laws/pd.cpp")
    with pytest.raises(rig.LitheError, match="not simulated"):
        rig.at_terminals(TERMINALS.replace('"loop"', '"socketcan"'), ROOT / "robots/x.toml", tmp_path)


def test_a_soak_goes_on_with_the_next_action_and_all_that_it_has_counted(tmp_path: Path) -> None:
    state = run.State("robots/arm.toml", 7, 60.0, next=20, ran_s=12.5, checked={"inside": 9})
    state.write(tmp_path / "soak.state.json")
    resumed = command.state_of(command.arguments(["--out", str(tmp_path), "--resume"]))
    assert resumed == state
    assert command.state_of(command.arguments(["--out", str(tmp_path), "--resume", "--hours", "1"])).wanted_s == 3600
    assert command.state_of(command.arguments(["--out", str(tmp_path), "--seed", "3"])).next == 0


@pytest.mark.parametrize("content", [None, "{", '{"seed": 1}'])
def test_a_soak_that_cannot_run_says_so_with_exit_code_2(
    tmp_path: Path, content: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / "soak.state.json").write_text(content)
    assert command.main(["--out", str(tmp_path), "--resume"]) == 2
    assert "nothing to resume" in capsys.readouterr().err


def test_two_soaks_do_not_share_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with (tmp_path / "soak.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert command.main(["--out", str(tmp_path), "--resume"]) == 2
    assert "another one runs" in capsys.readouterr().err
