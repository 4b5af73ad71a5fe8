# SPDX-License-Identifier: Apache-2.0
"""What boards r and a do once they are booted (tools/vm/boards.py copies this file there): the steps that are named on
the command line. Each prints `vm: begin NAME`, one JSON document, and `vm: end NAME CODE`."""

import contextlib
import json
import math
import os
import re
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

HOME = Path(__file__).resolve().parent
BIN = HOME / "bin"
START_S, TEST_S = 600.0, 300.0
# A busy computer gives the compiler less time than it may take; lawd then says how long it had.
ATTEMPTS, STARVED = 4, "s of the processor in"
REPEATS, REPEATED_S = 10, 600.0  # of the tests whose threads race
PROBATION = {"tracking_lost", "guard_busy", "guard_stopped", "chattering", "oscillating"}
# A trial begins with the dry run.
STAGES = {"compile": ["compile_failed"], "admission": ["admission_failed"], "trial": ["trial_failed", "dry_run_failed"]}
REFUSED = ("half_a_file", "asm_syscall", "pointer_in_state", "nan_always", "loops_for_ever")
CONTAINED = (
    "crashes_delayed", "hangs_delayed", "nan_delayed", "overwrites_the_program_delayed", "reads_kernel_delayed",
    "asm_syscall", "divides_delayed", "chatters_delayed", "writes_everywhere_delayed", "slow_delayed",
    "full_torque_delayed", "flips_delayed", "stiffens_delayed",
)  # fmt: skip
# A law goes bad 0.05 s after its first tick, not before: else the Loader's dry steps would meet it, not the tick.
GOOD_TICKS = 13  # of that time, at 250 Hz
LATER = """
struct Later {
  using Params = Hostile::Params;
  using State = Hostile::State;
  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    if (t.t_s > 0.05) return Hostile::step(t, p, s, u);
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
  }
};
LITHE_LAW(Later,"""
NO_FIGURES = (  # matplotlib is no part of this system
    "import sys, types; figures = types.ModuleType('lithe.demo.figures'); figures.draw = lambda *_: None; "
    "sys.modules['lithe.demo.figures'] = figures; from lithe.demo.__main__ import main; sys.exit(main())"
)


class Board:
    """The robot that runs here."""

    def __init__(self) -> None:
        """None does yet."""
        self.process: subprocess.Popen[bytes] | None = None
        self.words: tuple[str, ...] = ()

    def lithe(self, *words: str, codes: tuple[int, ...] = (0,)) -> dict[str, Any]:
        """One command; its document."""
        done = subprocess.run([str(BIN / "lithe"), "--json", *words], capture_output=True, text=True, check=False)
        assert done.returncode in codes, f"{words}: {done.returncode}\n{done.stdout}{done.stderr}"
        told: dict[str, Any] = json.loads(done.stdout or "{}")
        return told

    def start(self, *words: str) -> dict[str, Any]:
        """The status of a robot that was started so and is active."""
        if self.process is not None and self.words == words:
            return self.lithe("status")
        for _ in range(ATTEMPTS):
            self.stop()
            if status := self.active(words):
                return status
            if STARVED not in Path("/tmp/run.log").read_text():
                break
        raise AssertionError(f"the robot is not active after {START_S:g} s:\n{Path('/tmp/run.log').read_text()}")

    def active(self, words: tuple[str, ...]) -> dict[str, Any] | None:
        """The status of a robot that was started now; None if it does not become active."""
        with Path("/tmp/run.log").open("wb") as log:
            self.process = subprocess.Popen([BIN / "lithe", "run", *words], stdout=log, stderr=log)
        self.words = words
        end = time.monotonic() + START_S
        while time.monotonic() < end and self.process.poll() is None:
            with contextlib.suppress(AssertionError):
                status = self.lithe("status")
                if status["mode"] == "active":
                    return status
            time.sleep(0.5)
        return None

    def swap(self, law: Path) -> dict[str, Any]:
        """The answer to a swap."""
        answer: dict[str, Any] = {}
        for _ in range(ATTEMPTS):
            answer = self.lithe("swap", str(law), codes=(0, 1))
            if STARVED not in json.dumps(answer):
                break
        return answer

    def stop(self) -> int | None:
        """Its exit code."""
        if self.process is None:
            return None
        if self.process.poll() is None:
            self.lithe("stop")
        code, self.process = self.process.wait(60), None
        return code


BOARD = Board()
CALM, HEAVY = str(HOME / "robots/calm.toml"), str(HOME / "robots/heavy.toml")


def kernel() -> dict[str, Any]:
    """What runs here."""
    flag = Path("/sys/kernel/realtime")
    compiler = subprocess.run(["g++", "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
    return {
        "release": os.uname().release,
        "machine": os.uname().machine,
        "cores": os.cpu_count(),
        "realtime": flag.exists() and flag.read_text().strip() == "1",
        "version": os.uname().version,
        "compiler": compiler,
        "python": sys.version.split()[0],
    }


def doctor() -> dict[str, Any]:
    """As it is, and what a shell script reads; below tier B it ends with 1. No robot may run yet."""
    told = BOARD.lithe("doctor", codes=(0, 1))
    words = ["bash", str(HOME / "doctor_expected.sh"), str(told["cpu"])]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return told | {"expected": done.stdout}


def names_of(program: Path) -> list[str]:
    """The tests of a program of GoogleTest."""
    said = subprocess.run([program, "--gtest_list_tests"], capture_output=True, text=True, check=True, timeout=TEST_S)
    names, suite = [], ""
    for line in said.stdout.splitlines():
        if line.startswith("  "):
            names.append(suite + line.split()[0])
        elif line.split("#")[0].strip().endswith("."):
            suite = line.split("#")[0].strip()
    return [name for name in names if "DISABLED_" not in name]


def one_test(program: Path, name: str) -> tuple[str, str]:
    """How a test ended, in a process of its own, and why."""
    command = [str(program), f"--gtest_filter={name}", "--gtest_color=no"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False, timeout=TEST_S)
    except subprocess.TimeoutExpired:
        return "failed", f"{name}: not done after {TEST_S:g} s"
    if done.returncode != 0:
        return "failed", f"{name}: {(done.stdout + done.stderr)[-1500:]}"
    skipped = re.search(r"\.cpp:\d+: Skipped\n(.*)", done.stdout)
    return ("skipped", skipped[1]) if skipped else ("passed", "")


def tests() -> dict[str, Any]:
    """LITHE's own C++ tests, each by itself."""
    counts: dict[str, dict[str, int]] = {}
    failures, reasons = [], set()
    for program in sorted(BIN.glob("*_tests")):
        names = names_of(program)
        with ThreadPoolExecutor(os.cpu_count()) as several:
            ended = list(several.map(lambda name, program=program: one_test(program, name), names))
        kinds = [kind for kind, _ in ended]
        counts[program.name] = {kind: kinds.count(kind) for kind in ("passed", "failed", "skipped")}
        failures += [why for kind, why in ended if kind == "failed"]
        reasons |= {why for kind, why in ended if kind == "skipped"}
    return {"tests": counts, "failures": failures, "skipped_because": sorted(reasons)}


def stress() -> dict[str, Any]:
    """The tests whose threads race, several times: one line of the file `stress` for each room, ROOM FILTER."""
    ends: dict[str, Any] = {}
    for room, names in (line.split() for line in (HOME / "stress").read_text().splitlines()):
        words = [str(BIN / f"{room}_tests"), f"--gtest_filter={names}", f"--gtest_repeat={REPEATS}", "--gtest_color=no"]
        done = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False, timeout=REPEATED_S)
        passed = [int(count) for count in re.findall(r"(?m)^\[  PASSED  \] (\d+) tests?", done.stdout)]
        said = (done.stdout + done.stderr)[-1500:] if done.returncode != 0 else ""
        ends[room] = {"code": done.returncode, "passed": passed, "said": said}
    return {"rooms": ends}


def robot() -> dict[str, Any]:
    """A robot that the Spine keeps active."""
    return BOARD.start(CALM)


def swaps() -> dict[str, Any]:
    """Every law that comes with LITHE, one after the other."""
    spine, made = BOARD.start(CALM)["spine_pid"], {}
    for law in sorted((HOME / "laws").glob("*.cpp")):
        started = time.monotonic()
        done = BOARD.swap(law)
        resident = BOARD.lithe("law", "list")["resident"]
        slots = [each["slot"] for each in resident if each["law"] == law.stem]
        made[law.stem] = {
            "verdict": done.get("verdict") or done.get("error", {}).get("code"),
            "message": done.get("error", {}).get("message", ""),
            "slots": slots,
            "seconds": round(time.monotonic() - started, 1),
        }
    status = BOARD.lithe("status")
    return {
        "swaps": made,
        "loader": status["loader"],
        "same_spine": status["spine_pid"] == spine,
        "mode": status["mode"],
        "fault": status["fault"],
        "chain": BOARD.lithe("law", "verify"),
        "certificates": len(list(Path(status["records"]).glob("[0-9]*.json"))),
    }


def brain() -> dict[str, Any]:
    """Plans from Python through shared memory: the joint goes where they say."""
    BOARD.start(CALM)
    import lithe

    BOARD.swap(HOME / "laws/pd.cpp")
    seen = []
    with lithe.connect() as link:
        for side_rad in (0.3, -0.3, 0.0):
            link.go_to([side_rad], 1.5)
            time.sleep(3.0)
            latest = link.spine.latest()
            assert latest is not None
            seen.append(round(float(latest["position_rad"][0]), 3))
        status = link.status()
    return {"wanted_rad": [0.3, -0.3, 0.0], "seen_rad": seen, "mode": status["mode"], "fault": status["fault"]}


def header(law: Path, key: str) -> str:
    """What the first lines of a hostile law say under a key."""
    found = re.search(rf"(?m)^// {key}: (\S+)", law.read_text()[:500])
    return found[1] if found else ""


def refused() -> dict[str, Any]:
    """Hostile laws before closed gates: each is refused at its stage, and the robot goes on."""
    spine, ends = BOARD.start(CALM)["spine_pid"], {}
    for law in (HOME / f"tests/laws_hostile/{name}.cpp" for name in REFUSED):
        code = BOARD.swap(law).get("error", {}).get("code", "committed")
        ends[law.stem] = {"refused": code, "wanted": STAGES[header(law, "stopped-by")]}
    status = BOARD.lithe("status")
    return {"laws": ends, "same_spine": status["spine_pid"] == spine, "mode": status["mode"]}


def later(text: str) -> str:
    """A hostile law with a good start, and soon bad."""
    return text.replace("20'000", "2").replace("steps > 500", "steps > 5").replace("LITHE_LAW(Hostile,", LATER)


def fate_of(link: Any, faults: Any, law: Path, look_s: float) -> dict[str, Any]:
    """What became of a law that nothing stops before the tick. `clamped`: bad ticks of it that the guard limited."""
    from lithe._wire import LawFaultKind, TelemetryFlags
    from lithe.errors import Refused

    limited = TelemetryFlags.torque_clamped | TelemetryFlags.slew_clamped | TelemetryFlags.velocity_clamped
    fate: dict[str, Any] = {"kinds": [], "refused": "", "stopped": "", "clamped": 0}
    ticks = link.spine.telemetry()
    try:
        done = link.swap(later(law.read_text()), name=law.name)
    except Refused as error:
        return fate | {"refused": f"{error.code}: {error.message[:200]}"}
    end = time.monotonic() + look_s
    while not fate["kinds"] and not fate["stopped"] and time.monotonic() < end:
        time.sleep(0.01)
        seen = ticks.drain()
        bad = (seen["law_id"] == done["law_id"]) & (seen["tick"] > done["commit_tick"] + GOOD_TICKS)
        fate["clamped"] += int((bad & ((seen["flags"] & limited) != 0)).sum())
        for record in faults.drain():
            if int(record["request_id"]) == done["request_id"]:
                fate["kinds"].append(LawFaultKind(int(record["kind"])).name)
        latest = link.spine.latest()
        if latest is not None and latest["fault"] != 0:
            fate["stopped"] = link.status()["fault"]
    return fate


def repair(link: Any) -> None:
    """Back to the good law, armed."""
    from lithe.errors import Refused

    if link.status()["mode"] != "active":
        link.reset()
        link.arm()
    if link.status()["law"] != "pd":
        with contextlib.suppress(Refused):  # its probation was faster
            link.rollback()
    status = link.status()
    assert (status["mode"], status["law"]) == ("active", "pd"), status


def as_said(want: str, fate: dict[str, Any], machine: str) -> bool:
    """Whether a law ran, and ended as its header says: the fault that it names, or limited by the guard."""
    kinds = set(fate["kinds"])
    if fate["refused"]:
        return False
    if want == "clamp":
        return fate["clamped"] > 0 and (bool(fate["stopped"]) or kinds <= PROBATION)
    if want == "arithmetic" and machine == "aarch64":
        return kinds <= PROBATION  # this processor divides by zero, and gets 0: the arm hangs loose
    return bool(fate["kinds"] == [want])


def fate_in_the_end(link: Any, faults: Any, law: Path, want: str) -> dict[str, Any]:
    """What became of it. Where only its probation failed, or nothing was seen, it is tried again, up to ATTEMPTS."""
    fate: dict[str, Any] = {}
    for attempt in range(1, ATTEMPTS + 1):
        fate = fate_of(link, faults, law, 3.0 if want in ("clamp", "arithmetic") else 15.0)
        fate |= {"wanted": want, "as_said": as_said(want, fate, os.uname().machine), "attempts": attempt}
        repair(link)
        if fate["as_said"] or not PROBATION.issuperset(fate["kinds"]):
            break
    return fate


def contained() -> dict[str, Any]:
    """Hostile laws before open gates, on a robot that moves: the Spine lives on, and each ends as its header says."""
    status = BOARD.start(HEAVY, "--ungated")
    import lithe
    from lithe.shm import RingCursor

    ends: dict[str, Any] = {}
    over = threading.Event()
    with lithe.connect() as link:

        def move() -> None:
            while not over.wait(0.1):
                ahead_ns = [time.monotonic_ns() + n * 120_000_000 for n in range(1, 9)]
                link.publish(ahead_ns, [0.5 * math.sin(ns * 1e-9 * math.pi / 2) for ns in ahead_ns])

        mover = threading.Thread(target=move)
        mover.start()
        try:
            faults = RingCursor(link.spine.mapping, "law_faults")
            for law in (HOME / f"tests/laws_hostile/{name}.cpp" for name in CONTAINED):
                ends[law.stem] = fate_in_the_end(link, faults, law, header(law, "without-gates"))
        finally:
            over.set()
            mover.join()
        after = link.status()
    same = after["spine_pid"] == status["spine_pid"]
    return {"laws": ends, "same_spine": same, "mode": after["mode"], "lost": after["lost"]}


def stop() -> dict[str, Any]:
    """The robot ends in order."""
    return {"code": BOARD.stop()}


def demo() -> dict[str, Any]:
    """The experiment of `make demo` without its figures."""
    BOARD.stop()
    out = Path("/tmp/demo")
    words = ["--robot", CALM, "--out", str(out)]
    command = [sys.executable, "-c", NO_FIGURES, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    told = json.loads((out / "summary.json").read_text()) if (out / "summary.json").exists() else {}
    kept = ("verdict", "falls_short", "inconclusive", "stopped", "swaps", "freeze", "phases")
    incidents = [json.loads(path.read_text())["what"] for path in sorted(Path("/tmp").rglob("incidents/*.json"))]
    said = {"code": done.returncode, "said": (done.stdout + done.stderr)[-3000:], "incidents": incidents[-20:]}
    return said | {name: told.get(name) for name in kept}


STEPS: dict[str, Callable[[], dict[str, Any]]] = {
    step.__name__: step for step in (kernel, doctor, tests, stress, robot, swaps, brain, refused, contained, stop, demo)
}


def main() -> int:
    """One after the other; one that fails keeps no other back."""
    cores = os.sched_getaffinity(0)
    for name in sys.argv[1:]:
        started = time.monotonic()
        os.sched_setaffinity(0, cores)  # a Brain has narrowed them: the next robot would lack Transport and filter
        print(f"vm: begin {name}", flush=True)
        try:
            told, code = STEPS[name](), 0
        except Exception:
            told, code = {"error": traceback.format_exc()}, 1
        print(json.dumps(told | {"took_s": round(time.monotonic() - started, 1)}))
        print(f"vm: end {name} {code}", flush=True)
    with contextlib.suppress(AssertionError, OSError, subprocess.SubprocessError):
        BOARD.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main())
