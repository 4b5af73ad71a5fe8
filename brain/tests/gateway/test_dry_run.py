# SPDX-License-Identifier: Apache-2.0
"""`dry_run` of every verb that changes something, `shadow`, `identify`, and the diff of a law."""

import time
from typing import Any

import lithe
import pytest
from lithe.gateway import Gateway
from lithe.gateway.brief import MOST_DIFF_BYTES, diff
from lithe.gateway.token import lower
from lithe.remote import Remote
from lithe.vocabulary import VERBS, Effect, Tier
from system.robot_rig import ROOT

PD = (ROOT / "laws/pd.cpp").read_text()
ARGS: dict[str, dict[str, Any]] = {
    "swap": {"source": PD, "name": "pd.cpp"}, "shadow": {"source": PD, "name": "pd.cpp"},
    "set_params": {"name": "kp_nm_rad", "value": 3.25}, "activate": {"law": "pd"},
    "set_reference": {"kind": "sine", "centre_rad": 0.0, "amplitude_rad": 0.3, "frequency_hz": 0.5},
    "publish": {"t_ns": [1], "position_rad": [[0.1]]}, "set_inputs": {"values": {}},
}  # fmt: skip
CHANGING = [each.name for each in VERBS if each.effect in (Effect.moves, Effect.stops) and each.name != "estop"]


def state(robot: lithe.Robot) -> dict[str, Any]:
    """What a verb could have changed."""
    status = robot.status()
    return {key: status[key] for key in ("mode", "fault", "law", "law_id", "params", "last_params", "supervisor_pid")}


def test_of_every_verb_it_changes_nothing_and_says_what_would_happen(gateway: Gateway, robot: lithe.Robot) -> None:
    before, cursor = state(robot), robot.events()["cursor"]
    with Remote("127.0.0.1", gateway.port, lower("sesame", Tier.observe)) as watcher:
        for verb in CHANGING:
            told = watcher.call(verb, dry_run=True, **ARGS.get(verb, {}))
            assert told["dry_run"] and ("would" in told) != ("refused" in told), told
            assert (told.get("needs_tier", "observe")) == next(each.tier.name for each in VERBS if each.name == verb)
        assert watcher.call("reference")["streams"] is False
    assert state(robot) == before
    kinds = {each["kind"] for each in robot.events(since=cursor)["events"]}
    assert not kinds & {"law_committed", "params_applied", "armed", "disarmed", "held", "reset", "law_rolled_back"}, (
        kinds
    )


@pytest.mark.parametrize(
    ("verb", "args", "code"),
    [
        ("swap", {"source": PD.replace("t.position_rad[j]", "t.position[j]")}, "compile_failed"),
        ("swap", {"source": PD, "params": {"kp_nm_rad": -1}}, "refused_range"),
        ("set_params", {"name": "nonsense", "value": 1}, "unknown_param"),
        ("set_reference", {**ARGS["set_reference"], "amplitude_rad": 99}, "refused_limit"),
        ("publish", {"t_ns": [1], "position_rad": [[99.0]]}, "refused_plan"),
        ("set_inputs", {"values": {"nobody": 1}}, "unknown_input"),
        ("reset", {}, "refused_mode"),
        ("sim_reset", {}, "refused_mode"),
        ("activate", {"law": "nobody"}, "unknown_law"),
    ],
)
def test_it_says_why_it_would_be_refused(remote: Remote, verb: str, args: dict[str, Any], code: str) -> None:
    told = remote.call(verb, dry_run=True, **args)
    assert told["refused"]["code"] == code and told["refused"]["message"], told


def test_an_agents_dry_run_meets_the_fences(gateway: Gateway) -> None:
    with Remote("127.0.0.1", gateway.port, lower("sesame", Tier.move)) as agent:
        told = agent.call("swap", source=PD, probation_s=0, dry_run=True)
    assert told["refused"]["code"] == "no_permission"


def test_the_answer_of_a_swap_has_what_differs_from_the_law_that_ran(remote: Remote) -> None:
    remote.call("swap", source=PD, name="pd.cpp", probation_s=0)
    changed = PD.replace('"pd"', '"pd_two"')
    told = remote.call("swap", source=changed, name="pd_two.cpp", probation_s=0)["diff"]
    line = next(line for line in PD.splitlines() if '"pd"' in line)
    assert told == {"lines": 2, "text": [f"-{line}", "+" + line.replace('"pd"', '"pd_two"')]}
    assert remote.call("swap", source=changed, name="pd_two.cpp", dry_run=True)["diff"]["lines"] == 0
    many = diff("a\n" * 500, "b\n" * 500)
    assert many["lines"] == 1000 and len(str(many["text"])) < MOST_DIFF_BYTES + 200


def test_a_shadow_says_how_far_it_differs_and_never_runs(remote: Remote) -> None:
    before = remote.call("status")["law_id"]
    told = remote.call("shadow", source=PD.replace('"pd"', '"shade"'), shadow_s=0.2, brief=True)
    assert told["verdict"] == "measured" and told["shadow_ticks"] > 0 and list(told["shadow_rms_nm"]) == ["shoulder"], (
        told
    )
    assert remote.call("status")["law_id"] == before


def test_a_dry_run_of_a_shadow_says_that_it_never_runs(remote: Remote) -> None:
    for verb, args, says in (
        ("shadow", {}, "beside the running law for 2 s, without effect, and never run"),
        ("swap", {"shadow_s": 0.5, "promote": False}, "for 0.5 s, without effect, and never run"),
        ("swap", {"shadow_s": 0.5}, "for 0.5 s, without effect, and run after that"),
        ("swap", {}, "it would run from the next tick"),
    ):
        assert remote.call(verb, source=PD, dry_run=True, **args)["would"].endswith(says)


def test_a_dry_run_of_a_way_back_tells_the_same_laws_as_the_way_back(remote: Remote) -> None:
    for name in ("first", "second", "third", "second"):
        remote.call("swap", source=PD.replace('"pd"', f'"{name}"'), probation_s=0)
    resident = remote.call("law_list")["resident"]
    wrong = remote.call("activate", law="nobody", dry_run=True)["refused"]
    assert all(f"{each['law_id']} ('{each['law']}')" in wrong["next"] for each in resident if not each["active"])
    for verb, args in (("activate", {"law": "second"}), ("rollback", {"steps": 1}), ("activate", {"law": "first"})):
        dry = remote.call(verb, dry_run=True, **args)
        real = remote.call(verb, **args)
        assert (dry["law_id"], dry["dropped"]) == (real["law_id"], real.get("dropped", []))
        assert f"(law_id {real['law_id']})" in dry["would"] and ("dropped" in dry["would"]) == bool(dry["dropped"])
    assert dry["dropped"], "those after the first"


def test_a_dry_run_knows_the_mode(remote: Remote) -> None:
    remote.call("hold")
    for verb in ("set_reference", "publish"):
        told = remote.call(verb, dry_run=True, **ARGS[verb])["refused"]
        assert told["code"] == "refused_mode" and "arm" in told["next"] and "publish" not in told["next"], told
    with pytest.raises(lithe.Refused) as real:
        remote.call("set_reference", **ARGS["set_reference"])
    assert (real.value.code, real.value.next) == (told["code"], told["next"])
    remote.call("disarm")
    assert remote.call("activate", law="first", dry_run=True)["would"].endswith(
        "runs after arm: the mode is disarmed, with its state"
    )


def test_identify_asks_for_a_motion_and_then_knows_the_joint(remote: Remote) -> None:
    """The arm is exactly its model here (calm.py); its numbers are those of robots/arm.toml."""
    time.sleep(0.5)
    with pytest.raises(lithe.Refused) as refusal:
        remote.call("identify", seconds=0.3)
    assert refusal.value.code == "motion_tells_too_little"
    remote.call("set_reference", **refusal.value.detail["needs"])
    until_s, told = time.monotonic() + 60, None
    while told is None:  # on a busy machine the motion takes longer
        time.sleep(4)
        try:
            told = remote.call("identify")
        except lithe.Refused:
            assert time.monotonic() < until_s
    remote.call("stop_reference")
    found = {each["name"]: each for each in told["parameters"]}
    truth = remote.call("sim_truth")["joints"]["shoulder"]
    for name, value in (("inertia", truth["inertia_kg_m2"]), ("gravity", truth["mgl_nm"])):
        one = found[name]
        assert one["low"] <= one["value"] <= one["high"]
        assert abs(one["value"] - value) < max(3 * (one["high"] - one["low"]), 0.1 * value), (name, one, value)
    assert told["moved"]["shoulder"]["range_rad"] > 0.5 and told["seconds"] > 2
