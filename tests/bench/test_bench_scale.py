# SPDX-License-Identifier: Apache-2.0
"""Codecs are compared on the same frames, in turns: one that writes others is no peer, an absent one is no number."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
TOLD = {"frames": ["0a", "0b"], "reads": [[1.0, 2.0], [3.0, 0.25]]}
CODEC = """
import json, sys
print(json.dumps(json.loads(sys.argv[1])), flush=True)
for i, _ in enumerate(sys.stdin):
    print(json.dumps({"encode_ns": float(sys.argv[2]) + i, "parse_ns": 7.0}), flush=True)
"""


@pytest.fixture
def scale(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("bench.scale")


def peer(scale: ModuleType, name: str, encode_ns: float, told: dict[str, Any] | None = None) -> Any:
    """A codec that says it takes so long, and a nanosecond more with each pass."""
    core = min(os.sched_getaffinity(0))
    return scale.Peer(name, core, [sys.executable, "-c", CODEC, json.dumps(told or TOLD), str(encode_ns)])


def test_each_round_asks_every_codec_and_the_middle_one_counts(scale: ModuleType) -> None:
    running = [peer(scale, "python", 1000.0), peer(scale, "lithe", 99.0)]
    figures = scale.compare(running, ["nobody"], 5)
    for each in running:
        each.close()
    counted = [[turn["encode_ns"] for turn in each.rounds] for each in running]
    assert counted == [[1001.0, 1003.0, 1005.0, 1007.0, 1009.0], [100.0, 102.0, 104.0, 106.0, 108.0]], "not the first"
    assert figures["codec_python_encode_ns"] == 1005.0 and figures["codec_lithe_encode_ns"] == 104.0
    assert figures["codec_python_over_lithe_encode"] == pytest.approx(1005 / 104)
    assert figures["codec_python_over_lithe_parse"] == 1.0
    assert (figures["codec_frames"], figures["codec_upstream_absent"]) == (2, "nobody")
    assert 0 < figures["codec_python_encode_spread"] < 0.06
    assert all(each.process.returncode == 0 for each in running), "they are ended"


def test_every_codec_lives_on_the_core_of_the_spine(scale: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    allowed = sorted(os.sched_getaffinity(0))
    monkeypatch.setattr(scale.report, "cores", dict)
    assert scale.core_of_the_spine() == allowed[-1], "where no program tells"
    monkeypatch.setattr(scale.report, "cores", lambda: {"machine_spine_core": float(allowed[0])})
    assert scale.core_of_the_spine() == allowed[0]
    asked: list[int] = []

    monkeypatch.setenv("LITHE_CODEC_PEER", "/another/codec")
    got = subprocess.CompletedProcess([], 0, "/nowhere\n", "")
    monkeypatch.setattr(scale.subprocess, "run", lambda *_, **__: got)
    with monkeypatch.context() as patched:
        one = peer(scale, "lithe", 1.0)
        patched.setattr(scale, "Peer", lambda name, core, *_: asked.append(core) or one)
        with scale.peers(Path("/nowhere")) as (running, _):
            assert asked == [allowed[0]] * 3 and len(running) == 3
            assert os.sched_getaffinity(one.process.pid) == {allowed[0]}, "where it was told to"


@pytest.mark.parametrize(
    ("twin", "why"),
    [
        ({"frames": ["0a", "0c"], "reads": TOLD["reads"]}, "different frames"),
        ({"frames": TOLD["frames"], "reads": [[1.0, 2.0], [3.0, 0.2501]]}, "different numbers"),
    ],
)
def test_a_codec_that_does_something_else_is_no_peer(scale: ModuleType, twin: dict[str, Any], why: str) -> None:
    running = [peer(scale, "python", 1.0), peer(scale, "lithe", 1.0, twin)]
    with pytest.raises(scale.report.Unmeasured, match=f"lithe against codec of python: they (write|read) {why}"):
        scale.compare(running, [], 3)
    for each in running:
        each.close()


def test_what_is_read_as_floats_is_the_same_number(scale: ModuleType) -> None:
    near = {"frames": TOLD["frames"], "reads": [[1.0, 2.0000001], [3.0, 0.25]]}
    assert scale.differences(TOLD, near) == ""


def test_a_codec_that_ends_early_is_named(scale: ModuleType) -> None:
    with pytest.raises(scale.report.Unmeasured, match="codec of lithe ended with 3"):
        scale.Peer("lithe", 0, [sys.executable, "-c", "raise SystemExit(3)"])


def quiet(scale: ModuleType) -> dict[str, Any]:
    """Figures of a whole run that nothing disturbed."""
    bench = scale.report.BENCHES["scale"]
    figures: dict[str, Any] = dict.fromkeys(bench.claims, 1.0) | dict.fromkeys(bench.most, 0.0)
    return figures | dict.fromkeys(bench.steady.values(), 0.05) | {"scale_control_failed_as_it_must": True}


@pytest.mark.parametrize("spread", [0.26, None, float("nan")])
def test_a_disturbed_comparison_of_codecs_is_null_and_costs_no_other_figure(
    scale: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, spread: float | None
) -> None:
    monkeypatch.setattr(scale.report, "OUT", tmp_path)
    disturbed = quiet(scale) | {"codec_python_encode_spread": spread}
    monkeypatch.setattr(scale.report, "measure", lambda _: dict(disturbed))
    assert scale.main([]) == 1
    told = json.loads((tmp_path / "scale.json").read_text())
    assert told["scale_verdict"] == "INCONCLUSIVE"
    assert told["codec_python_over_lithe_encode"] is None and told["codec_lithe_encode_ns"] is None
    assert told["codec_python_over_lithe_parse"] == 1.0 and told["exchange_32j_p50_us"] == 1.0
    assert "codec_python_encode_spread is" in told["scale_reason"]


def test_a_steady_comparison_of_codecs_is_measured(
    scale: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(scale.report, "OUT", tmp_path)
    monkeypatch.setattr(scale.report, "measure", lambda _: quiet(scale))
    assert scale.main([]) == 0
    told = json.loads((tmp_path / "scale.json").read_text())
    assert (told["scale_verdict"], told["codec_python_over_lithe_encode"]) == ("measured", 1.0)


def test_an_absent_codec_is_a_reason_and_no_number(
    scale: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("LITHE_BIN_DIR", str(tmp_path))
    figures = {claim: 1.0 for claim in scale.report.BENCHES["scale"].claims if not claim.startswith("codec")}
    figures |= dict.fromkeys(("scale_away_share", "scale_stolen_share", "scale_preempted_share"), 0.0)
    figures |= {
        "scale_unanswered_share": 0.0,
        "scale_resting_share": 0.0,
        "scale_control_failed_as_it_must": True,
        "codec_absent": "no network",
    }
    monkeypatch.setattr(scale.report, "OUT", tmp_path)
    monkeypatch.setattr(scale.report, "measure", lambda _: dict(figures))
    assert scale.main([]) == 1
    told = json.loads((tmp_path / "scale.json").read_text())
    assert told["codec_python_over_lithe_encode"] is None and told["exchange_32j_p50_us"] == 1.0
    assert "codec_lithe_encode_ns has no value" in told["scale_reason"] and "machine_cpu" in told
    printed = capsys.readouterr().out
    assert "not measured: no network" in printed and "32 joints" in printed


def test_only_what_there_is_can_be_asked_for(scale: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    assert scale.main(["--quick"]) == 2
    assert "--short" in capsys.readouterr().err


def test_a_short_run_says_so_and_takes_few_rounds(
    scale: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[tuple[str, ...]] = []
    monkeypatch.setattr(scale.report, "measure", lambda command: asked.append(command) or {"exchange_1j_p50_us": 1.0})
    monkeypatch.setattr(scale, "codecs", lambda rounds: {"rounds": rounds})
    assert scale.main(["--figures", "--short"]) == 0
    assert json.loads(capsys.readouterr().out) == {"scale_short": True, "exchange_1j_p50_us": 1.0, "rounds": 8}
    assert scale.main(["--figures"]) == 0
    assert [command[1:] for command in asked] == [("8", "1"), ("40", "6")]
