# SPDX-License-Identifier: Apache-2.0
"""`lithe agent` on a simulated arm, with a model's server that fails in every way real ones do, and right at last."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from calm import calm_robot, connected
from lithe.agent.transcript import broken_at
from lithe.gateway import Gateway
from model_server import ModelServer, fenced, law, tool_call

WEAK = law("u.torque_nm[j] = 0.05 * e + 0.004 * de;", "weak")
MIDDLING = law("u.torque_nm[j] = 1.0 * e + 0.05 * de;", "middling")
GOOD = law("u.torque_nm[j] = 0.165 * std::sin(t.position_rad[j]) + 6.0 * e + 0.15 * de;", "good")
LATE = law("u.torque_nm[j] = (++s.steps > 1700) ? std::sqrt(-1.0 - e * e) : e + 0.05 * de;", "late", "int steps = 0;")
SCRIPT: list[Any] = [
    "The arm lags behind; I would raise the stiffness and add gravity compensation.",
    fenced(MIDDLING) + "or, simpler:\n" + fenced(WEAK),
    fenced(MIDDLING.replace("Tick& t, const Params&, State& s, lithe", "Tick& t, lithe").replace("(void)s;", "")),
    fenced("#include <vector>\n" + law("std::vector<double> gains(t.joints, 4.0); u.torque_nm[j] = gains[j] * e;")),
    fenced(law("u.torque_nm[j] = -2.0 * e - 0.05 * de;", "wrong_sign")),
    fenced(law("u.torque_nm[j] = 57.3 * (6.0 * e) + 0.15 * de;", "degrees")),
    fenced(law("while (e < 10.0) { u.torque_nm[j] = e; }", "endless")),
    fenced(LATE),
    fenced(law("u.torque_nm[j] = 1e6 * e + 2e4 * de;", "torque_limit")),
    {"finish": "length", "message": {"content": fenced(GOOD)[:300]}},
    json.dumps({"name": "propose_law", "arguments": {"source": MIDDLING}}),  # a tool call in the text
    {"status": 500},
    {"drop": True},
    tool_call({"source": WEAK.replace("0.05 *", "0.04 *")}),
    {"hang": 30},
    {"huge": True},
    fenced(GOOD),
]  # fmt: skip


def test_the_agent_meets_every_failure_and_keeps_the_best_law(tmp_path: Path) -> None:
    with calm_robot() as rig, ModelServer(SCRIPT) as server, connected() as robot:
        robot.call("swap", source=WEAK, name="weak.cpp", probation_s=0.0)
        gateway = Gateway(robot, token="sesame")
        gateway.start()
        (tmp_path / "token").write_text("sesame")
        words = [
            "--url", server.url, "--model", "coder", "--api", "openai", "--model-timeout", "3", "--token-file",
            tmp_path / "token", "--connect", f"127.0.0.1:{gateway.port}", "--goal", "track 1 Hz with the least error",
            "--window", "1", "--amplitude", "1", "--rounds", "14", "--failures", "20", "--out", tmp_path / "out",
        ]  # fmt: skip
        done = subprocess.run(
            [sys.executable, "-m", "lithe.agent", *map(str, words)],
            check=False, env=rig.env, capture_output=True, text=True, timeout=500,
        )  # fmt: skip
        gateway.close()
        status = robot.call("status")
    print(done.stdout[-6000:], done.stderr)
    assert done.returncode == 0, done.stdout + done.stderr
    assert status["mode"] == "active" and status["law"] == "good"
    [folder] = (tmp_path / "out").iterdir()
    lines = [json.loads(line) for line in (folder / "transcript.jsonl").read_bytes().splitlines()]
    assert broken_at(folder / "transcript.jsonl") is None
    tries = [line for line in lines if line["kind"] == "generation"]
    verdicts = {line["name"]: line["verdict"] for line in tries}
    assert [verdicts[f"agent_{n:03}.cpp"] for n in (1, 2, 3, 4)] == [
        "no_code", "several", "compile_failed", "admission_failed",
    ]  # fmt: skip
    failed = {line["error"] for line in lines if line["kind"] == "model_error"}
    assert failed == {"truncated", "http", "disconnected", "timeout", "too_long"}
    assert [line["number"] for line in tries if line["kept"]] == [0, 11, 14]
    assert tries[-1]["rmse_deg"][0] * 8 <= tries[0]["rmse_deg"][0]
    assert all(line["probation_s"] > 0 for line in lines if line["kind"] == "swap")
    assert "RMSE" in (folder / "report.md").read_text() and (folder / "best.cpp").exists()
