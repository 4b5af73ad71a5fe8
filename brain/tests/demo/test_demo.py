# SPDX-License-Identifier: Apache-2.0
"""The whole experiment as `make demo` runs it, on the patient robot; and the ways it may not even begin."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import calm
import numpy as np
import pytest
import synthetic
from lithe._wire import Fault
from lithe.demo import __main__ as demo
from lithe.demo import agent, experiment, moves, recorder, sources
from lithe.demo.joints import SimJoint
from lithe.demo.processes import Disturbed, Stage, raise_unless_active
from system.robot_rig import BIN, ROOT, need

pytestmark = pytest.mark.early

LAWS = ["detuned_pd", "probe_1", "probe_2", "gravity_only", "evolved"]


STARTED: list[subprocess.Popen[str]] = []


@pytest.fixture(autouse=True)
def end_what_was_started() -> Iterator[None]:
    yield
    while STARTED:
        process = STARTED.pop()
        if process.poll() is None:
            process.terminate()
        if process.stdout is not None and not process.stdout.closed:
            process.communicate(timeout=60)


def run(out: Path, robot: Path, *words: str, **environment: str) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-m", "lithe.demo", "--out", str(out), "--robot", str(robot), *words],
        env=os.environ | {"PYTHONPATH": str(ROOT / "brain"), "LITHE_BIN_DIR": str(BIN)} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    STARTED.append(process)
    return process


@pytest.fixture
def robot_file(tmp_path: Path) -> Path:
    need("lithe", "lithe-spine", "lithe-spine-sim", "lawd")
    path = tmp_path / "arm.toml"
    path.write_text(calm.calm_text(ideal=False), encoding="utf-8")
    return path


def leftovers(pid: int) -> list[str]:
    """Segments; a killed robot's empty lock files stay."""
    return [path.name for path in Path("/dev/shm").glob(f"lithe-demo-{pid}.*") if path.suffix != ".lock"]


ANOTHER_ARM = {
    "rate_hz = 1000 ": "rate_hz = 500 ",
    "inertia_kg_m2 = 2.55e-3": "inertia_kg_m2 = 3.3e-3",
    "mgl_nm = 0.165": "mgl_nm = 0.2145",
    "viscous_nm_s_rad = 3.0e-5": "viscous_nm_s_rad = 2.0e-4",
    "coulomb_nm = 0.0132": "coulomb_nm = 0.0198",
}


def test_the_experiment_holds_on_an_arm_the_agent_has_never_seen(tmp_path: Path, robot_file: Path) -> None:
    """Nothing is hard-coded: 1.3 times the weight and inertia, half as much friction again, half the tick rate."""
    text = robot_file.read_text(encoding="utf-8")
    for usual, other in ANOTHER_ARM.items():
        assert usual in text, f"robots/arm.toml no longer says: {usual}"
        text = text.replace(usual, other)
    robot_file.write_text(text, encoding="utf-8")
    process = run(tmp_path / "out", robot_file)
    words, _ = process.communicate(timeout=240)
    assert "verdict" in words, words
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert process.returncode == {"holds": 0, "falls_short": 1, "INCONCLUSIVE": 4}[summary["verdict"]], words
    assert calm.falls_short(summary) == [], words
    assert summary["records_lost"] == 0
    assert summary["rate_hz"] == 500.0 and summary["mgl_error"] < 0.05
    told = json.loads(
        subprocess.run([BIN / "lithe-sim", "--truth", robot_file], check=True, capture_output=True).stdout
    )
    assert summary["mgl_true_nm"] == told["joints"][0]["mgl_told_nm"] != 0.2145, "with payload, and in the drive's unit"
    least_nm, most_nm = summary["mgl_interval_nm"]
    assert least_nm < summary["mgl_hat_nm"] < most_nm and f"95 % interval {least_nm:.4f} to {most_nm:.4f}" in words
    assert summary["freeze"]["gravity_share"] > 0.9
    assert [swap["law"] for swap in summary["swaps"]] == LAWS
    assert all(swap["output_step_nm"] <= summary["output_step_bound_nm"] + 1e-9 for swap in summary["swaps"])
    rmse_deg = {phase["name"]: phase["rmse_deg"] for phase in summary["phases"]}
    assert rmse_deg["evolved"] < rmse_deg["gravity_only"] < rmse_deg["baseline"]
    for name in demo.PRODUCTS:
        assert (tmp_path / "out" / name).stat().st_size > 0
    assert leftovers(process.pid) == []


def run_until(process: subprocess.Popen[str], words: str) -> None:
    assert process.stdout is not None
    said = []
    while words not in (line := process.stdout.readline()):
        said.append(line)
        assert line, f"it ended early: {''.join(said)}"


def spine_of(demo_pid: int) -> int:
    """Pid in the header of the segment that the demo's Spine writes."""
    with Path(f"/dev/shm/lithe-demo-{demo_pid}.arm.spine").open("rb") as file:
        file.seek(56)
        return int.from_bytes(file.read(8), "little")


def test_a_stop_that_nothing_explains_falls_short_and_is_not_repeated(tmp_path: Path, robot_file: Path) -> None:
    """The negative control: the Spine is stopped on purpose, and no count of the kernel says that the machine was."""
    text = robot_file.read_text(encoding="utf-8")
    assert "watchdog_s = 10.0 " in text
    robot_file.write_text(text.replace("watchdog_s = 10.0 ", "watchdog_s = 0.5 "), encoding="utf-8")
    process = run(tmp_path / "out", robot_file)
    run_until(process, "phase: baseline")
    spine = spine_of(process.pid)
    os.kill(spine, signal.SIGSTOP)
    time.sleep(1.5)  # longer than a drive waits for commands
    os.kill(spine, signal.SIGCONT)
    words, _ = process.communicate(timeout=60)
    assert words.count("phase: baseline") == 0 and "verdict     the claim falls short" in words, words
    assert process.returncode == 1, words
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["verdict"] == "falls_short" and summary["stopped"]["phase"] == "baseline"
    assert "drive_watchdog" in summary["falls_short"][0] and summary["timing"]["before_the_stop"]["own"] > 100


def test_a_stop_that_is_not_the_machines_doing_ends_the_demo(tmp_path: Path, robot_file: Path) -> None:
    short = Path(tempfile.mkdtemp(prefix="lithe-t"))  # a socket's path may not be long
    process = run(tmp_path / "out", robot_file, TMPDIR=str(short))
    try:
        run_until(process, "phase: baseline")
        (folder,) = short.glob("lithe-demo-*")
        env = os.environ | {"LITHE_RUN_DIR": str(folder), "LITHE_SHM_PREFIX": f"lithe-demo-{process.pid}"}
        subprocess.run([BIN / "lithe", "estop"], env=env, check=True, capture_output=True)
        words, _ = process.communicate(timeout=60)
    finally:
        shutil.rmtree(short)
    assert process.returncode == 1 and "'estop', fault 'estop_pressed'" in words and "Traceback" not in words
    assert leftovers(process.pid) == []


@pytest.mark.parametrize("fault", list(Fault))
def test_every_fault_may_be_the_machines_or_is_the_robots(fault: Fault) -> None:
    machines = fault in (Fault.sample_stale, Fault.deadline_missed, Fault.drive_watchdog)
    with pytest.raises(demo.LitheError) as told:
        raise_unless_active("safe_stop", fault.name)
    assert isinstance(told.value, Disturbed) == machines and fault.name in str(told.value)
    with pytest.raises(demo.LitheError, match="'hold'"):
        raise_unless_active("hold", fault.name)
    raise_unless_active("active", "none")
    if fault != Fault.none:  # with other_groups = "continue": a part of the robot has stopped
        with pytest.raises(demo.LitheError) as told:
            raise_unless_active("active", fault.name)
        assert isinstance(told.value, Disturbed) == machines and fault.name in str(told.value)


def test_an_old_success_is_never_read_as_a_new_one(tmp_path: Path) -> None:
    for name in (*demo.PRODUCTS, "mine.txt"):
        (tmp_path / name).write_text("old")
    demo.prepare(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"log.txt", "mine.txt"}
    assert (tmp_path / "log.txt").read_text() == ""


def test_a_wrong_robot_file_costs_no_earlier_results(tmp_path: Path) -> None:
    for name in demo.PRODUCTS:
        (tmp_path / name).write_text("old")
    process = run(tmp_path, ROOT / "robots/no_such_robot.toml")
    words, _ = process.communicate(timeout=60)
    assert process.returncode == 1 and "no_such_robot.toml" in words and "Traceback" not in words
    assert [(tmp_path / name).read_text() for name in demo.PRODUCTS] == ["old"] * len(demo.PRODUCTS)


def test_a_disk_that_is_full_in_the_end_is_named(tmp_path: Path) -> None:
    (tmp_path / "telemetry.npz").symlink_to("/dev/full")
    with pytest.raises(demo.LitheError, match=r"cannot write to .*No space left"), demo.writing(tmp_path):
        recorder.save(synthetic.records(100), tmp_path)
    (tmp_path / "summary.json.part").symlink_to("/dev/full")
    with pytest.raises(demo.LitheError, match="No space left"):
        demo.write_summary({"phases": ["one"] * 100_000}, tmp_path)
    assert not (tmp_path / "summary.json").exists()


def test_a_stage_that_fails_takes_everything_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need("lithe")
    monkeypatch.setenv("LITHE_BIN_DIR", str(BIN))
    for name in ("LITHE_RUN_DIR", "LITHE_SHM_PREFIX", "LITHE_OUT_DIR"):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "wrong.toml").write_text('name = "arm"\nrate_hz = "fast"\n')
    cores, files = os.sched_getaffinity(0), len(os.listdir("/proc/self/fd"))
    with pytest.raises(demo.LitheError, match=r"(?s)rate_hz.*log\.txt"):
        Stage(tmp_path / "wrong.toml", tmp_path / "log.txt")
    assert os.sched_getaffinity(0) == cores and len(os.listdir("/proc/self/fd")) == files
    assert list(tmp_path.glob("lithe-demo-*")) == [] and leftovers(os.getpid()) == []


def test_an_agent_without_its_token_file_says_what_to_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["agent", "--port", "1", "--token-file", str(tmp_path / "none")])
    assert agent.main() == 1
    told = capsys.readouterr().err
    assert f"cannot read the token file {tmp_path / 'none'}" in told and "next: python -m lithe.gateway" in told


JOINT = '[[joint]]\nname = "a"\nposition_min_rad = -1.5\nposition_max_rad = 1.5\n'


@pytest.mark.parametrize("sim", ["[joint.sim]\nmgl_nm = 0", ""])
def test_a_robot_without_gravity_is_refused(tmp_path: Path, sim: str) -> None:
    (tmp_path / "arm.toml").write_text(JOINT + sim)
    with pytest.raises(demo.LitheError, match="simulates no gravity"):
        demo.simulated_joints(tmp_path / "arm.toml")


BUSES = '[[bus]]\nname = "can0"\nkind = "loop"\n[[bus]]\nname = "can1"\n'


@pytest.mark.parametrize("kind", ["fdcanusb", "slcan", "socketcan", "pi3hat", "of tomorrow", ""])
def test_a_bus_on_which_motors_may_hang_is_refused_before_anything_is_started(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of everything that is wrong with such a robot, this is said first."""
    robot = tmp_path / "arm.toml"
    robot.write_text('[plant]\nkind = "chain"\n' + BUSES + (f'kind = "{kind}"\n' if kind else "") + JOINT)
    started: list[Any] = []
    monkeypatch.setattr(demo, "Stage", lambda *words: started.append(words))
    monkeypatch.setattr(sys, "argv", ["demo", "--out", str(tmp_path / "out"), "--robot", str(robot)])
    assert demo.main() == 1 and started == []
    told = capsys.readouterr().err
    assert f"arm.toml: bus 'can1' is of kind \"{kind or None}\"" in told and "Nothing was started" in told
    assert f"--robot {robot} --over-real-buses" in told and "next:" in told


def test_a_bus_on_which_motors_may_hang_takes_permission(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = tmp_path / "arm.toml"
    started: list[Any] = []

    def stage(*words: Any) -> Any:
        started.append(words)
        raise demo.LitheError("far enough")

    monkeypatch.setattr(demo, "Stage", stage)
    monkeypatch.setattr(demo, "with_truth", lambda _, sims: sims)  # what `lithe sim` would say of half a robot file
    allowed = ["demo", "--out", str(tmp_path / "out"), "--robot", str(robot), "--over-real-buses"]
    monkeypatch.setattr(sys, "argv", allowed)
    real = BUSES + 'kind = "fdcanusb"\n' + JOINT
    robot.write_text(real)
    assert demo.main() == 1 and "simulates no gravity" in capsys.readouterr().err and started == []
    robot.write_text(real + "[joint.sim]\nmgl_nm = 0.1\n")
    assert demo.main() == 1 and "far enough" in capsys.readouterr().err and len(started) == 1


@pytest.mark.parametrize(
    "text", ["= ", "[[joint]]\n", JOINT.replace("-1.5", '"low"'), '[bus]\nkind = "loop"\n' + JOINT, "joint = 3", "\xff"]
)
def test_what_is_no_robot_file_is_started_by_nobody(tmp_path: Path, text: str) -> None:
    (tmp_path / "arm.toml").write_bytes(text.encode("latin-1"))
    with pytest.raises(demo.LitheError, match=r"(?s)arm\.toml is not what.*next: `lithe bus plan"):
        demo.simulated_joints(tmp_path / "arm.toml")


def test_a_robot_file_that_cannot_be_read_is_named_with_the_reason(tmp_path: Path) -> None:
    for path, reason in ((tmp_path, "is a directory"), (tmp_path / "absent.toml", "No such file")):
        with pytest.raises(
            demo.LitheError, match=f"(?s)cannot read the robot file {path}: {reason}.*next: give a"
        ) as told:
            demo.simulated_joints(path)
        assert "Errno" not in str(told.value)


@pytest.mark.parametrize("mode", ["position", "velocity"])
def test_a_drive_that_takes_no_torques_is_refused_by_name(tmp_path: Path, mode: str) -> None:
    text = (ROOT / "robots/frankenstein.toml").read_text(encoding="utf-8")
    head, tail = text.split('name = "boom_drive"')
    (tmp_path / "own.toml").write_text(f'{head}name = "boom_drive"' + tail.replace('"torque"', f'"{mode}"', 1))
    told = rf"device 'boom_drive' of joint 'boom' has mode = \"{mode}\".*next: mode = \"torque\""
    with pytest.raises(demo.LitheError, match="(?s)" + told):
        demo.with_truth(tmp_path / "own.toml", demo.simulated_joints(tmp_path / "own.toml"))
    common = f'[defaults.device]\nkind = "cia402"\nmode = "{mode}"'
    (tmp_path / "all.toml").write_text(text.replace('mode = "torque"', "").replace("[defaults.device]", common))
    with pytest.raises(demo.LitheError, match=r"device 'column_drive' of joint 'column'"):
        demo.with_truth(tmp_path / "all.toml", demo.simulated_joints(tmp_path / "all.toml"))


def test_a_robot_whose_joints_hang_on_each_other_is_refused() -> None:
    with pytest.raises(demo.LitheError, match=r"chain\.toml has \[plant\] kind = \"chain\": .* each joint for itself"):
        demo.simulated_joints(ROOT / "robots/chain.toml")


def test_the_judge_finds_the_true_mgl(tmp_path: Path) -> None:
    assert demo.simulated_joints(ROOT / "robots/arm.toml") == [SimJoint("shoulder", 0.165, 1.0)]
    (tmp_path / "arm.toml").write_text("[defaults.joint.sim]\nmgl_nm = 0.3\n" + JOINT)
    (joint,) = demo.simulated_joints(tmp_path / "arm.toml")
    assert joint.mgl_nm == 0.3
    assert joint.most_share == pytest.approx(np.sin(1.35)), "nearer to its limits the agent takes it nowhere"
    (tmp_path / "arm.toml").write_text("[guard]\nsoft_stop_rad = 0.4\n[defaults.joint.sim]\nmgl_nm = 0.3\n" + JOINT)
    (joint,) = demo.simulated_joints(tmp_path / "arm.toml")
    assert joint.most_share == pytest.approx(np.sin(1.1)), "beyond, the guard lets it hold no weight"
    found = {joint.name: joint.mgl_nm for joint in demo.simulated_joints(ROOT / "robots/frankenstein.toml")}
    assert found == {"column": 0.0, "boom": 1.5, "shoulder": 0.8, "upper_arm": 0.8, "elbow": 0.8, "wrist": 0.165,
                     "hand": 0.0}  # fmt: skip


def test_the_truth_is_what_the_seed_drew_in_the_torque_that_the_drive_tells(robot_file: Path) -> None:
    (joint,) = demo.with_truth(robot_file, demo.simulated_joints(robot_file))
    assert 0.165 / 1.05 < joint.mgl_nm < (0.165 + 0.01 * 9.81 * 0.15) / 0.95 and joint.mgl_nm != 0.165
    text = robot_file.read_text(encoding="utf-8")
    robot_file.write_text(text.replace("ideal = false ", "ideal = true "), encoding="utf-8")
    assert demo.with_truth(robot_file, demo.simulated_joints(robot_file)) == [SimJoint("shoulder", 0.165, 1.0)]
    robot_file.write_text(text.replace("seed = 1 ", 'seed = "x" '), encoding="utf-8")
    with pytest.raises(demo.LitheError, match="seed"):
        demo.with_truth(robot_file, [joint])


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGKILL, -signal.SIGKILL)])
def test_an_ended_experiment_leaves_nothing_behind(tmp_path: Path, robot_file: Path, number: int, code: int) -> None:
    process = run(tmp_path / "out", robot_file)
    run_until(process, "phase: baseline")
    process.send_signal(number)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == code, told
    deadline = time.monotonic() + 30  # a killed demo's robot stops by itself, a little later
    while leftovers(process.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert leftovers(process.pid) == []


def test_binaries_that_are_not_built_are_named(tmp_path: Path) -> None:
    process = run(tmp_path / "out", ROOT / "robots/arm.toml", LITHE_BIN_DIR=str(tmp_path))
    words, _ = process.communicate(timeout=60)
    assert process.returncode == 1 and "is not built" in words and "make" in words and "Traceback" not in words


def test_a_full_disk_is_named_before_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "NEEDED_BYTES", 1 << 60)
    with pytest.raises(demo.LitheError, match="free some"):
        demo.prepare(tmp_path)


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    process = run(tmp_path / "file" / "out", ROOT / "robots/arm.toml")
    words, _ = process.communicate(timeout=60)
    assert process.returncode == 1 and "cannot write to" in words and "Traceback" not in words


@pytest.mark.parametrize("deceleration", [5.0, 20.0, 1000.0])
def test_the_freeze_begins_where_the_setpoint_will_end_at_the_centre(deceleration: float) -> None:
    sine = {"amplitude_rad": [np.pi / 4], "frequency_hz": 0.5, "since_ns": 10**9}
    phase = experiment.freeze_phase_rad(sine, np.array([deceleration]))
    assert np.pi / 2 <= phase < np.pi, "on its way down"
    for after_ns in (0, 10**9, 10**10 + 7):
        at_ns = experiment.next_at(sine, phase, after_ns)
        assert max(after_ns, 10**9) <= at_ns <= max(after_ns, 10**9) + 2 * 10**9
        assert np.cos(np.pi * (at_ns - 10**9) * 1e-9 - phase) == pytest.approx(1.0)


@pytest.mark.parametrize("module", [agent, moves, sources])
def test_nothing_of_the_plant_is_in_the_agent(module: ModuleType) -> None:
    text = Path(str(module.__file__)).read_text(encoding="utf-8")
    assert "toml" not in text and "0.165" not in text and "2.55" not in text and "0.0132" not in text


def test_the_agent_waits_for_rest() -> None:
    t_s = np.arange(0, 2, 0.001)
    moving = agent.Motion(t_s, 0.1 * np.sin(20 * t_s), 0 * t_s, 0 * t_s)
    resting = agent.Motion(t_s, np.where(t_s < 1.6, 0.1 * np.sin(20 * t_s), 0.02), 0 * t_s, 0 * t_s)
    assert not agent.rests(moving) and agent.rests(resting)
