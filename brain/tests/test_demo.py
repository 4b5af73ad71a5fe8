# SPDX-License-Identifier: Apache-2.0
"""The whole experiment as `make demo` runs it, on the patient robot; and the ways it may not even begin."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import calm
import numpy as np
import pytest
from lithe.demo import __main__ as demo
from lithe.demo import agent
from system.house import BIN, ROOT, need


def run(out: Path, robot: Path, *words: str, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "lithe.demo", "--out", str(out), "--robot", str(robot), *words],
        env=os.environ | {"PYTHONPATH": str(ROOT / "brain"), "LITHE_BIN_DIR": str(BIN)} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.fixture
def robot_file(tmp_path: Path) -> Path:
    need("lithe", "lithe-spine", "lawd")
    path = tmp_path / "arm.toml"
    path.write_text(calm.calm_text(), encoding="utf-8")
    return path


def leftovers(pid: int) -> list[str]:
    """Segments; a killed robot's empty lock files stay."""
    return [path.name for path in Path("/dev/shm").glob(f"lithe-demo-{pid}.*") if path.suffix != ".lock"]


def test_the_experiment_holds_from_baseline_to_a_new_brain(tmp_path: Path, robot_file: Path) -> None:
    process = run(tmp_path / "out", robot_file)
    words, _ = process.communicate(timeout=240)
    assert process.returncode == 0, words
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["verdict"] == "holds" and summary["records_lost"] == 0
    assert summary["mgl_error"] < 0.05
    assert summary["freeze"]["gravity_share"] > 0.9
    assert [swap["law"] for swap in summary["swaps"]] == ["detuned_pd", "probe_1", "probe_2", "gravity_only", "evolved"]
    assert all(swap["output_step_nm"] <= summary["output_step_bound_nm"] * 1.001 for swap in summary["swaps"])
    for name in ("telemetry.npz", "telemetry.csv", "timing.png", "timeline.png", "evolved.cpp", "log.txt"):
        assert (tmp_path / "out" / name).stat().st_size > 0
    assert leftovers(process.pid) == []


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGKILL, -signal.SIGKILL)])
def test_an_ended_experiment_leaves_nothing_behind(tmp_path: Path, robot_file: Path, number: int, code: int) -> None:
    process = run(tmp_path / "out", robot_file)
    assert process.stdout is not None
    while "phase: baseline" not in (line := process.stdout.readline()):
        assert line, "it ended early"
    process.send_signal(number)
    process.communicate(timeout=60)
    assert process.returncode == code
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
        demo.check_space(tmp_path)


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    process = run(tmp_path / "file" / "out", ROOT / "robots/arm.toml")
    words, _ = process.communicate(timeout=60)
    assert process.returncode == 1 and "cannot write to" in words and "Traceback" not in words


@pytest.mark.parametrize("deceleration", [5.0, 20.0, 1000.0])
def test_the_freeze_begins_where_the_setpoint_will_end_at_the_centre(deceleration: float) -> None:
    angle = demo.freeze_angle_rad(deceleration)
    assert agent.SINE["centre_rad"] < angle <= agent.SINE["centre_rad"] + agent.SINE["amplitude_rad"] + 1e-12


def test_nothing_of_the_plant_is_in_the_agent() -> None:
    text = Path(agent.__file__).read_text(encoding="utf-8")
    assert "toml" not in text and "0.165" not in text and "2.55" not in text and "0.0132" not in text


def test_the_agent_waits_for_rest() -> None:
    t_s = np.arange(0, 2, 0.001)
    moving = agent.Motion(t_s, 0.1 * np.sin(20 * t_s), 0 * t_s, 0 * t_s)
    resting = agent.Motion(t_s, np.where(t_s < 1.6, 0.1 * np.sin(20 * t_s), 0.02), 0 * t_s, 0 * t_s)
    assert not agent.rests(moving) and agent.rests(resting)
