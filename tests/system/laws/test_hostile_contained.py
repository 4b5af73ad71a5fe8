# SPDX-License-Identifier: Apache-2.0
"""Admission and trial are off: hostile laws run in a robot that moves, and the tick's own containment holds.

Those that fault or push live one day with nothing beside them: their ticks are counted. The others live another day.
"""

import contextlib
import json
import math
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import lithe
import numpy as np
import numpy.typing as npt
import pytest
from calm import calm_robot, connected
from lithe._wire import LawFaultKind, TelemetryFlags
from lithe.demo import losses
from lithe.demo.recorder import Recorder
from lithe.errors import Refused
from lithe.shm import RingCursor
from system.laws.test_hostile_admission import CORPUS, header
from system.robot_rig import ROOT, alive

# A law goes bad this long after its first tick, not before: else the Loader's dry steps would meet it, not the tick.
GOOD_S = 0.05
LATER = """
struct Later {
  using Params = Hostile::Params;
  using State = Hostile::State;
  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    if (t.t_s > GOOD_S) return Hostile::step(t, p, s, u);
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
  }
};
LITHE_LAW(Later,""".replace("GOOD_S", str(GOOD_S))
# An arm that goes heavily: what a law does to it while the machine stalls must not carry it so far past its limits that
# it could not be armed for the next law. A record holds the torque at the joint and not the gains that a law gives the
# drive: those are kept small, so that what the drive itself adds between two records can be bounded.
KP_MAX_NM_RAD, KD_MAX_NM_S_RAD = 1.0, 0.04  # no less than the safe law has
HEAVY = {
    "torque_max_nm = 0.6 ": "torque_max_nm = 0.3 ",
    "viscous_nm_s_rad = 3.0e-5": "viscous_nm_s_rad = 2.0e-2",
    "kp_max_nm_rad = 20.0 ": f"kp_max_nm_rad = {KP_MAX_NM_RAD} ",
    "kd_max_nm_s_rad = 1.0 ": f"kd_max_nm_s_rad = {KD_MAX_NM_S_RAD} ",
}
LOOK_S = {"clamp": 1.0, "harmless": GOOD_S + 0.05}  # how long one is looked at that need not fault
FAULT_S = 10.0  # by then the others have
AGAIN = 3  # times more, from the compile cache: to count ticks
PROBATION = {"tracking_lost", "guard_busy", "guard_stopped", "chattering", "oscillating"}
PROBATION |= {"pushes_away", "gives_no_torque"}  # and of the watch
NEVER_THERE = {"unloadable", "unplaceable"}
CASES = [law for law in CORPUS if header(law, "without-gates") not in ("uncompilable", "not_contained")]

FAULTY_LINE = {  # what stands in the line a fault is said to be in
    "crashes_delayed": "*(volatile int*)8 = 1",
    "divides_delayed": "7 / zero",
    "hangs_delayed": "for (volatile int x = 1",
    "reads_kernel_delayed": "*(volatile long*)",
    "slow_delayed": "x = x + 1e-9",
    "writes_everywhere_delayed": "((volatile double*)&s)[i]",
}
QUIET_S = 0.015  # after a fault, so that the next compile has nothing to do with it
BEFORE_NS, AFTER_NS = 2_000_000, 10_000_000
WAITED_US = 600.0  # an endless loop that lasted longer: the Watchdog's own core was busy with others
SURE = 1e-4  # a difference this unlikely by chance is none


@dataclass
class Fate:
    """What became of a law that was brought in."""

    refused: str = ""  # why it never ran
    commit_tick: int = 0
    kinds: list[str] = field(default_factory=list)  # of its faults
    fault_tick: int = 0
    took_us: float = 0.0
    stopped: str = ""  # the robot's fault, if it had to stop
    law_after: str = ""
    spine: int = 0

    @property
    def ended(self) -> str:
        """In one word."""
        return self.refused or self.stopped or (self.kinds[0] if self.kinds else "ran on")


class Robot:
    """A robot that follows a sine, and gets one bad law after the other."""

    def __init__(self, robot: lithe.Robot) -> None:
        """Start to move."""
        self.robot = robot
        self.faults = RingCursor(robot.spine.mapping, "law_faults")
        self.amplitude_rad = 0.5
        self.ended = threading.Event()
        self.mover = threading.Thread(target=self._move)
        self.mover.start()

    def _move(self) -> None:
        while not self.ended.wait(0.03):
            ahead_ns = time.monotonic_ns() + np.arange(1, 9) * 60_000_000
            self.robot.publish(ahead_ns, self.amplitude_rad * np.sin(ahead_ns * 1e-9 * math.pi))

    def close(self) -> None:
        """Move no more."""
        self.ended.set()
        self.mover.join()

    def move(self, amplitude_rad: float) -> None:
        """Follow another sine, and be on it."""
        self.amplitude_rad = amplitude_rad
        time.sleep(1.0)

    def wait_for_lines(self) -> None:
        """Until the compile service, which answers in turn, has said where the last law failed."""
        self.robot.call("law_check", source=(ROOT / "laws/pd.cpp").read_text(), name="pd.cpp")

    def bring(self, text: str, name: str, look_s: float) -> Fate:
        """Swap a law in, wait for what happens, and put the robot back to the good one."""
        fate = Fate()
        try:
            done = self.robot.swap(text, name=name)
        except Refused as refused:
            fate.refused = f"{refused.code}: {refused.message}"
        else:
            fate.commit_tick = done["commit_tick"]
            self._watch(fate, done["request_id"], look_s)
        status = self.robot.status()
        fate.law_after, fate.spine = status["law"], status["spine_pid"]
        if status["mode"] != "active":  # it is told after the fault of the law
            fate.stopped = status["fault"]
        time.sleep(QUIET_S)
        self._repair(status)
        return fate

    def _watch(self, fate: Fate, request_id: int, look_s: float) -> None:
        end_s = time.monotonic() + look_s
        while not fate.kinds and not fate.stopped and time.monotonic() < end_s:
            time.sleep(0.003)
            for record in self.faults.drain():
                if int(record["request_id"]) == request_id:
                    fate.kinds.append(LawFaultKind(int(record["kind"])).name)
                    fate.fault_tick, fate.took_us = int(record["tick"]), int(record["took_ns"]) * 1e-3
            latest = self.robot.spine.latest()
            if latest is not None and latest["fault"] != 0:
                fate.stopped = self.robot.status()["fault"]

    def _repair(self, status: dict[str, Any]) -> None:
        if status["mode"] != "active":
            self.robot.reset()
            self.robot.arm(all_the_same=True)
        if self.robot.status()["law"] != "pd":
            with contextlib.suppress(Refused):  # its probation was faster
                self.robot.rollback()
        assert self.robot.status()["law"] == "pd"


@dataclass
class Day:
    """All laws in one robot's life, and every tick of it."""

    fates: dict[str, list[Fate]]
    as_written: dict[str, Fate]  # without the good start: the Loader meets most of them
    records: npt.NDArray[Any]
    lost_records: int
    period_ns: int
    torque_max_nm: float
    step_max_nm: float
    status: dict[str, Any]
    alive: bool
    certificates: list[dict[str, Any]]


def expected(law: Path) -> str:
    """What its header says happens without the gates."""
    return str(header(law, "without-gates"))


def is_fault(want: str) -> bool:
    """Whether that is something the tick has to survive."""
    return want in LawFaultKind.__members__


def later(text: str) -> str:
    """The law with a good start, unless it has parts that the start would hide."""
    text = text.replace("20'000", "2").replace("steps > 500", "steps > 5")
    return text if "init(" in text or "Probes" in text else text.replace("LITHE_LAW(Hostile,", LATER)


def is_bad(law: Path) -> bool:
    """Whether it does something, once it runs."""
    return is_fault(expected(law)) or expected(law) == "clamp"


BAD, REST = [law for law in CASES if is_bad(law)], [law for law in CASES if not is_bad(law)]
BOTH_DAYS = pytest.mark.parametrize("which", [pytest.param("day", marks=pytest.mark.alone), "quiet_day"])


@pytest.fixture(scope="module")
def day() -> Iterator[Day]:
    """Of the laws that fault or push."""
    yield from live(BAD)


@pytest.fixture(scope="module")
def quiet_day() -> Iterator[Day]:
    """Of those that cannot be loaded, or only look bad."""
    yield from live(REST)


def live(laws: list[Path]) -> Iterator[Day]:
    """One long-lived robot with open gates: each law in turn, those that fail several times."""
    fates: dict[str, list[Fate]] = defaultdict(list)
    as_written = {}
    with calm_robot("--ungated", changes=HEAVY) as rig, connected() as link:
        info = link.spine.info
        robot, recorder = Robot(link), Recorder("arm")
        try:
            for law in laws:
                want, text = expected(law), law.read_text()
                if is_fault(want):
                    as_written[law.stem] = robot.bring(text, law.name, GOOD_S)
                for _ in range(1 + AGAIN * is_fault(want)):
                    fates[law.stem].append(robot.bring(later(text), law.name, LOOK_S.get(want, FAULT_S)))
                if is_fault(want) and all(PROBATION.issuperset(fate.kinds) for fate in fates[law.stem]):
                    robot.move(0.0)  # what it does, it does to an arm at rest
                    fates[law.stem].append(robot.bring(later(text), law.name, FAULT_S))
                    robot.move(0.5)
            robot.wait_for_lines()
            status = rig.ask("status")
        finally:
            robot.close()
            records = recorder.finish()
        yield Day(
            fates, as_written, records, recorder.lost, round(1e9 / float(info["rate_hz"])),
            float(info["torque_max_nm"][0]), float(info["torque_slew_nm_s"][0]) / float(info["rate_hz"]),
            status, alive(status["spine_pid"]),
            [json.loads(path.read_text()) for path in sorted(Path(status["records"]).glob("*.json"))],
        )  # fmt: skip


@pytest.mark.alone
@pytest.mark.parametrize("law", BAD, ids=lambda law: law.stem)
def test_what_the_law_does_is_contained(law: Path, day: Day) -> None:
    """It ends as its header says, the fault has its name, and afterwards another law runs, or the safe law."""
    ends_as_it_says(law, day)


@pytest.mark.parametrize("law", REST, ids=lambda law: law.stem)
def test_a_law_that_does_nothing_bad_ends_as_it_says(law: Path, quiet_day: Day) -> None:
    """It is not loaded, or runs on."""
    ends_as_it_says(law, quiet_day)


def ends_as_it_says(law: Path, day: Day) -> None:
    """What became of a law, against its header."""
    want = expected(law)
    for fate in day.fates[law.stem]:
        if want in NEVER_THERE:
            assert fate.refused.startswith(("compile_failed", "load_failed", "place_failed")), fate.ended
        elif want == "harmless":
            assert fate.ended == "ran on" or set(fate.kinds) <= PROBATION, fate.ended
        elif want == "clamp":
            assert fate.stopped or (not fate.refused and set(fate.kinds) <= PROBATION), fate.ended
        elif fate.refused:
            assert "init(" in law.read_text() and fate.refused.startswith("dry_run_failed"), fate.refused
        else:
            assert len(fate.kinds) == 1 and fate.kinds[0] in {want, *PROBATION}, fate.ended
        if fate.ended != "ran on":
            assert fate.law_after == "pd" or fate.stopped
    assert not is_fault(want) or any(want in fate.kinds or fate.refused for fate in day.fates[law.stem])


@pytest.mark.alone
@pytest.mark.parametrize("law", [law for law in CASES if is_fault(expected(law))], ids=lambda law: law.stem)
def test_the_loader_survives_it_too(law: Path, day: Day) -> None:
    """Without the good start it fails in its dry steps, and is refused with the reason; else the tick deals with it."""
    fate, want = day.as_written[law.stem], expected(law)
    if fate.refused:
        named = "is not finite" if want == "not_finite" else want
        assert fate.refused.startswith("dry_run_failed") and named in fate.refused
    else:
        assert fate.kinds in ([], [want])


@pytest.mark.alone
@pytest.mark.parametrize("name", FAULTY_LINE)
def test_a_fault_is_told_with_its_line(name: str, day: Day) -> None:
    """In the certificate, which is written again when the law is long gone."""
    faults = [each["fault"] for each in day.certificates if each["source"] == f"{name}.cpp" and "fault" in each]
    source = later((ROOT / f"tests/laws_hostile/{name}.cpp").read_text()).splitlines()
    assert len(faults) > AGAIN
    for fault in faults:
        file, line = fault["where"].split(":")
        assert file == f"{name}.cpp"
        assert FAULTY_LINE[name] in source[int(line) - 1], fault


@BOTH_DAYS
def test_the_spine_lives_on_and_the_robot_works(which: str, request: pytest.FixtureRequest) -> None:
    """The same process, armed, without a fault, with the law it had in the morning."""
    day: Day = request.getfixturevalue(which)
    assert day.alive
    everyone = [fate for fates in day.fates.values() for fate in fates] + list(day.as_written.values())
    assert {fate.spine for fate in everyone} == {day.status["spine_pid"]}
    assert (day.status["mode"], day.status["fault"], day.status["law"]) == ("active", "none", "pd")


@BOTH_DAYS
def test_no_law_gets_a_torque_past_the_guard(
    which: str, request: pytest.FixtureRequest, tell: Callable[[str], None]
) -> None:
    """What left the Spine: within the joint's limit, and no further from what left before than the slew bound."""
    day: Day = request.getfixturevalue(which)
    assert day.lost_records == 0, "every tick was recorded"
    assert (np.diff(day.records["tick"].astype(np.int64)) == 1).all()
    # What a tick decides leaves with the next one, unless the bus is still busy then: nobody ever gets that.
    leaves = (day.records["flags"][1:] & TelemetryFlags.sample_stale) == 0
    torque_nm = day.records["command_torque_nm"][:-1, 0][leaves]
    # The bound holds for the torque where the joint is when a command takes over. A command before it that has gains of
    # the drive gives another torque then than when it was recorded: by as much as position and speed have changed. The
    # guard predicts where the joint is from a sample that is some periods old, here at most 20.
    velocity_rad_s = day.records["velocity_rad_s"][:-1, 0][leaves]
    changed_rad_s = np.abs(np.diff(velocity_rad_s))
    changed_rad = np.abs(np.diff(day.records["position_rad"][:-1, 0][leaves])) + 20e-9 * day.period_ns * changed_rad_s
    drifted_nm = KP_MAX_NM_RAD * changed_rad + KD_MAX_NM_S_RAD * changed_rad_s
    most_nm, step_nm = np.abs(torque_nm).max(), np.maximum(np.abs(np.diff(torque_nm)) - drifted_nm, 0.0).max()
    tell(
        f"{len(day.fates)} laws in {len(torque_nm)} ticks: torque up to {most_nm:.4f} of {day.torque_max_nm:g} N m, "
        f"step up to {step_nm:.4f}, slew bound {day.step_max_nm:.4f} N m"
    )
    assert np.isfinite(torque_nm).all()
    assert most_nm <= day.torque_max_nm + 1e-9
    assert step_nm <= day.step_max_nm + 1e-9


@pytest.mark.alone
def test_a_containment_costs_no_ticks(day: Day, tell: Callable[[str], None]) -> None:
    """Ticks are lost around a fault no more often than while the same laws still behaved."""
    made = losses.releases(day.records, day.period_ns)
    windows: dict[str, list[losses.Window]] = defaultdict(list)
    took_us: dict[str, list[float]] = defaultdict(list)
    others: list[losses.Window] = []
    for law in BAD:
        for fate in day.fates[law.stem]:
            if expected(law) not in fate.kinds:
                continue
            group = "endless loops" if fate.kinds[0] == "overran" else "faults"
            fault_ns = losses.commit_ns(day.records, fate.fault_tick)
            took_us[group].append(fate.took_us)
            if group == "faults" or fate.took_us <= WAITED_US:
                windows[group].append((fault_ns - BEFORE_NS, fault_ns + AFTER_NS))
            good = (losses.commit_ns(day.records, fate.commit_tick) + BEFORE_NS, fault_ns - BEFORE_NS)
            others += losses.elsewhere(good, [], BEFORE_NS + AFTER_NS)
    for group in ("faults", "endless loops"):
        around, waited = windows[group], len(took_us[group]) - len(windows[group])
        told, lost = losses.compare(made, around, others), losses.tally(made, around)["lost_ticks"]
        tell(
            f"ticks lost per containment: {group} {lost:g} of {len(around)}, in {told.at_events} windows; before them "
            f"in {told.between} of {told.others} (p = {told.chance:.2g}; {told.would_show(SURE)} would have failed); "
            f"from the law's start to the other law's output {np.median(took_us[group]):.1f} us median, "
            f"{max(took_us[group]):.1f} us most; {waited} not compared: the Watchdog had to wait"
        )
        assert told.others > 2 * told.events, "there is enough to compare with"
        assert told.chance >= SURE, f"{group}: {told}"
        assert took_us[group]
