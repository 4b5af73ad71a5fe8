# SPDX-License-Identifier: Apache-2.0
"""The bench never passes what it could not measure."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def report() -> ModuleType:
    path = Path(__file__).parents[2] / "bench/report.py"
    spec = importlib.util.spec_from_file_location("report", path)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_disturbed_run_is_repeated_and_then_inconclusive(report: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "measure", lambda _: {"jitter_stolen_share": 0.06, "floor_preempted_share": 0.0})
    figures = report.measure_jitter()
    assert (figures["jitter_verdict"], figures["jitter_attempts"]) == ("INCONCLUSIVE", 3)


def test_a_core_that_others_use_is_a_disturbed_run(report: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "measure", lambda _: {"jitter_stolen_share": 0.0, "floor_preempted_share": 0.46})
    assert report.measure_jitter()["jitter_verdict"] == "INCONCLUSIVE"


def test_the_first_quiet_run_counts(report: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    shares = iter([0.2, 0.01])
    monkeypatch.setattr(
        report, "measure", lambda _: {"jitter_stolen_share": next(shares), "floor_preempted_share": 0.0}
    )
    figures = report.measure_jitter()
    assert (figures["jitter_verdict"], figures["jitter_attempts"]) == ("measured", 2)


def test_a_control_that_does_not_fail_fails_the_bench(
    report: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = {"cost_control_failed_as_it_must": True}
    good |= {f"tick_cost_{n}j_{q}_us": 1.0 for n in (1, 8, 32) for q in ("p50", "p99", "p999", "max")}
    monkeypatch.setattr(report, "OUT", tmp_path)
    monkeypatch.setattr(report, "ROOT", tmp_path)
    monkeypatch.setattr(report.sys, "argv", ["report.py", "cost"])
    monkeypatch.setattr(report, "measure", lambda _: good)
    assert report.main() == 0
    monkeypatch.setattr(report, "measure", lambda _: good | {"cost_control_failed_as_it_must": False})
    assert report.main() == 1
    assert "prove nothing" in capsys.readouterr().err
