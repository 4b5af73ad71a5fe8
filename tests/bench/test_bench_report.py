# SPDX-License-Identifier: Apache-2.0
"""The bench never passes what it could not measure, and never shows a number for it."""

import importlib
import json
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
GOOD = {
    "jitter_stolen_share": 0.0,
    "floor_preempted_share": 0.0,
    "release_jitter_p999_over_floor": 1.02,
    "release_jitter_p99_over_floor": 1.0,
    "release_jitter_p999_over_cyclictest": 0.1,
    "release_jitter_p50_over_cyclictest": 0.2,
    "handoff_p50_us": 0.02,
    "handoff_p999_us": 0.9,
    "floor_p50_us": 0.03,
    "jitter_control_failed_as_it_must": True,
}


@pytest.fixture
def report(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT))
    module = importlib.import_module("bench.report")
    monkeypatch.setattr(module, "OUT", tmp_path)
    return module


def runs(report: ModuleType, monkeypatch: pytest.MonkeyPatch, *figures: dict[str, Any]) -> None:
    """What the programs will say, one after the other; the last one again and again."""
    left = list(figures)
    monkeypatch.setattr(report, "measure", lambda _: dict(left.pop(0) if len(left) > 1 else left[0]))


def summary(tmp_path: Path) -> dict[str, Any]:
    told: dict[str, Any] = json.loads((tmp_path / "summary.json").read_text())
    return told


def test_what_was_measured_is_told_with_its_machine(
    report: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs(report, monkeypatch, GOOD)
    assert report.main(["jitter"]) == 0
    told = summary(tmp_path)
    assert told["jitter_verdict"] == "measured"
    assert told["release_jitter_p999_over_floor"] == 1.02
    for key in ("cpu", "cores", "kernel", "governor", "isolated_cores", "virtual", "clock_source"):
        assert f"machine_{key}" in told
    assert {"jitter_load_before", "jitter_load_after", "jitter_measured_at"} <= told.keys()
    printed = capsys.readouterr().out
    assert f"{told['machine_cpu']}, {told['machine_cores']} cores" in printed
    assert "governor" in printed and "isolated cores" in printed and "load" in printed
    assert not any(isinstance(value, dict | list) for value in told.values()), "flat"


def test_every_run_is_kept_also_one_that_decides_nothing(
    report: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = GOOD | {"jitter_stolen_share": 0.4}
    for figures, code, number in ((bad, 1, 1), (GOOD, 0, 2), (bad, 1, 3)):
        runs(report, monkeypatch, figures)
        assert report.main(["jitter"]) == code
        assert summary(tmp_path)["jitter_runs"] == number
        assert f"run {number} of those in jitter.runs.jsonl" in capsys.readouterr().out
    kept = [json.loads(line) for line in (tmp_path / "jitter.runs.jsonl").read_text().splitlines()]
    assert [each["jitter_verdict"] for each in kept] == ["INCONCLUSIVE", "measured", "INCONCLUSIVE"]
    assert all(each["code"] and each["machine_cpu"] for each in kept)


def test_the_cores_of_the_benches_are_told_with_how_they_are_isolated(
    report: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those that LITHE_BENCH_CORES names, else as a robot's: an isolated one for the Spine where there is one."""
    allowed = sorted(os.sched_getaffinity(0))
    assert Path(report.program("cores")[0]).exists(), "make test builds bench_cores"
    if len(allowed) < 2:
        assert report.cores() == {}, "no bench runs on one core"
        pytest.skip("this process may use one core")
    monkeypatch.setenv("LITHE_BENCH_CORES", f"{allowed[-1]},{allowed[0]}")
    told = report.machine()
    assert (told["machine_spine_core"], told["machine_partner_core"]) == (allowed[-1], allowed[0])
    assert "isolated" in told["machine_spine_core_isolation"]
    assert "may land there" in told["machine_spine_core_interrupts"], "or that nobody knows"
    report.tables.show_machine(told | {"machine_spine_core_isolation": "isolated at boot (isolcpus)"})
    printed = capsys.readouterr().out
    assert f"the Spine's core: {allowed[-1]}, isolated at boot (isolcpus); its partner's" in printed
    assert f"the Spine's core: {told['machine_spine_core_interrupts']}\n" in printed
    monkeypatch.setenv("LITHE_BIN_DIR", "/nowhere")
    report.tables.show_machine(report.machine())
    assert "the Spine's core" not in capsys.readouterr().out


@pytest.mark.parametrize(
    "disturbance",
    [
        {"jitter_stolen_share": 0.06},
        {"floor_preempted_share": 0.46},
        {"jitter_stolen_share": None},
        {"jitter_control_failed_as_it_must": False},
    ],
    ids=str,
)
def test_a_disturbed_run_is_null(
    report: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    disturbance: dict[str, Any],
) -> None:
    runs(report, monkeypatch, GOOD | disturbance)
    assert report.main(["jitter"]) == 1
    told = summary(tmp_path)
    assert told["jitter_verdict"] == "INCONCLUSIVE"
    assert [told[claim] for claim in report.BENCHES["jitter"].claims] == [None] * 6
    assert next(iter(disturbance)) in told["jitter_reason"]
    assert "INCONCLUSIVE" in capsys.readouterr().out


def test_a_disturbed_run_is_not_repeated_until_one_is_quiet(
    report: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    runs(report, monkeypatch, GOOD | {"jitter_stolen_share": 0.2}, GOOD)
    assert report.main(["jitter"]) == 1
    assert summary(tmp_path)["jitter_verdict"] == "INCONCLUSIVE"


def test_a_missing_peer_makes_only_its_own_figure_null(
    report: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    runs(report, monkeypatch, GOOD | {"release_jitter_p999_over_cyclictest": None})
    assert report.main(["jitter"]) == 1
    told = summary(tmp_path)
    assert told["release_jitter_p999_over_cyclictest"] is None
    assert told["release_jitter_p999_over_floor"] == 1.02
    assert told["jitter_verdict"] == "INCONCLUSIVE"
    assert told["jitter_reason"] == "release_jitter_p999_over_cyclictest has no value"


def test_a_program_that_is_not_there_or_fails_is_no_number_and_no_end(
    report: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    lost = report.Bench(("/nowhere/bench_jitter",), print, ("handoff_p50_us",))
    fails = report.Bench((sys.executable, "-c", "raise SystemExit(2)"), print, ("channel_latency_over_pingpong",))
    works = report.Bench((sys.executable, "-c", """print('{"x": 1.5}')"""), print, ("x",))
    monkeypatch.setattr(report, "BENCHES", {"jitter": lost, "channel": fails, "cost": works})
    assert report.main([]) == 1
    told = summary(tmp_path)
    assert (told["handoff_p50_us"], told["channel_latency_over_pingpong"], told["x"]) == (None, None, 1.5)
    assert "/nowhere/bench_jitter: No such file" in told["jitter_reason"]
    assert "ended with 2" in told["channel_reason"]


def test_an_unknown_bench_is_a_usage_error(
    report: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report.main(["jitters"]) == 2
    told = "no bench 'jitters'; there are channel, jitter, cost, contain, scale, host, release, run"
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_partial_run_keeps_the_others_of_this_machine_only(
    report: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    cost = {f"tick_cost_p50_us_{n}j": 0.5 for n in (1, 8, 32)} | dict.fromkeys(report.COST_SHARES, 0.0)
    runs(report, monkeypatch, GOOD)
    report.main(["jitter"])
    runs(report, monkeypatch, cost)
    here = report.machine()
    moved = {"machine_spine_core_interrupts": "irqbalance has been here"}
    monkeypatch.setattr(report, "machine", lambda: here | moved)
    assert report.main(["cost"]) == 0
    assert summary(tmp_path)["floor_p50_us"] == 0.03
    assert summary(tmp_path)["tick_cost_p50_us_8j"] == 0.5
    monkeypatch.setattr(report, "machine", lambda: here | {"machine_kernel": "another"})
    assert report.main(["cost"]) == 0
    assert "floor_p50_us" not in summary(tmp_path)


def test_every_figure_that_scripts_read_is_claimed(report: ModuleType) -> None:
    claimed = {claim for bench in report.BENCHES.values() for claim in bench.claims}
    published = {
        "release_jitter_p999_over_floor",
        "release_jitter_p999_over_cyclictest",
        "channel_latency_over_pingpong",
        "tick_cost_p50_us_1j",
        "tick_cost_p50_us_8j",
        "tick_cost_p50_us_32j",
        "handoff_p50_us",
        "handoff_p999_us",
    }
    assert published - claimed == set()


def test_the_live_bench_reads_histograms_as_the_spine_fills_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    live = importlib.import_module("bench.live")
    np = importlib.import_module("numpy")
    bins = np.zeros(976, np.uint64)
    bins[31], bins[32], bins[64] = 500, 499, 1  # 31 ns, 32 ns, 64 and 65 ns
    assert [live.quantile_us(bins, q) for q in (0.5, 0.999, 1.0)] == [0.031, 0.032, 0.065]
