# SPDX-License-Identifier: Apache-2.0
"""A law or a parameter that goes without its client's doing: the next answer says so, why, and what leads back."""

import base64
import json
import time
from types import SimpleNamespace
from typing import Any

import lithe
import pytest
from lithe import Refused
from lithe.gateway import Gateway, changes, happened
from lithe.gateway.changes import LawWatch
from lithe.gateway.parts import simulation_of
from lithe.gateway.peer import Peer
from lithe.mcp import plots
from lithe.remote import Remote
from system.robot_rig import ROOT, RobotRig


def pd(remote: Remote, **args: Any) -> dict[str, Any]:
    """The first law again, so that there is one to go back to."""
    source = (ROOT / "laws/pd.cpp").read_text()
    args = {"probation_s": 0.0, "brief": False, **args}
    swapped: dict[str, Any] = remote.call("swap", source=source, name="pd.cpp", **args)
    return swapped


def test_measure_names_the_law_and_its_parameters(remote: Remote) -> None:
    swapped = pd(remote, params={"kp_nm_rad": 3.5})
    told = remote.call("measure", seconds=0.2)
    assert (told["law"], told["law_id"]) == ("pd", swapped["law_id"]) and told["params"]["kp_nm_rad"] == 3.5
    assert told["joints"]["shoulder"]["max_error_tick"] >= told["from_tick"] >= swapped["commit_tick"]
    remote.call("set_params", name="kp_nm_rad", value=3.6)
    told = remote.call("measure", seconds=1.0)
    assert told["params_since_tick"] > told["from_tick"], "the errors are those of two values"
    assert "law_changed" not in told, "it did that itself"


def test_a_rollback_by_another_is_told_once_with_its_reason_and_the_way_back(gateway: Gateway, remote: Remote) -> None:
    first, second = pd(remote), pd(remote, params={"kp_nm_rad": 3.5})
    assert "law_changed" not in remote.call("measure", seconds=0.1)
    with Remote("127.0.0.1", gateway.port, "sesame") as other:
        other.call("rollback")
        assert "law_changed" not in other.call("status"), "it asked for it"
    changed = remote.call("measure", seconds=0.05)["law_changed"]
    assert changed["was"]["law_id"] == second["law_id"] and changed["was"]["params"]["kp_nm_rad"] == 3.5
    assert changed["now"]["law_id"] == first["law_id"]
    assert changed["because"][-1]["kind"] == "law_rolled_back"
    number = second["certificate"].removesuffix(".json")
    assert f"document swaps/{number}.cpp" in changed["next"] and "'kp_nm_rad': 3.5" in changed["next"]
    assert remote.call("document", name=f"swaps/{number}.cpp")["text"]
    assert "law_changed" not in remote.call("status"), "once"


def test_a_law_of_another_leads_back_by_activate(gateway: Gateway, remote: Remote) -> None:
    mine = pd(remote)
    with Remote("127.0.0.1", gateway.port, "sesame") as other:
        theirs = pd(other)
    changed = remote.call("reference")["law_changed"]
    assert changed["now"]["law_id"] == theirs["law_id"] and changed["because"][-1]["kind"] == "law_committed"
    assert changed["next"] == f"activate {mine['law_id']} leads back to 'pd'"
    assert remote.call("activate", law=mine["law_id"])["law_id"] == mine["law_id"]
    assert "law_changed" not in remote.call("status")


def test_a_verb_that_changes_the_law_tells_what_had_happened_before_it(gateway: Gateway, remote: Remote) -> None:
    pd(remote)
    with Remote("127.0.0.1", gateway.port, "sesame") as other:
        pd(other)
    with pytest.raises(Refused):
        remote.call("set_params", name="kp_nm_rad", value=1e9)
    told = remote.call("set_params", name="kp_nm_rad", value=3.9)
    assert told["law_changed"]["because"][-1]["kind"] == "law_committed", "a refusal is no answer that told it"
    assert "law_changed" not in remote.call("status")


def test_parameters_that_another_sets_are_told_with_both_values(gateway: Gateway, remote: Remote) -> None:
    pd(remote)
    with Remote("127.0.0.1", gateway.port, "sesame") as other:
        other.call("set_params", name="kp_nm_rad", value=4.5)
    changed = remote.call("status")["law_changed"]
    assert changed["was"]["params"]["kp_nm_rad"] == 4.0 and changed["now"]["params"]["kp_nm_rad"] == 4.5
    assert changed["because"][-1]["kind"] == "params_applied" and "set_params" in changed["next"]


def test_a_reference_says_which_parameters_it_may_take_back(remote: Remote) -> None:
    pd(remote)
    remote.call("set_params", name="kp_nm_rad", value=4.5)
    remote.call("set_params", name="kp_nm_rad", value=4.6)
    told = remote.call("set_reference", kind="rest")
    assert "kp_nm_rad = 4.6 (else again 4)" in told["warning"] and told["unproven_params_else"] == {"kp_nm_rad": 4.0}


def test_a_client_that_comes_back_is_told_what_it_missed_and_a_new_run_is_a_change(
    robot: lithe.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch, me = LawWatch(robot), Peer("s" * 16, "me", True)
    watch.knows(me, watch.change(me)[1])
    assert watch.change(me)[0] is None and watch.change(Peer("t" * 16, "new", True))[0] is None
    told = {"law": "first", "law_id": 1, "params": []}
    monkeypatch.setattr(changes, "params_of", lambda _: told)
    fake: Any = SimpleNamespace(attached=True, spine=object(), call=lambda *_, **__: {"resident": []})
    watch._robot = fake
    changed, _ = watch.change(me)
    assert changed is not None and "started again" in changed["because"][0]["text"]
    assert changed["next"].startswith("'pd' is no longer loaded")


def test_a_law_that_left_before_the_client_could_look_is_news_with_its_reason(robot: lithe.Robot) -> None:
    watch, me = LawWatch(robot), Peer("s" * 16, "me", True)
    asked_ns = time.monotonic_ns()
    robot.swap((ROOT / "laws/pd.cpp").read_text(), "pd.cpp", probation_s=0.0)
    gone = robot.swap((ROOT / "laws/pd.cpp").read_text(), "pd.cpp", probation_s=0.0)
    robot.rollback()
    watch.did(me, gone, asked_ns)
    changed, now = watch.change(me)
    assert changed is not None and changed["was"]["law_id"] == gone["law_id"] and changed["was"]["params"] is None
    assert [each["kind"] for each in changed["because"]][-1] == "law_rolled_back"
    assert gone["certificate"].removesuffix(".json") in changed["next"]
    watch.knows(me, now)
    watch.did(me, gone | {"verdict": "rolled_back"}, asked_ns)
    assert watch.change(me)[0] is None, "its answer said so"


def event(cursor: int, kind: str = "armed", **more: Any) -> dict[str, Any]:
    return {"cursor": cursor, "kind": kind, "tick": 10 * cursor, "t_ns": cursor, "text": "x" * 100, **more}


def test_events_fit_and_the_newest_are_told_first() -> None:
    answer = {"events": [event(n) for n in range(1, 4001)], "cursor": 4000, "lost": 3}
    told = happened.told(answer, {})
    assert len(json.dumps(told)) < happened.MOST_BYTES + 300 and told["lost"] == 3
    assert told["events"][-1]["cursor"] == 4000 and told["left_out"] == 4000 - len(told["events"]) > 0
    since = happened.told(answer, {"since": 0})
    assert since["events"][0]["cursor"] == 1 and since["cursor"] == since["events"][-1]["cursor"] < 4000
    assert happened.asked({"since": 7, "kind": "armed"}) == {"since": 7}


def test_events_are_chosen_by_kind_and_missed_deadlines_are_one_event() -> None:
    missed = [event(n, "deadline_missed") for n in range(1, 9)] + [event(9, "deadline_missed", count=30)]
    answer = {"events": [*missed, event(10, "held"), event(11, "deadline_missed")], "cursor": 11, "lost": 0}
    told = happened.told(answer, {})["events"]
    assert [each["kind"] for each in told] == ["deadline_missed", "held", "deadline_missed"]
    assert (told[0]["count"], told[0]["tick"], told[0]["until_tick"]) == (38, 10, 90)
    assert [each["kind"] for each in happened.told(answer, {"kind": "held"})["events"]] == ["held"]
    both = happened.told(answer, {"kind": ["held", "deadline_missed"], "since": 0, "limit": 1})
    assert both["cursor"] == 9 and both["events"][0]["count"] == 38, "the next question begins after the whole run"


def test_the_effective_constants_of_a_chain_are_those_of_its_file() -> None:
    told = simulation_of(ROOT / "robots/chain.toml")
    assert told is not None
    wrist = told["effective"]["wrist"]
    assert wrist == {"C_kg_m2": pytest.approx(0.08 * 0.12**2 / 3), "mu_kg_m": 0.0048, "R_kg_m2": 0.002}
    elbow = told["effective"]["elbow"]
    assert elbow["C_kg_m2"] == pytest.approx(1.2e-3 + 0.25 * 0.13**2 + 0.2**2 * 0.08)
    assert elbow["mu_kg_m"] == pytest.approx(0.25 * 0.13 + 0.2 * 0.08)
    alone = simulation_of(ROOT / "robots/arm.toml")
    assert alone is not None and "effective" not in alone


def test_the_ticks_around_an_incident_are_a_history(rig: RobotRig, remote: Remote) -> None:
    remote.call("hold")
    remote.call("arm")
    rig.wait_for(lambda: remote.call("incidents")["incidents"])
    kept = remote.call("incidents")["incidents"][-1]
    told = remote.call("history", incident=kept["id"], fields=["tick", "mode", "position_rad"], every=10)
    assert told["incident"] == kept["id"] and told["at_tick"] == kept["tick"] and told["what"] == kept["what"]
    assert min(told["tick"]) < kept["tick"] < max(told["tick"]) and len(told["position_rad"][0]) == 1
    picture = plots.drawn(f"plots/incidents/{kept['id']}.png", lambda verb, args: remote.call(verb, **args))
    assert base64.b64decode(picture).startswith(b"\x89PNG")
    with pytest.raises(Refused, match="no incident 4711"):
        remote.call("history", incident=4711)
