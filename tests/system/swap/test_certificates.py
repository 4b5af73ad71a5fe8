# SPDX-License-Identifier: Apache-2.0
"""Certificates: shown to a person, and held against their chain, with a robot and without."""

import importlib
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from calm import calm_text
from lithe.certificates import verify
from lithe.errors import LitheError
from system.robot_rig import BIN, ROOT, RobotRig
from system.swapping import sway

HOSTILE = ROOT / "tests/laws_hostile"


@pytest.fixture(scope="module")
def ended() -> Iterator[RobotRig]:
    """A robot that has run, has swapped (pd; gravity_pd, refused twice, gravity_pd again) and has ended."""
    with RobotRig() as rig:
        rig.config = rig.dir / "arm.toml"
        rig.config.write_text(calm_text())
        rig.run()
        rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
        done = rig.ask("swap", "gravity_pd", "--probation", "200ms", "--blend", "10ms")
        path = swaps(rig) / "0002.json"
        sway(rig)
        rig.wait_for(lambda: {"measured", "confirmed"} <= {*(told := json.loads(path.read_text())), *told["times_ns"]})
        assert rig.ask("law", "show")["request_id"] == done["request_id"]
        rig.ask("swap", HOSTILE / "global_counter.cpp", code=1)
        rig.ask("swap", HOSTILE / "negative_damping.cpp", code=1)
        assert rig.ask("law", "verify")["holds"], "while the robot runs"
        rig.ask("stop")
        rig.started[0].wait(60)
        yield rig


def swaps(rig: RobotRig) -> Path:
    return rig.dir / "out/arm/swaps"


@pytest.fixture
def copy(ended: RobotRig, tmp_path: Path) -> Path:
    """Its certificates, to be spoilt."""
    return Path(shutil.copytree(swaps(ended), tmp_path / "swaps"))


def test_a_certificate_is_shown_with_all_that_the_swap_was(ended: RobotRig) -> None:
    """Without a robot: the files are enough."""
    shown = ended.lithe("law", "show", "gravity_pd").stdout
    told = json.loads((swaps(ended) / "0002.json").read_text())
    assert shown.startswith("0002.json: law gravity_pd, confirmed\n")
    rows = dict(line.strip().split(maxsplit=1) for line in shown.splitlines()[1:])
    assert told["source_sha256"] in rows["source"] and "g++" in rows["toolchain"] and "-O2" in rows["flags"]
    assert rows["took"].startswith(f"{told['requested_to_committed_ms']:.1f} ms")
    assert all(f"{stage} {ms:.1f}" in rows["took"] for stage, ms in told["split_ms"].items())
    assert rows["gates"] == "13 of 13 passed"
    timing = told["trial"]["report"]["timing"]
    assert f"at most {timing['worst_ns']:.0f} ns" in rows["trial"] and f"of {timing['budget_ns']}" in rows["trial"]
    assert f"at tick {told['commit_tick']} " in rows["committed"]
    for name in ("first call", "Spine's core", "jitter", "hand-off", "largest step"):
        assert f"  {name}  " in shown
    assert f"{told['measured']['after']['slew_bound_nm']:.4f} allowed" in shown
    assert rows["blend"] == "10 ms" and rows["probation"] == "0.2 s: passed"


def test_json_gives_the_file(ended: RobotRig) -> None:
    """Byte for byte: what a program reads is what the chain covers."""
    for which, name in (("2", "0002.json"), ("gravity_pd.cpp", "0002.json"), ("last", "0004.json")):
        assert ended.lithe("--json", "law", "show", which).stdout == (swaps(ended) / name).read_text()


def test_the_text_of_a_law_is_shown_as_it_was_sent(ended: RobotRig) -> None:
    text = (ROOT / "laws/gravity_pd.cpp").read_text()
    assert ended.lithe("law", "show", "gravity_pd", "--source").stdout == text
    shown = json.loads(ended.lithe("--json", "law", "show", "gravity_pd", "--source").stdout)
    assert shown == {"source": text}


def test_a_refused_law_is_shown_with_its_reason(ended: RobotRig) -> None:
    """At which stage, why, and what to do next."""
    shown = ended.lithe("law", "show", "global_counter").stdout
    assert "refused       after submitted, admission_failed: " in shown and "12 of 13 passed; memory: " in shown
    shown = ended.lithe("law", "show", "last").stdout
    assert "trial         refused in " in shown and "next          " in shown


def test_what_is_not_there_is_refused_with_a_way_on(ended: RobotRig, tmp_path: Path) -> None:
    """Nothing is shown, exit 1."""
    for words in (("show", "99"), ("show", "no_such_law"), ("verify", "--folder", str(tmp_path))):
        assert ended.ask("law", *words, code=1)["error"]["code"] == "no_certificates"


def change(folder: Path) -> str:
    """A verdict that somebody would like better."""
    path = folder / "0004.json"
    path.write_text(path.read_text().replace('"refused"', '"confirmed"'))
    return "changed 0004.json"


def remove(folder: Path) -> str:
    """A swap that somebody would rather not have made."""
    (folder / "0003.json").unlink()
    return "missing 0003.json"


def add(folder: Path) -> str:
    """A swap that never was."""
    shutil.copy(folder / "0002.json", folder / "0005.json")
    return "extra 0005.json"


def lines_of(folder: Path) -> list[str]:
    return (folder / "chain.jsonl").read_text().splitlines(keepends=True)


def remove_line(folder: Path) -> str:
    """A removed line: the one after it does not follow any more."""
    lines = lines_of(folder)
    (folder / "chain.jsonl").write_text("".join(lines[:3] + lines[4:]))
    return f"order {json.loads(lines[4])['file']}"


def reorder(folder: Path) -> str:
    """Two lines that changed places."""
    lines = lines_of(folder)
    (folder / "chain.jsonl").write_text("".join([*lines[:3], lines[4], lines[3], *lines[5:]]))
    return f"order {json.loads(lines[4])['file']}"


@pytest.mark.parametrize("tamper", [change, remove, add, remove_line, reorder])
def test_the_chain_tells_what_was_done_to_it(copy: Path, ended: RobotRig, tamper: Callable[[Path], str]) -> None:
    """Exit 1, file and kind named; the same from Python."""
    whole = ended.ask("law", "verify", "--folder", copy)
    assert whole["holds"] and whole["certificates"] == 4 and whole["writings"] == len(lines_of(copy))
    expected = tamper(copy)
    told = ended.ask("law", "verify", "--folder", copy, code=1)
    assert not told["holds"] and expected in [f"{each['what']} {each['file']}" for each in told["problems"]]
    shown = ended.lithe("law", "verify", "--folder", copy)
    assert shown.returncode == 1 and "THE CHAIN IS BROKEN" in shown.stdout and expected.split()[1] in shown.stdout
    chain = verify(copy)
    assert not chain.holds and expected.split()[1] in chain.broken


def test_python_verifies_what_is_whole_and_says_when_there_is_nothing(copy: Path, tmp_path: Path) -> None:
    """The same checker, so the same answer."""
    chain = verify(copy)
    assert chain.holds and chain.certificates == 4 and chain.cut == 0 and not chain.broken
    with pytest.raises(LitheError, match="there is no folder"):
        verify(tmp_path / "nowhere")


def test_the_bench_counts_no_certificate_that_was_tampered_with(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`make bench-swap` says certificates N of N: a forged one is not among them."""
    monkeypatch.syspath_prepend(str(ROOT))
    monkeypatch.setenv("LITHE_BIN_DIR", str(BIN))
    run = importlib.import_module("bench.swap.run")
    count: Callable[[Path, list[dict[str, Any]]], dict[str, int]] = run.certificates
    records = [json.loads((copy / f"{number:04}.json").read_text()) for number in (1, 2)]
    assert count(copy, records)["certificates"] == 2
    path = copy / "0002.json"
    path.write_text(path.read_text().replace('"cached"', '"cash"'))
    assert count(copy, records)["certificates"] == 1


def test_status_says_in_one_line_what_became_of_the_last_swap(arm: RobotRig) -> None:
    """Also what happens to it later; who looks at status or top need not look for the certificate."""

    def line() -> str:
        (found,) = [each.strip() for each in arm.lithe("status").stdout.splitlines() if "last swap" in each]
        return found

    assert line().startswith("last swap: pd co")  # mmitted or nfirmed
    arm.ask("swap", "gravity_pd", "--probation", "100ms")
    sway(arm)
    arm.wait_for(lambda: line().startswith("last swap: gravity_pd confirmed, "))
    error = arm.ask("swap", HOSTILE / "global_counter.cpp", code=1)["error"]
    assert line() == f"last swap: global_counter.cpp refused: {error['message']}"
    told = arm.ask("status")["last_swap"]
    assert told["request_id"] == error["detail"]["swap"]["request_id"] and told["refused_after"] == "submitted"
    arm.ask("swap", "gravity_pd", "--no-probation")
    arm.ask("rollback")
    arm.wait_for(lambda: line().startswith("last swap: gravity_pd rolled_back, "))
    assert line().endswith(": asked for")
    assert "last swap: gravity_pd rolled_back" in arm.lithe("top", "--turns", "1").stdout
