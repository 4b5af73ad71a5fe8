# SPDX-License-Identifier: Apache-2.0
"""`make demo AGENT=llm LLM_URL=... MODEL=...`: the demo's phases, with laws that a language model's server wrote."""

import json
import os
import shlex
import subprocess
from pathlib import Path

import calm
import pytest
from model_server import ModelServer, fenced, law
from system.robot_rig import BIN, ROOT

WRONG = law("u.torque_nm[j] = -2.0 * e - 0.05 * de;", "wrong_sign")
GOOD = law("u.torque_nm[j] = 0.165 * std::sin(t.position_rad[j]) + 6.0 * e + 0.15 * de;", "good")


def command_of(url: str) -> list[str]:
    """What `make demo` would run, without building anything."""
    words = ["make", "-n", "demo", "AGENT=llm", f"LLM_URL={url}", "MODEL=coder"]
    said = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True).stdout.replace("\\\n", " ")
    return shlex.split(next(line for line in said.splitlines() if "-m lithe.demo " in line))


def test_make_hands_server_and_model_on() -> None:
    words = command_of("http://127.0.0.1:1/v1")
    assert words[words.index("--llm-url") + 1] == "http://127.0.0.1:1/v1"
    assert words[words.index("--model") + 1] == "coder"


@pytest.mark.long
def test_the_demo_tracks_with_the_law_that_a_model_wrote(tmp_path: Path) -> None:
    robot = tmp_path / "arm.toml"
    robot.write_text(calm.calm_text(), encoding="utf-8")
    with ModelServer(["I would raise the gains.", fenced(WRONG), {"status": 500}, fenced(GOOD)]) as server:
        done = subprocess.run(
            [*command_of(server.url), "--robot", robot, "--out", tmp_path / "out"],
            cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT / "brain"), "LITHE_BIN_DIR": str(BIN)},
            check=False, capture_output=True, text=True, timeout=300,
        )  # fmt: skip
    assert "verdict" in done.stdout, done.stdout + done.stderr
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert calm.falls_short(summary) == [], done.stdout
    rmse_deg = {phase["name"]: phase["rmse_deg"] for phase in summary["phases"]}
    assert rmse_deg["evolved"] * 8 <= rmse_deg["baseline"]
    assert "good" in [swap["law"] for swap in summary["swaps"]]
    assert '"good"' in (tmp_path / "out/evolved.cpp").read_text()
    [folder] = (tmp_path / "agent").iterdir()
    lines = [json.loads(line) for line in (folder / "transcript.jsonl").read_bytes().splitlines()]
    verdicts = [line["verdict"] for line in lines if line["kind"] == "generation"]
    assert verdicts[:4] == ["confirmed", "no_code", "trial_failed", "confirmed"]
