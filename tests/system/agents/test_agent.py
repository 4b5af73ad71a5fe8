# SPDX-License-Identifier: Apache-2.0
"""`lithe agent` on a simulated arm, with a model's server that fails in every way real ones do, and right at last."""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from calm import calm_robot, calm_text, connected
from inconclusive import inconclusive
from lithe._wire import Mode
from lithe.agent.transcript import broken_at
from lithe.gateway import Gateway
from lithe.heartbeat import Repeat
from lithe.shm import SpineView
from lithe.vocabulary import Tier
from model_server import ModelServer, fenced, law, tool_call
from system.simulated import running

WEAK = law("u.torque_nm[j] = 0.05 * e + 0.004 * de;", "weak")
MIDDLING = law("u.torque_nm[j] = 1.0 * e + 0.05 * de;", "middling")
GOOD = law("u.torque_nm[j] = 0.165 * std::sin(t.position_rad[j]) + 6.0 * e + 0.15 * de;", "good")
LATE = law("u.torque_nm[j] = (++s.steps > 1700) ? std::sqrt(-1.0 - e * e) : e + 0.05 * de;", "late", "int steps = 0;")


@dataclass(frozen=True)
class Met:
    """A kind of failure: what the server answers to one question and to those that repeat it, what becomes of it, at
    which stage the supervisor refused it, and the words of it that the next question must have.
    """

    answers: list[Any]
    verdict: str
    stage: str = ""
    words: tuple[str, ...] = ()
    kept: bool = False


SHORT = "Tick& t, lithe"
VECTOR = law("std::vector<double> gains(t.joints, 4.0); u.torque_nm[j] = gains[j] * e;")
ROUNDS = [
    Met(["The arm lags behind; I would raise the stiffness and add gravity compensation."], "no_code",
        words=("holds no code",)),
    Met([fenced(MIDDLING) + "or, simpler:\n" + fenced(WEAK)], "several", words=("holds 2 laws; which one is meant",)),
    Met([fenced(MIDDLING.replace("Tick& t, const Params&, State& s, lithe", SHORT).replace("(void)s;", ""))],
        "compile_failed", "compile", ("agent_003.cpp:5: a law has exactly one step()",)),
    Met([fenced("#include <vector>\n" + VECTOR)], "admission_failed", "admission", ("may not include <vector>",)),
    Met([fenced(law("u.torque_nm[j] = -2.0 * e - 0.05 * de;", "wrong_sign"))], "trial_failed", "trial",
        ("change the sign",)),
    Met([fenced(law("u.torque_nm[j] = 57.3 * (6.0 * e) + 0.15 * de;", "degrees"))], "trial_failed", "trial",
        ("swings to and fro", "subtract gain * velocity")),
    Met([fenced(law("while (e < 10.0) { u.torque_nm[j] = e; }", "endless"))], "dry_run_failed", "dry_run",
        ("agent_007.cpp:", "a loop without an end")),
    Met([fenced(LATE)], "trial_failed", "trial", ("replay: torque_nm[0] is not finite", "look for a division by zero")),
    Met([fenced(law("u.torque_nm[j] = 1e6 * e + 2e4 * de;", "torque_limit"))], "trial_failed", "trial",
        ("lower the stiffness",)),
    Met([{"finish": "length", "message": {"content": fenced(GOOD)[:300]}}], "truncated", words=("limit of tokens",)),
    Met([json.dumps({"name": "propose_law", "arguments": {"source": MIDDLING}})], "confirmed", kept=True),
    Met([{"status": 500}, {"drop": True}, tool_call({"source": WEAK.replace("0.05 *", "0.04 *")})], "rolled_back",
        words=("tracking_lost: joint shoulder", "Next: make the law follow its setpoint better")),
    Met([{"hang": 30}, {"huge": True}], "too_long", words=("longer than 1024 KiB",)),
    Met([fenced(GOOD)], "confirmed", kept=True),
]  # fmt: skip


def prompt_after(server: ModelServer, number: int) -> str:
    """The first question that tells what became of that generation."""
    told = (asked["messages"][1]["content"] for asked in server.asked)
    return next(one for one in told if f"- generation {number}: " in one)


def modes_seen(cursor: Any, seen: set[int]) -> None:
    records = cursor.drain()
    seen.update(int(mode) for mode in records["mode"])


def run_agent(rig: Any, gateway: Gateway, server: ModelServer, tmp_path: Path, *more: str) -> tuple[Any, list[Any]]:
    """The program to its end, and its transcript."""
    (tmp_path / "token").write_text("sesame")
    words = [
        "--url", server.url, "--model", "coder", "--api", "openai", "--model-timeout", "3", "--token-file",
        tmp_path / "token", "--connect", f"127.0.0.1:{gateway.port}", "--goal", "track 1 Hz with the least error",
        "--window", "1", "--amplitude", "1", "--out", tmp_path / "out", *more,
    ]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "lithe.agent", *map(str, words)],
        check=False, env=rig.env, capture_output=True, text=True, timeout=500,
    )  # fmt: skip
    print(done.stdout[-8000:], done.stderr)
    [folder] = (tmp_path / "out").iterdir()
    assert broken_at(folder / "transcript.jsonl") is None
    return done, [json.loads(line) for line in (folder / "transcript.jsonl").read_bytes().splitlines()]


def test_the_agent_meets_every_failure_and_keeps_the_best_law(tmp_path: Path) -> None:
    script = [answer for each in ROUNDS for answer in each.answers]
    seen: set[int] = set()
    with calm_robot() as rig, ModelServer(script) as server, connected() as robot:
        robot.call("swap", source=WEAK, name="weak.cpp", probation_s=0.0)
        gateway = Gateway(robot, token="sesame", tier=Tier.person)
        gateway.start()
        cursor = SpineView("arm").telemetry()
        look = Repeat(lambda: modes_seen(cursor, seen), 0.2)
        done, lines = run_agent(rig, gateway, server, tmp_path, "--rounds", str(len(ROUNDS)), "--failures", "20")
        look.stop()
        gateway.close()
        status = robot.call("status")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "reference: sine 1 Hz, from the goal's text" in done.stdout
    assert status["mode"] == "active" and status["law"] == "good"
    tries = {line["number"]: line for line in lines if line["kind"] == "generation"}
    refused = {line["name"]: line for line in lines if line["kind"] == "refused"}
    starved = ""
    for number, met in enumerate(ROUNDS, 1):
        one, name = tries[number], f"agent_{number:03}.cpp"
        if one["verdict"] == "compile_starved":
            starved = one["said"]
            continue
        assert (one["verdict"], one["kept"]) == (met.verdict, met.kept), one
        assert refused.get(name, {}).get("detail", {}).get("stage", "") == met.stage, refused.get(name)
        if number < len(ROUNDS):
            told = prompt_after(server, number)
            part = told[told.index(f"- generation {number}: ") :]
            assert met.verdict in part, part
            for words in met.words:
                assert words in part, (words, part)
    assert seen == {int(Mode.active)}, "whatever was answered, the robot stayed active"
    failed = {line["error"] for line in lines if line["kind"] == "model_error"}
    assert failed == {"truncated", "http", "disconnected", "timeout", "too_long"}
    best, start = (tries[number]["measured"]["rms_deg"][0] for number in (len(ROUNDS), 0))
    assert best * 8 <= start
    assert all(line["probation_s"] > 0 for line in lines if line["kind"] == "swap")
    [folder] = (tmp_path / "out").iterdir()
    assert "RMS error" in (folder / "report.md").read_text() and (folder / "best.cpp").exists()
    if starved:
        inconclusive(starved)


# Both laws fail far out; the second, once its probation is over, pushes there: so neither can take over from the other.
# Not in their first 5 s: a trial repeats what the robot has just done.
FAR = "t.t_s > 5 && std::abs(t.position_rad[j]) > 2.6 ? std::sqrt(-1.0 - e * e) : "
BRITTLE = law(f"u.torque_nm[j] = {FAR} 0.05 * e + 0.004 * de;", "brittle")
PUSHES = law(f"u.torque_nm[j] = {FAR} (++s.steps > 7000) ? 1.0 : e + 0.05 * de;", "pushes", "int steps = 0;")


def test_a_law_that_stops_the_robot_is_told_to_the_model_and_verbs_bring_the_robot_back(tmp_path: Path) -> None:
    script = [fenced(PUSHES), {"hang": 2.5}, {"hang": 2.5}, fenced(MIDDLING), fenced(GOOD)]
    with calm_robot() as rig, ModelServer(script) as server, connected() as robot:
        robot.call("swap", source=BRITTLE, name="brittle.cpp", probation_s=0.0)
        gateway = Gateway(robot, token="sesame", tier=Tier.person)
        gateway.start()
        done, lines = run_agent(rig, gateway, server, tmp_path, "--rounds", "3")
        gateway.close()
        status = robot.call("status")
    assert done.returncode == 0, done.stdout + done.stderr
    assert status["mode"] == "active" and status["law"] == "good"
    [demoted] = [line for line in lines if line["kind"] == "demoted"]
    assert demoted["number"] == 1 and demoted["verdict"] == "stopped" and not demoted["kept"]
    verdicts = [line["verdict"] for line in lines if line["kind"] == "generation"]
    assert verdicts == ["confirmed", "confirmed", "stopped", "confirmed"]
    assert BRITTLE in server.asked[0]["messages"][1]["content"], "the text of the law at the start"
    assert [line["verb"] for line in lines if line["kind"] == "way_back"][:3] == ["reset", "activate", "arm"]
    told = prompt_after(server, 2)
    part = told[told.index("- generation 1: ") :]
    for words in ("stopped", "law_not_finite", "joint shoulder", "look for a division by 0", "generation 2"):
        assert words in part, (words, part)


@pytest.mark.long
def test_of_a_chain_the_coupled_model_reaches_the_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running(calm_text(robot="chain"), monkeypatch) as (rig, robot), ModelServer(["no law"]) as server:
        gateway = Gateway(robot, token="sesame", tier=Tier.person)
        gateway.start()
        done, _ = run_agent(rig, gateway, server, tmp_path, "--rounds", "1", "--window", "12", "--goal", "be calm")
        gateway.close()
    assert done.returncode == 4 and "reference: sine 0.5 Hz, the default" in done.stdout, done.stdout + done.stderr
    told = server.asked[0]["messages"][1]["content"]
    assert "The joints are coupled" in told and '"be calm"' in told
    found = [json.loads(json.loads(line[5:])) for line in told.splitlines() if "moment_kg_m" in line]
    assert [one["joint"] for one in found] == ["shoulder", "elbow", "wrist"]
    for one, moment_kg_m in zip(found, (0.1385, 0.0485, 0.0048), strict=True):  # of the file's links
        assert abs(one["moment_kg_m"] - moment_kg_m) < 0.05 * moment_kg_m, one
