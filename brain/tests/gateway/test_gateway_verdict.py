# SPDX-License-Identifier: Apache-2.0
"""A swap's answer with its verdict, on a moving robot; and what a client reads of swaps in little room."""

import json
import socket
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import lithe
import pytest
from lithe.gateway import Gateway, documents
from lithe.gateway.brief import MOST_BYTES, brief, brief_detail, brief_params
from lithe.remote import Remote
from system.robot_rig import ROOT, RobotRig

PD = (ROOT / "laws/pd.cpp").read_text()
SINE = {"kind": "sine", "centre_rad": 0.9, "amplitude_rad": 0.4, "frequency_hz": 1.0, "client_stale_s": 600}
KEPT = ("confirmed", "unproven")  # unproven: the machine took too many ticks away
WRONG_NAMES = "\n".join(f"    u.torque_nm[0] += there_is_no_name_like_number_{number};" for number in range(20))


def test_a_short_answer_has_the_verdict_and_old_law_beside_new(remote: Remote) -> None:
    remote.call("set_reference", **SINE)
    told = remote.call("swap", source=PD, name="pd.cpp", params={"kp_nm_rad": 8.0}, brief=True)
    assert told["verdict"] in KEPT and len(json.dumps(told)) < 2000, told
    (joint,) = told["joints"].items()
    errors = joint[1]["rms_error_rad"]
    assert joint[0] == "shoulder" and set(errors) == {"old", "new", "predicted", "new_late"}
    assert all(isinstance(error, float) and error > 0 for error in errors.values()), told
    assert joint[1]["chatter_hz"] >= 0 and 0 <= told["clamped"] <= 1 and told["missed_ticks"] >= 0
    certificate = json.loads(remote.call("document", name=told["certificate"])["text"])
    assert certificate["verdict"] in KEPT
    assert errors["new"] == pytest.approx(certificate["control"]["joints"][0]["after"]["rms_error_rad"], rel=1e-3)
    whole = remote.call("swap", source=PD, name="pd.cpp", wait=True, brief=False)
    assert whole["verdict"] in KEPT and whole["control"]["joints"] and whole["trial"]["ok"]
    at_once = remote.call("swap", source=PD, name="pd.cpp")
    assert at_once["verdict"] == "committed" and "control" not in at_once, "as it was, unless it is asked to wait"
    assert remote.call("swap", source=PD, name="pd.cpp", brief=True, wait=False)["verdict"] == "committed"


def test_a_short_answer_says_why_a_law_was_rolled_back_and_what_next(remote: Remote) -> None:
    remote.call("set_reference", **SINE)
    assert remote.call("swap", source=PD, name="pd.cpp", brief=True)["verdict"] in KEPT
    told = remote.call("swap", source=PD, name="limp.cpp", params={"kp_nm_rad": 0.0}, brief=True)
    assert told["verdict"] == "rolled_back" and len(json.dumps(told)) < 2000, told
    assert told["rolled_back"]["why"].startswith("tracking_lost: joint shoulder") and told["rolled_back"]["next"], told
    errors = told["joints"]["shoulder"]["rms_error_rad"]
    assert errors["new"] > errors["old"], told
    row = json.loads(remote.call("document", name="swaps")["text"])[-1]
    told.pop("diff")
    assert row == told, "the document of all swaps says the same"


def test_set_params_says_what_went_back_to_which_values_and_why_and_what_holds_now(remote: Remote) -> None:
    def parameter() -> Any:
        (active,) = [each for each in remote.call("law_list")["resident"] if each["active"]]
        return active["params"][0]

    remote.call("set_reference", **SINE)
    assert remote.call("swap", source=PD, name="pd.cpp", probation_s=0)["verdict"] == "committed"
    told = remote.call("set_params", values={"kp_nm_rad": 0.0}, wait=True)
    assert told["verdict"] == "reverted" and len(json.dumps(told)) < MOST_BYTES, told
    assert told["values"] == {"kp_nm_rad": 0.0} and told["went_back_to"] == {"kp_nm_rad": 4.0}
    assert told["why"].startswith("tracking_lost: joint shoulder") and told["next"], told
    assert told["params"]["kp_nm_rad"] == remote.call("status")["params"]["kp_nm_rad"] == 4.0
    assert "at_commit" not in parameter()
    kept = remote.call("set_params", values={"kp_nm_rad": 5.0}, wait=True)
    assert kept["verdict"] in KEPT and "went_back_to" not in kept and kept["params"]["kp_nm_rad"] == 5.0, kept
    assert remote.call("status")["params"]["kp_nm_rad"] == 5.0
    assert (parameter()["name"], parameter()["value"], parameter()["at_commit"]) == ("kp_nm_rad", 5.0, 4.0)
    at_once = remote.call("set_params", values={"kp_nm_rad": 4.5})
    assert at_once["params"][0]["value"] == 4.5 and "verdict" not in at_once, "as it was, unless it is asked to wait"


def test_set_params_says_when_nothing_can_show_what_the_values_do(remote: Remote) -> None:
    assert "5 s" in remote.call("set_reference", **{**SINE, "client_stale_s": 5})["note"]
    assert remote.call("swap", source=PD, name="pd.cpp", probation_s=0)["verdict"] == "committed"
    moving = remote.call("set_params", values={"kp_nm_rad": 4.2}, wait=True)
    assert not [each for each in moving.get("warnings", []) if each.startswith("no ")], moving
    remote.call("stop_reference")
    RobotRig.wait_for(lambda: remote.call("reference")["streams"] is False)
    assert remote.call("set_params", values={"kp_nm_rad": 4.1}, wait=True)["warnings"][0] == (
        "no reference runs (stopped): at rest nothing shows what the values do"
    )
    remote.call("disarm")
    told = remote.call("set_params", values={"kp_nm_rad": 4.0}, wait=True)
    assert told["warnings"][0].startswith("no law runs: the robot is in mode disarmed"), told
    remote.call("arm")


def test_a_swap_in_short_has_parameters_that_did_not_stay_and_a_long_list_of_them_is_cut() -> None:
    reason = "oscillating: joint hip"
    back = {"verdict": "reverted", "values": {"kp": 9.0}, "went_back_to": {"kp": 4.0}, "reason": reason}
    told = brief({"verdict": "confirmed", "param_changes": [{"verdict": "refused"}, back, {"verdict": "confirmed"}]})
    assert told["params_reverted"] == {"values": {"kp": 9.0}, "went_back_to": {"kp": 4.0}, "why": reason}
    many = {f"a_parameter_with_a_long_name_{n}": 1 / 3 for n in range(32)}
    listed = [{"name": name, "value": value} for name, value in many.items()]
    short = brief_params({"params": listed, "tried": back | {"values": many, "went_back_to": many}})
    assert short["verdict"] == "reverted" and short["why"] and len(json.dumps(short)) < MOST_BYTES, short


def test_a_swap_that_waits_for_its_verdict_keeps_no_stop_and_no_other_client_waiting(
    gateway: Gateway, remote: Remote
) -> None:
    ask = {"source": PD, "name": "slow.cpp", "probation_s": 15, "brief": True}
    with socket.create_connection(("127.0.0.1", gateway.port), 90) as link, link.makefile("rb") as file:
        link.sendall(b'{"token": "sesame"}\n' + json.dumps({"id": 1, "verb": "swap", "args": ask}).encode() + b"\n")
        assert json.loads(file.readline())["ok"]
        RobotRig.wait_for(lambda: (remote.call("status")["last_swap"] or {}).get("source") == "slow.cpp")
        RobotRig.wait_for(lambda: remote.call("status")["last_swap"]["verdict"] == "committed")
        assert remote.call("params")["params"], "another client is served meanwhile"
        link.sendall(b'{"id": 2, "verb": "hold"}\n')
        first, second = (json.loads(file.readline()) for _ in range(2))
    assert first["id"] == 1 and first["result"]["verdict"] == "committed", "the stop ended the waiting, not the swap"
    assert second["id"] == 2 and second["ok"] and remote.call("status")["mode"] == "hold"
    remote.call("arm")


def test_who_waits_for_a_verdict_is_not_silent(remote: Remote) -> None:
    remote.call("set_reference", **{**SINE, "client_stale_s": 4.0})  # longer than a busy machine stands still
    told = remote.call("swap", source=PD, name="pd.cpp", brief=True, probation_s=6)
    assert told["verdict"] in (*KEPT, "committed"), json.dumps(told)  # a slow machine's verdict comes later
    assert remote.call("reference")["asked"]["kind"] == "sine"


def test_of_many_joints_the_worst_come_first_and_warnings_have_room() -> None:
    def side(error_rad: float) -> dict[str, Any]:
        return {"rms_error_rad": error_rad, "chatter_hz": 1.0}

    joints = [
        {
            "joint": f"joint_with_a_long_name_{n}",
            "before": side(0.1),
            "after": side(n / 100),
            "predicted_rms_error_rad": 1 / 3,
        }
        for n in range(32)
    ]
    long = {"certificate": "0007.json", "verdict": "confirmed", "law": "pd", "trial": {"warnings": ["w" * 300] * 9},
            "control": {"joints": joints, "after": {"clamped": 1 / 3, "missed_ticks": 2}}}  # fmt: skip
    short = brief(long)
    assert len(json.dumps(short)) < MOST_BYTES and short["certificate"] == "swaps/0007"
    assert next(iter(short["joints"])) == "joint_with_a_long_name_31"
    assert short["joints_left_out"] == 32 - len(short["joints"]) and short["warnings"][0].startswith("www")


def test_hints_of_a_law_that_was_taken_come_early_and_whole() -> None:
    """What a certificate knows of a law's mistake is not lost to numbers of its joints."""
    hints = [f"joint {name}: the law gave it no torque at all".ljust(275, ".") for name in ("a", "b", "c")]
    joints = [{"joint": f"joint_with_a_long_name_{n}", "after": {"rms_error_rad": 0.1}} for n in range(32)]
    short = brief({"verdict": "confirmed", "trial": {"hints": hints, "warnings": ["w" * 300] * 9},
                   "control": {"joints": joints}, "cleaned": ["line 1: text was left out"] * 20})  # fmt: skip
    assert len(json.dumps(short)) < MOST_BYTES
    assert short["hints"] == hints[:2] and short["hints_left_out"] == 1
    assert short["cleaned"][0] == "line 1: text was left out"


def test_of_many_joints_those_that_became_worse_come_first() -> None:
    """Not those with the largest error, which a new law may have made ten times smaller."""
    joints = [
        {"joint": f"joint_with_a_long_name_{n}", "before": {"rms_error_rad": old}, "after": {"rms_error_rad": new}}
        for n, (old, new) in enumerate([(0.2, 0.08)] * 6 + [(0.0003, 0.0006)])
    ]
    short = brief({"verdict": "confirmed", "control": {"joints": joints}})
    assert next(iter(short["joints"])) == "joint_with_a_long_name_6" and short["joints_left_out"] > 0


def test_a_short_refusal_keeps_as_much_as_there_is_room_for(remote: Remote) -> None:
    source = PD.replace(
        "static void step(", "static void unused(lithe::Effort& u) {\n" + WRONG_NAMES + "\n  }\n  static void step("
    )
    with pytest.raises(lithe.Refused) as caught:
        remote.call("swap", source=source, name="pd.cpp", brief=True)
    detail: Any = caught.value.detail
    assert len(json.dumps(detail)) < MOST_BYTES and detail["certificate"].startswith("swaps/")
    assert "there_is_no_name_like_number_0" in detail["diagnostics"][0]["message"], detail
    assert len(detail["diagnostics"]) >= 2
    trial = {"stage": "trial", "trial": {"hints": ["joint elbow: lower its stiffness " * 40], "report": {"loop": 1}}}
    hint = brief_detail({**trial, "text": "x" * 3000})["hints"][0]
    assert hint.startswith("joint elbow: lower its stiffness") and hint.endswith("...") and len(hint) > 700
    assert len(json.dumps(brief_detail({"text": "\N{SNOWMAN}" * 3000}))) < MOST_BYTES


def test_the_document_of_all_swaps_says_why_a_law_was_refused_and_has_no_more_than_its_bytes(
    remote: Remote, robot: lithe.Robot, tmp_path: Path
) -> None:
    with pytest.raises(lithe.Refused) as caught:
        remote.call("swap", source="#include <lithe/law.hpp>\nint broken(\n", name="broken.cpp")
    row = json.loads(remote.call("document", name="swaps")["text"])[-1]
    assert row["verdict"] == "refused" and row["error"]["code"] == "compile_failed"
    assert row["error"]["message"] == caught.value.message and row["error"]["next"]
    assert row["refused_after"] == "submitted" and row["certificate"].startswith("swaps/")
    newest = max(Path(robot.status()["records"]).glob("[0-9]*.json"))
    for number in range(1, 400):
        (tmp_path / f"{number:04}.json").write_text(newest.read_text())
    rows = documents.swaps(tmp_path)
    assert len(json.dumps(rows)) <= documents.MOST_SWAPS_BYTES and len(rows) >= 32
    assert [rows[-1]["certificate"], rows[-2]["certificate"]] == ["swaps/0399", "swaps/0398"]


def test_many_clients_wait_at_once_and_each_gets_its_own_verdict(gateway: Gateway, remote: Remote) -> None:
    remote.call("set_reference", **SINE)

    def swap(number: int) -> Any:
        with Remote("127.0.0.1", gateway.port, "sesame") as client:
            return client.call("swap", source=PD, name=f"{number}.cpp", brief=True)

    with ThreadPoolExecutor(3) as pool:
        told = list(pool.map(swap, range(3)))
    assert [each["source"] for each in told] == ["0.cpp", "1.cpp", "2.cpp"]
    assert {each["verdict"] for each in told} <= {"committed", *KEPT}
    assert sum("probation" in each for each in told) <= 2, "cut short by the next one"
