# SPDX-License-Identifier: Apache-2.0
"""`make bench-isolation`: figures tell what is there, each rule of the verdict can fail, missing programs are named."""

import json
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from isolation_records import module, records

ROOT = Path(__file__).parents[2]
NAMES = ["stress", "numpy", "compile", "swap", "idle"]
LIMITS_US = (1, 5, 20, 100)
ROGUE = ("rogue_threads", "rogue_may_use", "rogue_ran_on")


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return module("figures", monkeypatch)


@pytest.fixture
def verdict(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return module("verdict", monkeypatch)


@pytest.fixture
def table(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return module("table", monkeypatch)


def good() -> dict[str, Any]:
    """Figures of a run in which every claim holds."""
    told: dict[str, Any] = {"control_over_floor": 900.0, "shielded": True, "loads_log": "loads.log"}
    told |= {"rig_offers": 100, "second_robot_swaps": 20, "rounds_swap": 20, "rogue_looks": 900}
    told |= {"machine_irq_time_accounting": False, "untraced_blocks": 100}
    for name in NAMES:
        told |= {f"steal_share_kernel_{name}": 0.01}
        told |= {f"steal_share_{name}": 0.01, f"floor_preempted_share_{name}": 0.001, f"cycles_{name}": 60_000}
        told |= {f"r999_floor_{name}": 1.0, f"r999_floor_{name}_low": 0.9, f"r999_floor_{name}_high": 1.05}
        told |= {f"r999_cyclictest_{name}": 0.03, f"r999_plain_loop_{name}": 0.01, f"load_ended_{name}": False}
        told |= {f"cycles_cyclictest_{name}": 60_000, f"cycles_plain_loop_{name}": 10_000}
        told |= {f"r999_cyclictest_{name}_high": 0.09, f"r999_plain_loop_{name}_high": 0.02}
        told |= {f"r999_cyclictest_{name}_low": 0.01, f"r999_plain_loop_{name}_low": 0.005}
        for limit_us in LIMITS_US:
            key = f"late_{name}_over_{limit_us}us_difference"
            told |= {key: 0.0, f"{key}_low": -0.0004, f"{key}_high": 0.0004}
    return told


def test_a_good_run_holds(verdict: ModuleType) -> None:
    assert verdict.judge(good(), NAMES) == {"verdict": "holds", "reason": "", "conclusive_with": ""}


def test_a_run_of_some_workloads_is_inconclusive(monkeypatch: pytest.MonkeyPatch, verdict: ModuleType) -> None:
    told = verdict.judge(good(), ["stress", "idle"])
    assert (told["verdict"], told["reason"]) == ("INCONCLUSIVE", "not measured: numpy, compile, swap")
    run = module("run", monkeypatch)
    assert run.plan_of(run.options(["--workload", "swap", "--workload", "swap"])).workloads == ["swap"]


def test_the_papers_form_has_its_number_of_cycles_of_each_program(monkeypatch: pytest.MonkeyPatch) -> None:
    run = module("run", monkeypatch)
    plan = run.plan_of(run.options(["--paper"]))
    assert plan.rounds * plan.pairs * 500 == plan.rounds * round(plan.peer_s) * 1000 == 300_000


@pytest.mark.parametrize(
    ("bad", "named", "remedy"),
    [
        ({"steal_share_stress": 0.06}, "stress: 6.0% stolen", "bare metal"),
        ({"steal_share_kernel_numpy": 0.06}, "numpy: 6.0% stolen by the hypervisor, as the kernel", "bare metal"),
        ({"steal_share_idle": math.nan}, "idle: nan% stolen", "bare metal"),
        ({"floor_preempted_share_idle": 0.06}, "idle: 6.0% of the floor preempted", "lithe tune plan"),
        ({"floor_preempted_share_idle": 0.06, "shielded": False}, "preempted", "--shield"),
        ({"control_over_floor": 19.0}, "the negative control did not fail", "lithe tune plan"),
        ({"control_over_floor": None, "shielded": False}, "the negative control did not fail", "--shield"),
        ({"cycles_stress": 9_999}, "stress: 9999 cycles, 10000 are needed", "--paper"),
        ({"cycles_plain_loop_swap": 9_999}, "swap: 9999 cycles of plain_loop, 10000 are needed", "--paper"),
        ({"cycles_cyclictest_idle": None}, "idle: nan cycles of cyclictest", "--paper"),
        (
            {"r999_cyclictest_stress": None, "cyclictest_absent": "it is missing"},
            "stress: no cyclictest (it is missing)",
            "apt-get install -y --no-install-recommends rt-tests",
        ),
        ({"r999_plain_loop_idle": None}, "idle: no plain_loop", "make bench-isolation"),
        ({"rogue_looks": 0}, "numpy: the rogue program was not seen to run", "loads.log"),
        ({"rogue_ended": True}, "numpy: the rogue program was not seen to run", "loads.log"),
        ({"load_ended_stress": True}, "stress: the load ended by itself", "loads.log"),
        ({"shield_lost_swap": True}, "swap: the shield was lowered during the run", "measure again"),
    ],
)
def test_a_disturbed_run_is_inconclusive_and_says_what_would_help(
    verdict: ModuleType, bad: dict[str, Any], named: str, remedy: str
) -> None:
    told = verdict.judge(good() | bad, NAMES)
    assert told["verdict"] == "INCONCLUSIVE"
    assert named in told["reason"] and remedy in told["conclusive_with"]
    assert told["reason"].count(";") == 0, "one rule at a time"


NOTHING_STOLEN = {f"steal_share_{name}": 0.0 for name in NAMES}


@pytest.mark.parametrize(
    ("known", "verdict_is"),
    [
        ({"machine_irq_time_accounting": True}, "INCONCLUSIVE"),
        ({"machine_irq_time_accounting": None}, "INCONCLUSIVE"),
        ({"machine_irq_time_accounting": True, "untraced_blocks": 1}, "INCONCLUSIVE"),
        ({"machine_irq_time_accounting": True, "untraced_blocks": None}, "INCONCLUSIVE"),
        ({"machine_irq_time_accounting": True, "untraced_blocks": 0}, "holds"),
        ({"machine_irq_time_accounting": None} | NOTHING_STOLEN, "holds"),
        ({"machine_irq_time_accounting": None} | NOTHING_STOLEN | {"steal_share_swap": 1e-5}, "INCONCLUSIVE"),
    ],
)
def test_what_may_have_been_an_interrupt_is_not_left_out_as_stolen(
    verdict: ModuleType, known: dict[str, Any], verdict_is: str
) -> None:
    told = verdict.judge(good() | known, NAMES)
    assert told["verdict"] == verdict_is
    if verdict_is != "holds":
        assert "may be that of interrupts" in told["reason"] and "mount -t tracefs" in told["conclusive_with"]


@pytest.mark.parametrize("few", [{"rig_offers": 20}, {"second_robot_swaps": 19}, {"second_robot_swaps": None}])
def test_a_swap_storm_without_a_swap_in_each_round_proves_nothing(verdict: ModuleType, few: dict[str, Any]) -> None:
    told = verdict.judge(good() | few, NAMES)
    assert told["verdict"] == "INCONCLUSIVE" and "of the second robot in 20 rounds" in told["reason"]


@pytest.mark.parametrize(
    ("bad", "named"),
    [
        ({"r999_floor_stress": 1.3, "r999_floor_stress_low": 1.11}, "stress: 1.30 x the floor"),
        ({"r999_floor_idle": None}, "idle: nan x the floor"),
        (
            {"r999_cyclictest_idle": 0.105, "r999_cyclictest_idle_low": 0.101, "r999_floor_idle": 1.08},
            "idle: 0.105 x cyclictest",
        ),
        ({"r999_plain_loop_stress_low": math.nan}, "stress: 0.010 x plain_loop"),
        ({"late_idle_over_20us_difference_low": 0.0011}, "later than 20 us"),
        ({"late_idle_over_1us_difference_low": math.nan}, "later than 1 us"),
    ],
)
def test_a_claim_that_does_not_hold_is_named(verdict: ModuleType, bad: dict[str, Any], named: str) -> None:
    told = verdict.judge(good() | bad, NAMES)
    assert told["verdict"] == "falls short" and named in told["reason"]


@pytest.mark.parametrize(
    "open_claim",
    [
        {"r999_floor_idle": 1.3, "r999_floor_idle_high": 2.0},  # its interval holds 1.1
        {"r999_floor_idle_high": 9.0, "late_idle_over_1us_difference_high": 0.0011},
        {"r999_floor_idle_high": math.inf, "late_idle_over_5us_difference_high": math.inf},  # too few rounds
    ],
)
def test_a_ratio_that_the_host_makes_undecidable_is_not_passed(verdict: ModuleType, open_claim: dict[str, Any]) -> None:
    told = verdict.judge(good() | open_claim, NAMES)
    assert told["verdict"] == "INCONCLUSIVE" and "undecided" in told["reason"] and told["conclusive_with"]


def test_too_few_rounds_are_said_to_be_too_few(verdict: ModuleType) -> None:
    few = {f"r999_floor_idle{end}": value for end, value in (("_low", -math.inf), ("_high", math.inf))}
    few |= {f"late_idle_over_{limit_us}us_difference_high": math.inf for limit_us in LIMITS_US}
    told = verdict.judge(good() | few | {"shielded": False}, NAMES)
    assert (told["verdict"], told["reason"]) == ("INCONCLUSIVE", "idle: too few rounds for an interval")
    assert "--seconds 60" in told["conclusive_with"]


def test_a_peer_that_no_program_could_beat_here_decides_nothing(verdict: ModuleType) -> None:
    told = verdict.judge(good() | {"r999_floor_idle": 1.0, "r999_cyclictest_idle": 0.23}, NAMES)
    assert told["verdict"] == "INCONCLUSIVE" and "a bare spin is itself 0.23 x cyclictest" in told["reason"]
    peer = {"r999_cyclictest_idle": 0.23, "r999_cyclictest_idle_low": 0.2}
    told = verdict.judge(good() | peer | {"r999_floor_idle": 3.0}, NAMES)
    assert told["verdict"] == "falls short" and "0.230 x cyclictest" in told["reason"], "a bare spin holds it here"


@pytest.mark.parametrize("high", [0.101, math.inf, math.nan, None])
def test_a_peer_whose_interval_reaches_over_the_claim_decides_nothing(verdict: ModuleType, high: float | None) -> None:
    told = verdict.judge(good() | {"r999_plain_loop_numpy_high": high}, NAMES)
    assert told["verdict"] == "INCONCLUSIVE" and "numpy: 0.010 x plain_loop, but its interval" in told["reason"]
    assert "--paper" in told["conclusive_with"]
    above = {"r999_plain_loop_numpy": 0.105, "r999_plain_loop_numpy_high": high, "r999_floor_numpy": 1.08}
    told = verdict.judge(good() | above, NAMES)
    assert (
        told["verdict"] == "INCONCLUSIVE" and "numpy: 0.105 x plain_loop, but its interval is 0.005" in told["reason"]
    )


def test_the_shares_decide_where_the_ratio_cannot(verdict: ModuleType) -> None:
    assert verdict.judge(good() | {"r999_floor_idle_high": 9.0}, NAMES)["verdict"] == "holds"


def test_releases_are_attributed_by_what_the_kernel_counted(figures: ModuleType) -> None:
    rounds = [records(figures, [200.0], stolen_us=150), records(figures, [200.0], 1, 150), records(figures, [200.0])]
    assert [figures.CAUSES[figures.cause(each)[0]] for each in rounds] == ["hypervisor", "other_task", "unknown"]
    told = figures.cause_figures("lithe", rounds)
    assert [told[f"lithe_over_100us_{name}"] for name in figures.CAUSES] == [1, 0, 0, 0, 1, 0, 0, 1]
    assert [len(each) for each in figures.calm(rounds)] == [0, 1, 1], "what the hypervisor took is left out"
    assert not figures.stolen(records(figures, [1.0], stolen_us=4.9))[0], "smaller than the cost of asking"
    rounds[0]["sleeps"] = 1
    assert not figures.stolen(rounds[0])[0], "it gave the core away itself"


def test_the_kernels_share_of_stolen_time(figures: ModuleType) -> None:
    assert figures.kernel_share((10, 1000), (16, 1100)) == 0.06
    assert math.isnan(figures.kernel_share((10, 1000), (10, 1000)))


def test_stolen_time_excuses_the_latest_cycles_of_a_program_that_sleeps(figures: ModuleType) -> None:
    made = figures.peer_records([10, 40_000_000, 20, 39_000_000, 30], 1_500_000)
    assert sorted(made["late_ns"][~figures.stolen(made)]) == [10, 20, 30]
    assert len(figures.calm([figures.peer_records([10, 20], 0)])[0]) == 2
    assert len(figures.calm([figures.peer_records([10, 20], 10**9)])[0]) == 0


def workload(figures: ModuleType, late_us: float = 0.5) -> dict[str, Any]:
    """What a small run has seen: the moteus loop was not there."""
    rng = np.random.default_rng(3)
    spine = [records(figures, rng.random(500) * late_us) for _ in range(9)]
    peer = [figures.peer_records((rng.random(500) * 90_000).astype(int), 0) for _ in range(9)]
    return {"floor": spine, "writing": spine, "lithe": spine, "cyclictest": peer, "plain_loop": peer}


def result(figures: ModuleType, verdict: ModuleType, late_us: float = 0.5) -> dict[str, Any]:
    """A whole result of the workloads NAMES."""
    told: dict[str, Any] = {"machine_cpu": "A|B", "machine_cores": 2, "machine_kernel": "6.1", "machine_virtual": True}
    told |= {"machine_isolated_cores": "", "machine_governor": "?", "machine_clock_source": "tsc"}
    told |= {"measured_as_root": True, "shielded": True, "loads_cores": "0", "control_over_floor": 900.0}
    told |= {"rig_offers": 100, "second_robot_swaps": 20} | {f"steal_share_kernel_{name}": 0.0 for name in NAMES}
    told |= {"moteus_loop_absent": "no network", "attribution": "a trace", "steal_share": 0.0} | {
        f"load_{name}": "nothing" for name in NAMES
    }
    for name in NAMES:
        told |= figures.workload_figures(name, workload(figures, late_us))
    return told | verdict.judge(told, NAMES)


def test_what_has_no_tick_or_one_that_ends_late_is_a_missed_deadline_with_a_cause(figures: ModuleType) -> None:
    seen = workload(figures)
    lost = records(figures, [999.0, 1000.0, 2500.0], switches=1)  # of the first, the tick ended before the next release
    lost["handoff_ns"][1:], lost["missed"][1:] = -1, 1
    overran = records(figures, [0.5, 20.0, 600.0, 0.5, 0.5])
    overran["missed"], overran["told"][1] = 1, 1 + figures.CAUSES.index("tick")
    overran["switches"][3], overran["stolen_ns"][4] = 1, 501_000
    overran["stolen_ns"][0] = 499_000
    told = figures.workload_figures("idle", seen | {"lithe": [np.concatenate([lost, overran]), *seen["lithe"][1:]]})
    causes = {each: told[f"missed_deadlines_idle_{each}"] for each in figures.CAUSES}
    assert told["missed_deadlines_idle"] == sum(causes.values()) == 7
    assert {each: count for each, count in causes.items() if count} == {
        "other_task": 3, "ours": 2, "unknown": 1, "hypervisor": 1
    }  # fmt: skip
    assert told["handoff_idle_p50_us"] == 10.0 and told["preempted_share_idle"] == pytest.approx(4 / 4008)


def test_time_with_pages_is_told_from_time_that_a_tick_burns(figures: ModuleType, table: ModuleType) -> None:
    spun = workload(figures)
    burns, paged, halfway = (records(figures, [0.5] * 9) for _ in range(3))
    for made, page_us in ((burns, 3), (paged, 90), (halfway, 50)):
        made["work_ns"], made["page_ns"] = 100_000, page_us * 1000
    paged["switches"][0], paged["stolen_ns"][1], paged["work_ns"][2] = 1, 60_000, -1
    told = figures.workload_figures("idle", spun | {"lithe": [burns, paged, halfway, *spun["lithe"][3:]]})
    causes = {each: told[f"work_lithe_idle_over_20us_{each}"] for each in figures.CAUSES}
    assert {each: count for each, count in causes.items() if count} == {
        "ours": 18, "page": 6, "other_task": 1, "hypervisor": 1
    }  # fmt: skip
    assert told["work_writing_idle_p999_us"] == 8.0 and told["r999_work_idle"] == pytest.approx(100 / 8)
    assert not any(told[f"lithe_idle_over_20us_{each}"] for each in figures.CAUSES), "no release was late"
    words = table.by_cause(told, "idle", "work_lithe", "work_writing")
    assert words == "hypervisor 1 (0), other_task 1 (0), page 6 (0), ours 18 (0)"
    paged["missed"] = burns["missed"] = 1
    assert figures.CAUSES[figures.missed_cause(paged)[5]] == "page"
    assert figures.CAUSES[figures.missed_cause(burns)[5]] == "ours"


def test_the_causes_of_late_cycles_are_told_beside_the_floors(
    figures: ModuleType, verdict: ModuleType, table: ModuleType
) -> None:
    told = result(figures, verdict) | {"lithe_idle_over_20us_ours": 3, "floor_idle_over_20us_unknown": 14}
    words = table.text(told)
    assert (
        "cycles above 20 us of LITHE (of the floor) by cause: ours 3 (0), unknown 0 (14); missed deadlines: 0" in words
    )
    assert "by cause: none; missed deadlines: 0 (none)" in words, "of the other workloads"


def test_every_figure_that_the_issue_names_is_there(figures: ModuleType, verdict: ModuleType) -> None:
    told = result(figures, verdict)
    assert told["verdict"] == "INCONCLUSIVE" and "4500 cycles" in told["reason"]
    for name in NAMES:
        assert math.isnan(told[f"r999_moteus_loop_{name}"]), "absent, so null in the file"
        assert told[f"cycles_{name}"] == told[f"cycles_cyclictest_{name}"] == told[f"cycles_plain_loop_{name}"] == 4500
        for program in ("floor", "writing", "work", "cyclictest", "plain_loop"):
            assert told[f"r999_{program}_{name}"] > 0
        for key in ("steal_share", "preempted_share", "missed_deadlines", "late", "handoff"):
            assert any(each.startswith(f"{key}_{name}") for each in told), key
        for limit_us in LIMITS_US:
            share = told[f"cyclictest_{name}_over_{limit_us}us"]
            low, high = (told[f"cyclictest_{name}_over_{limit_us}us_{end}"] for end in ("low", "high"))
            assert low <= share <= high


def test_results_are_shown_compared_and_put_into_a_table(
    figures: ModuleType, verdict: ModuleType, table: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = result(figures, verdict), result(figures, verdict, late_us=30.0)
    text = table.text(one | {"rogue_looks": 200, "rogue_share_on_spine_core": 0.25} | dict.fromkeys(ROGUE, "0,1"))
    assert "ran on 0,1, 25.0% of the 200 looks on the Spine's core" in text
    assert "98.3" in text and "3.11" in text and "no network" in text and "verdict: INCONCLUSIVE" in text
    for name, told in (("a", one), ("b", other)):
        (tmp_path / f"{name}.json").write_text(json.dumps(told))
    assert table.main(["compare", str(tmp_path / "a.json"), str(tmp_path / "b.json")]) == 0
    compared = capsys.readouterr().out
    row = next(line.split() for line in compared.splitlines() if "lithe_stress_p999_us" in line)
    assert float(row[3]) == pytest.approx(60, rel=0.02), "B / A"
    assert table.main(["table", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert table.main(["summary", str(tmp_path / "a.json")]) == 0
    small = json.loads(capsys.readouterr().out)
    (tmp_path / "a.json").write_text(json.dumps(small))
    assert small["load_stress"] == "nothing"
    assert len(small) < len(one) / 5 and table.boards(tmp_path).splitlines() == lines, "the table needs no more"
    assert len(lines) == 4 and lines[2].startswith("| a: A/B, 2 cores | 6.1 |")
    assert {line.count("|") for line in lines} == {10}


def test_runs_of_different_length_are_compared_by_rates(
    figures: ModuleType, verdict: ModuleType, table: ModuleType
) -> None:
    one = result(figures, verdict) | {"cycles_swap": 1000, "missed_deadlines_swap": 1, "load_swap": "a storm"}
    other = one | {"cycles_swap": 10_000, "missed_deadlines_swap": 20, "load_swap": "two storms"}
    rows = [line.split() for line in table.compare(one, other).splitlines()]
    assert ["missed_deadlines_share_swap", "0.001", "0.002", "2.00"] in rows
    assert ["cycles_swap", "1000", "10000"] in rows and ["load_swap", "a", "storm", "two", "storms"] in rows


def test_the_page_has_the_table_of_the_boards_whose_results_are_here(table: ModuleType) -> None:
    printed = table.boards(ROOT / "bench/boards")
    assert len(printed.splitlines()) > 2 and printed in (ROOT / "docs/host.md").read_text(), printed


def test_what_is_no_result_is_refused(table: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.json").write_text("[]")
    for words in (["table", str(tmp_path)], ["compare", "/nowhere.json", "x"], ["table", "/nowhere"], ["compare", "x"]):
        assert table.main(words) == 2
        assert capsys.readouterr().err


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of what matplotlib uses
@pytest.mark.filterwarnings("ignore:Data has no positive values")  # where every cycle was stolen
def test_a_figure_and_a_page_with_everything_inside(
    figures: ModuleType, verdict: ModuleType, table: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    plot, plain = module("plot", monkeypatch), module("run", monkeypatch).plain
    told = result(figures, verdict)
    plot.draw({name: workload(figures) for name in NAMES}, told, tmp_path / "f.png")
    plot.page(told, "a < b", '{"tier": "D"}', tmp_path / "f.png", tmp_path / "f.html")
    page = (tmp_path / "f.html").read_text()
    taken = [records(figures, [50.0] * 9, stolen_us=60) for _ in range(9)]
    stolen = {"floor": taken, "writing": taken, "lithe": taken}
    plot.draw({"idle": stolen}, told, tmp_path / "stolen.png")
    told |= {key: plain(value) for key, value in figures.workload_figures("idle", stolen).items()}
    assert "idle" in table.text(told)
    assert "data:image/png;base64," in page and "a &lt; b" in page and "tier" in page and "http" not in page
