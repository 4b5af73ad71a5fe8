# SPDX-License-Identifier: Apache-2.0
"""A real soak: all holds that a short one can check, Ctrl-C ends it with the verdict so far, and it can go on."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from system.robot_rig import BIN, ROOT, need

pytestmark = pytest.mark.long  # it loads the machine on purpose


def soak(out: Path, *words: str) -> subprocess.Popen[str]:
    """`python -m tools.soak` of this tree."""
    need("lithe", "lithe-spine-sim", "lithe-sim", "lawd", "lithe-trial")
    env = os.environ | {"LITHE_BIN_DIR": str(BIN), "PYTHONPATH": str(ROOT / "brain")}
    command = [sys.executable, "-m", "tools.soak", "--out", str(out), *words]
    return subprocess.Popen(command, cwd=ROOT, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_soak_holds_can_be_interrupted_and_goes_on(tmp_path: Path) -> None:
    first = soak(tmp_path, "--seconds", "3600", "--seed", "11")
    assert first.stdout is not None
    assert "seed 11" in first.stdout.readline()
    first.stdout.readline()  # the first action begins
    state = tmp_path / "soak.state.json"
    while first.poll() is None and not (state.exists() and json.loads(state.read_text())["next"] >= 3):
        time.sleep(0.1)
    first.send_signal(signal.SIGINT)
    out, err = first.communicate(timeout=300)
    assert first.returncode == 0, out + err
    assert "held so far" in out
    done = json.loads((tmp_path / "soak.json").read_text())
    assert done["verdict"] == "interrupted" and done["next"] >= 3
    second = soak(tmp_path, "--resume", "--seconds", str(done["ran_s"] + 20))
    out, err = second.communicate(timeout=600)
    assert second.returncode == 1, out + err
    assert "not checked: growth (the memory of" in out, out + err
    told = json.loads((tmp_path / "soak.json").read_text())
    unchecked = [name for name, each in told["invariants"].items() if not each["checked"]]
    assert told["verdict"] == "incomplete" and unchecked == ["growth"], "growth needs a supervisor that lives 18 min"
    assert told["next"] > done["next"] and told["seed"] == 11
    assert sum(told["actions"].values()) >= sum(done["actions"].values())
    assert not list(Path("/dev/shm").glob("lithe-soak-*")), "nothing is left"
