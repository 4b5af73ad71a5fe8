# SPDX-License-Identifier: Apache-2.0
"""The numbers of docs/rt.md can be measured: one short round, and what the kernel does not permit is a reason."""

import importlib
import json
import os
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from system.robot_rig import BIN, need

ROOT = Path(__file__).parents[2]
SHARES = ("grid_whole_late", "grid_moved_late", "nice_alone_skipped", "nice_ordinary_skipped", "stolen", "preempted")


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("bench.host")


def two_cores() -> None:
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("this process may use one core")


def test_one_round_is_measured(host: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    """No figure is judged: the machine that runs tests is busy with others."""
    two_cores()
    need("bench_host", "bench_cores")
    assert host.main(["--figures", "--short"]) == 0
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert told["host_short"] is True and not any(isinstance(value, dict | list) for value in told.values()), "flat"
    assert set(host.report.BENCHES["host"].claims) <= told.keys()
    assert set(host.report.BENCHES["host"].most) <= told.keys()
    for key in SHARES:
        assert 0 <= told[f"host_{key}_share"] <= 1, key
    assert told["host_touch_first_p50_us"] > told["host_touch_again_p50_us"] >= 0
    assert ("host_nice_raised_skipped_share" in told) == (told["host_nice_absent"] == "")
    assert ("host_session_raised_core_share" in told) == (told["host_session_absent"] == "")
    assert told["host_brain_one_threads"] == 1
    host.report.tables.show_host(told)
    assert "shifted by 500 us" in capsys.readouterr().out


@pytest.mark.alone  # it compares what a core gives to two
def test_who_may_not_have_nice_20_gets_the_reason_and_the_rest() -> None:
    two_cores()
    need("bench_host")
    words = [str(BIN / "bench_host"), "1"]
    if os.geteuid() == 0:
        words = ["setpriv", "--reuid=65534", "--clear-groups", *words]
        if subprocess.run([*words[:-2], "test", "-x", words[-2]], check=False).returncode != 0:
            pytest.skip("without privileges the programs of this checkout cannot be reached")
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=120)
    told = json.loads(done.stdout)
    if os.geteuid() != 0 and not told["host_nice_absent"]:
        pytest.skip("this user has the privilege of nice -20")
    assert told["host_nice_absent"] == "nice -20: Permission denied"
    assert "host_nice_raised_skipped_share" not in told and "host_session_raised_core_share" not in told
    assert told["host_nice_ordinary_skipped_share"] > 0.05, "half of the core was another's"
    assert told["host_touch_first_p50_us"] > 0


def test_a_brain_that_a_spine_slows_down_although_it_is_pinned_is_no_measurement(
    host: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The control: one thread on another core."""
    bench = host.report.BENCHES["host"]
    good = dict.fromkeys(bench.claims, 1.0) | dict.fromkeys(bench.most, 0.0)
    monkeypatch.setattr(host.report, "OUT", tmp_path)
    for one_slower, code in ((1.1, 0), (2.1, 1)):
        figures = good | {"host_brain_one_slower": one_slower}
        monkeypatch.setattr(host.report, "measure", lambda _, figures=figures: dict(figures))
        assert host.main([]) == code
        told = json.loads((tmp_path / "host.json").read_text())
        assert (told["host_brain_own_slower"] is None) == bool(code)
        assert "machine_spine_core_interrupts" in told or host.report.cores() == {}


def test_the_ratio_is_of_the_same_round(host: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    class Fake:
        told = 2

        def __init__(self, core: int | None) -> None:
            self.rates = iter([60.0, 5.0, 30.0, 2.0, 90.0, 6.0] if core is None else [25.0] * 6)

        def ask(self) -> float:
            return next(self.rates)

        def close(self) -> None:
            pass

    monkeypatch.setattr(host, "Brain", Fake)
    core = min(os.sched_getaffinity(0))
    told = host.brains({"machine_spine_core": core, "machine_partner_core": core}, 3)
    assert told["host_brain_own_slower"] == 15.0 and told["host_brain_one_slower"] == 1.0
    assert (told["host_brain_own_slower_least"], told["host_brain_own_slower_most"]) == (12.0, 15.0)
    assert told["host_brain_own_alone_per_s"] == 60.0
