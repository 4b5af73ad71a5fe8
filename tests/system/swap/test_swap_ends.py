# SPDX-License-Identifier: Apache-2.0
"""A swap: every way it can end, and the certificate that it leaves."""

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from calm import connected
from lithe._wire import TelemetryFlags
from system.robot_rig import BIN, ROOT, RobotRig, alive
from system.swapping import Asks, assert_chained, becomes, certificate, certificates, law, swap_request, sway

HOSTILE = ROOT / "tests/laws_hostile"
MOODY = """
#include <lithe/law.hpp>
// Good for so many steps, 0 = for ever: a trial looks at 4000 in a row at most.
struct Moody {
  struct Params {
    lithe::Param crash_after{0, 0, 1e6};
    lithe::Param lean_after{0, 0, 1e6};
    lithe::Param lean_nm{0, -0.5, 0.5};
  };
  struct State {
    std::uint32_t steps = 0;
  };
  static void step(const lithe::Tick& in, const Params& p, State& s, lithe::Effort& out) {
    ++s.steps;
    if (p.crash_after > 0 && s.steps > p.crash_after) *(volatile int*)8 = 1;
    const bool leans = s.steps > p.lean_after && p.lean_nm != 0.0;
    out.torque_nm[0] = leans ? double(p.lean_nm) : -0.5 * in.position_rad[0] - 0.02 * in.velocity_rad_s[0];
  }
};
LITHE_LAW(Moody, "moody");
"""


def moody(rig: RobotRig, *words: str) -> dict[str, Any]:
    """The moody law, running, and its certificate so far."""
    path = rig.dir / "moody.cpp"
    path.write_text(MOODY)
    done: dict[str, Any] = rig.ask("swap", path, *words)
    return done


def test_a_law_is_refused_at_admission_and_at_its_trial_and_the_old_one_runs_on(arm: RobotRig) -> None:
    """Each with its stage, its reason and a certificate; the Spine never hears of it."""
    for name, code, after in (
        ("global_counter", "admission_failed", "submitted"),
        ("negative_damping", "trial_failed", "placed"),
    ):
        error = arm.ask("swap", HOSTILE / f"{name}.cpp", code=1)["error"]
        assert error["code"] == code and len(error["message"]) > 20
        told = certificate(arm, error["detail"]["swap"]["request_id"])
        assert (told["verdict"], told["refused_after"], told["error"]["code"]) == ("refused", after, code)
        assert "staged" not in told["times_ns"]
    assert told["trial"]["ok"] is False and told["trial"]["report"]["loop"]["ticks"] > 0
    assert law(arm) == "pd" and arm.ask("status")["mode"] == "active"
    kinds = [each["kind"] for each in arm.ask("events")["events"]]
    assert kinds.count("swap_refused") == 2 and kinds.count("law_staged") == 1


def test_a_law_that_crashes_on_trial_is_told_its_line(arm: RobotRig) -> None:
    """From its slot, which holds no lines: the compile service has them."""
    path = arm.dir / "moody.cpp"
    path.write_text(MOODY)
    error = arm.ask("swap", path, "--param", "crash_after=1", code=1)["error"]
    line = 1 + MOODY[: MOODY.index("volatile")].count("\n")
    assert error["code"] == "trial_failed" and error["message"].startswith(f"moody.cpp:{line}: benign: ")
    assert "SIGSEGV at 0x8" in error["message"]
    assert law(arm) == "pd"


def score_of(arm: RobotRig, law_id: int) -> dict[str, Any]:
    """Of a law in the Spine, as `lithe law list` tells it."""
    found: dict[str, Any] = next(each for each in arm.ask("law", "list")["resident"] if each["law_id"] == law_id)
    return dict(found["score"])


def test_a_good_law_is_committed_confirmed_and_certified(arm: RobotRig, tell: Callable[[str], None]) -> None:
    """The answer comes at the commit; the certificate goes on."""
    done = arm.ask("swap", "gravity_pd", "--probation", "200ms", "--blend", "10ms")
    assert done["verdict"] == "committed" and done["terms"]["blend_s"] == pytest.approx(0.01)
    arm.wait_for(lambda: "law_unproven" in [each["kind"] for each in arm.ask("events")["events"]])
    sway(arm)
    told = becomes(arm, done["request_id"], lambda each: "measured" in each and each["verdict"] == "confirmed")
    source = (ROOT / "laws/gravity_pd.cpp").read_bytes()
    assert told["source_sha256"] == hashlib.sha256(source).hexdigest()
    assert len(told["object_sha256"]) == 64 and "g++" in told["toolchain"]["compiler"]
    assert "-O2" in told["toolchain"]["flags"].split()
    assert len(told["gates"]) == 13 and all(gate["ok"] for gate in told["gates"])
    assert told["trial"]["report"]["timing"]["worst_ns"] > 0
    assert told["measured"]["first_call_ns"] > 0
    assert told["measured"]["core"]["minor_faults"] is not None
    after = told["measured"]["after"]
    assert after["largest_step_nm"] <= after["slew_bound_nm"] + 1e-9
    order = [stage for stage in told["times_ns"] if stage != "started"]
    assert order[:7] == ["submitted", "compiled", "admitted", "placed", "tried", "staged", "committed"]
    assert sum(told["split_ms"].values()) == pytest.approx(told["requested_to_committed_ms"])
    arm.wait_for(lambda: "rms_error_rad" in score_of(arm, done["law_id"]))
    score = score_of(arm, done["law_id"])
    assert score["verdict"] == "confirmed" and 0 <= score["rms_error_rad"]["shoulder"] < 0.5
    assert "rms error shoulder" in arm.lithe("law", "list").stdout
    tell(f"from request to commit, in ms: {json.dumps({k: round(v, 1) for k, v in told['split_ms'].items()})}")
    assert_chained(arm)


def test_a_law_that_drives_away_is_rolled_back_within_two_ticks(arm: RobotRig, tell: Callable[[str], None]) -> None:
    """Its probation sees the tracking error grow; the law before it runs again, and the certificate says why."""
    os.environ.update({key: value for key, value in arm.env.items() if key.startswith("LITHE_")})
    with connected() as robot:
        done = moody(arm, "--probation", "30s", "--param", "lean_nm=0.12", "--param", "lean_after=6000")
        told = becomes(arm, done["request_id"], lambda each: each["verdict"] == "rolled_back")
        records = robot.telemetry.history(3.0)
    assert told["fault"]["kind"] == "tracking_lost"
    why = told["rolled_back"]["why"]
    said = re.fullmatch(r"tracking_lost: joint \w+, error ([0-9.]+) rad, allowed ([0-9.]+)", why)
    assert said and float(said[1]) >= float(said[2]) >= 0.15 and told["reasons"]["rolled_back"] == why
    bound_rad = float(said[2])  # 0.15 if the error before was 0.05 rad at most, as it is unless the machine stalls
    error_rad = np.abs(records["setpoint_position_rad"][:, 0] - records["position_rad"][:, 0])
    ours = records["law_id"] == done["law_id"]
    breach = records["tick"][ours & (error_rad > bound_rad)].min()
    tell(f"rolled back {int(told['rolled_back']['tick']) - int(breach)} ticks after the breach")
    assert told["rolled_back"]["tick"] - breach <= 2
    assert records["law_id"][records["tick"] == told["rolled_back"]["tick"] + 1] != done["law_id"]
    assert law(arm) == "pd"


def test_a_law_that_crashes_after_its_commit_is_replaced_and_its_certificate_names_the_fault(arm: RobotRig) -> None:
    """The law before it takes over in the same tick."""
    done = moody(arm, "--param", "crash_after=6000")
    assert done["verdict"] == "committed" and done["params"]["taken"] is True
    told = becomes(arm, done["request_id"], lambda each: each["verdict"] == "rolled_back")
    assert told["fault"]["kind"] == told["rolled_back"]["why"] == "bad_access"
    assert told["fault"]["to_law_id"] != 0 and told["fault"]["took_us"] > 0
    shown = arm.lithe("law", "show", "moody").stdout
    assert "  fault         kind bad_access" in shown and "why bad_access" in shown and ": not passed" in shown
    assert law(arm) == "pd" and arm.ask("status")["mode"] == "active"


def test_without_a_probation_a_law_that_drives_away_stays_and_its_crash_is_contained(arm: RobotRig) -> None:
    """`probation_s = 0`: nobody judges how it follows; the fault barrier is there all the same."""
    os.environ.update({key: value for key, value in arm.env.items() if key.startswith("LITHE_")})
    with connected() as robot:
        terms = ("--param", "lean_nm=0.12", "--param", "lean_after=4500", "--param", "crash_after=7000")
        done = moody(arm, "--no-probation", *terms)
        assert done["terms"]["probation_s"] == 0 and arm.ask("status")["probation"]["of"] == "none"
        told = becomes(arm, done["request_id"], lambda each: each["verdict"] == "rolled_back")
        records = robot.telemetry.history(3.5)
    assert told["rolled_back"]["why"] == told["fault"]["kind"] == "bad_access"
    assert told["rolled_back"]["ticks_after_commit"] >= 6900, "not before it crashed"
    assert not {"unproven", "confirmed"} & set(told["times_ns"])
    ours = records[records["law_id"] == done["law_id"]]
    error_rad = np.abs(ours["setpoint_position_rad"][:, 0] - ours["position_rad"][:, 0])
    assert (error_rad > 0.15).sum() > 500, "under a probation it would have gone at the first such tick"
    assert (ours["flags"] & TelemetryFlags.on_probation == 0).all()
    assert law(arm) == "pd" and arm.ask("status")["mode"] == "active"


POISON = """
#include <lithe/law.hpp>
// Keeps NaN in a field that the next law carries, and never shows it.
struct Poison {
  struct Params {};
  struct State {
    double integral_nm = 0;
    std::int64_t steps = 0;
  };
  static void step(const lithe::Tick& t, const Params&, State& s, lithe::Effort& u) {
    u.torque_nm[0] = SHOWN(t.setpoint_position_rad[0] - t.position_rad[0]) - 0.03 * t.velocity_rad_s[0];
    KEEPS
  }
};
LITHE_LAW(Poison, "NAME");
"""
HIDES = {
    "SHOWN": "1.0 * ",
    "KEEPS": "if (++s.steps > 100) s.integral_nm = std::numeric_limits<double>::quiet_NaN();",
    "NAME": "poison",
}
SHOWS = {
    "SHOWN": "s.integral_nm + 1.0 * ",
    "KEEPS": "s.integral_nm += 1e-3 * t.dt_s * (t.setpoint_position_rad[0] - t.position_rad[0]);",
    "NAME": "integrates",
}


def poison(rig: RobotRig, words: dict[str, str]) -> dict[str, Any]:
    """One of the two laws, swapped in."""
    text = POISON
    for old, new in words.items():
        text = text.replace(old, new)
    path = rig.dir / f"{words['NAME']}.cpp"
    path.write_text(text)
    done: dict[str, Any] = rig.ask("swap", path)
    return done


def test_a_state_full_of_nan_does_not_lock_good_laws_out(arm: RobotRig) -> None:
    """The field is not carried; answer, status, certificate and an event name it."""
    poison(arm, HIDES)
    before = arm.ask("status")["tick"]
    arm.wait_for(lambda: arm.ask("status")["tick"] > before + 500)
    done = poison(arm, SHOWS)
    assert done["state_not_carried"]["fields"] == ["integral_nm"]
    assert arm.ask("status")["last_swap"]["state_not_carried"] == ["integral_nm"]
    assert certificate(arm, done["request_id"])["state_not_carried"] == done["state_not_carried"]
    assert "State not carried: integral_nm" in arm.lithe("status").stdout
    arm.wait_for(lambda: "state_not_carried" in [each["kind"] for each in arm.ask("events")["events"]])
    told = [each["text"] for each in arm.ask("events")["events"] if each["kind"] == "state_not_carried"]
    assert told == ["integral_nm: no finite number; starts from its default"]
    assert law(arm) == "integrates" and arm.ask("status")["law_faults"] == []


HAMMER = """
#include <lithe/law.hpp>
// One keeps an amplitude in its State, the next one uses it.
struct Hammer {
  struct Params {};
  struct State {
    double amplitude_nm = 0;
  };
  static void step(const lithe::Tick& t, const Params&, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 4 * (t.setpoint_position_rad[0] - t.position_rad[0]) - 0.1 * t.velocity_rad_s[0];
    DOES
  }
};
LITHE_LAW(Hammer, "NAME");
"""


def test_a_law_that_hammers_by_a_state_that_it_carries_is_refused_at_its_trial(arm: RobotRig) -> None:
    """The trial runs it with the State of the law that runs, too; without that State it passes."""
    path = arm.dir / "hammer.cpp"
    uses = HAMMER.replace("DOES", "u.torque_nm[0] += s.amplitude_nm * (t.tick / 9 % 2 ? 1 : -1);")
    path.write_text(uses.replace("NAME", "harmless"))
    trial = certificate(arm, arm.ask("swap", path)["request_id"])["trial"]
    assert "carried" not in trial["report"]["loop"], "pd has no State"
    path.write_text(HAMMER.replace("DOES", "s.amplitude_nm = 0.4;").replace("NAME", "keeps"))
    before = arm.ask("swap", path)["commit_tick"]
    arm.wait_for(lambda: arm.ask("status")["tick"] > before + 50)
    path.write_text(uses.replace("NAME", "hammers"))
    error = arm.ask("swap", path, code=1)["error"]
    assert error["code"] == "trial_failed"
    assert "with the State that it will carry from the law that runs it changes its torque faster" in error["message"]
    assert law(arm) == "keeps"


def test_without_a_law_before_it_a_crash_ends_in_the_safe_law(rig: RobotRig) -> None:
    """There is nothing to go back to; the certificate says that too."""
    path = rig.dir / "moody.cpp"
    path.write_text(MOODY.replace("crash_after{0,", "crash_after{6000,"))
    rig.run("--law", str(path))
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
    rig.wait_for(lambda: certificates(rig)[0]["verdict"] == "rolled_back")
    assert "safe law" in certificates(rig)[0]["rolled_back"]["why"]
    assert rig.ask("status")["mode"] == "safe_stop"
    stop = rig.ask("status")["stopped_by"]
    assert "moody stopped the robot" in stop["next"] and "lithe arm --all-the-same" in stop["next"], stop
    rig.ask("reset")
    error = rig.ask("arm", code=1)["error"]
    assert error["code"] == "refused_marked" and "law moody" in error["message"], error
    assert "lithe swap hold" in error["next"], "no law was there before it"
    again = rig.ask("arm", "--all-the-same", code=3)["error"]
    assert again["detail"]["fault"] == "law_faulted", "it was armed; its State has not changed"


def test_a_shadow_that_agrees_is_promoted_and_one_that_does_not_is_refused(arm: RobotRig) -> None:
    """Same inputs, output thrown away; the answer comes after the shadow."""
    done = arm.ask("swap", "pd", "--shadow", "300ms", "--tolerance", "0.05")
    assert done["verdict"] == "committed" and done["shadow"]["ticks"] >= 300
    assert done["split_ms"]["committed"] > 200 and "shadow" in done["times_ns"]
    leans = arm.dir / "leans.cpp"
    leans.write_text(MOODY.replace("lean_nm{0,", "lean_nm{0.05,").replace('"moody"', '"leans"'))
    error = arm.ask("swap", leans, "--shadow", "300ms", "--tolerance", "0.01", code=1)["error"]
    assert error["code"] == "shadow_failed" and "tolerance" in error["message"]
    told = certificate(arm, error["detail"]["swap"]["request_id"])
    assert told["shadow"]["most_nm"][0] == pytest.approx(0.05, abs=0.02)
    assert told["refused_after"] == "shadow"
    before = arm.ask("status")["law_id"]
    done = arm.ask("swap", leans, "--shadow", "300ms", "--tolerance", "0.01", "--no-promote")
    assert done["verdict"] == "measured" and done["shadow"]["most_nm"][0] == pytest.approx(0.05, abs=0.02)
    assert arm.ask("status")["law_id"] == before
    assert law(arm) == "pd"


def test_a_trial_or_a_compile_service_that_dies_costs_the_law_it_had(arm: RobotRig) -> None:
    """The client gets the reason, the robot keeps its law, and a new one serves the next request."""
    for pid_key, code, after in (("trial_pid", "trial_died", "placed"), ("lawd_pid", "lawd_died", "submitted")):
        pid, since = arm.ask("status")[pid_key], arm.ask("events")["cursor"]
        os.kill(pid, signal.SIGSTOP)
        asked = Asks(arm, [swap_request("hold")])
        arm.wait_for_event(f"swap_{after}", since)  # it has the law in its hands
        os.kill(pid, signal.SIGKILL)
        (answer,) = asked.wait()
        assert answer["error"]["code"] == code, answer
        told = certificate(arm, answer["error"]["detail"]["swap"]["request_id"])
        assert (told["verdict"], told["refused_after"]) == ("refused", after)
        assert law(arm) == "pd"
        arm.wait_for(lambda key=pid_key, old=pid: arm.ask("status")[key] not in (0, old))
        assert arm.ask("swap", "pd")["verdict"] == "committed"


def test_two_hundred_requests_in_a_second_are_all_answered(arm: RobotRig) -> None:
    """Done or busy, from four clients at once; every one that was taken in has its certificate, and the chain holds."""
    requests = [swap_request(("pd", "gravity_pd")[i % 2], box_ms=20) for i in range(50)]
    clients = [Asks(arm, requests) for _ in range(4)]
    answers = [answer for client in clients for answer in client.wait()]
    assert len(answers) == 200
    done = [each for each in answers if each["ok"]]
    codes = {each["error"]["code"] for each in answers if not each["ok"]}
    assert codes <= {"busy", "trial_starved"}, codes
    assert len(done) >= 32
    ours = {each["request_id"]: each["verdict"] for each in certificates(arm)}
    assert all(ours[each["result"]["request_id"]] in ("committed", "unproven", "confirmed") for each in done)
    assert_chained(arm)


def test_a_newer_request_takes_the_place_of_an_older_one_if_it_says_so(arm: RobotRig) -> None:
    """Of the same client, for the same file name, and only while it waits."""
    os.kill(arm.ask("status")["lawd_pid"], signal.SIGSTOP)  # so that the first is under way, and the others wait
    asked = Asks(arm, [swap_request("pd"), swap_request("hold"), swap_request("hold", supersede=True)])
    arm.wait_for(lambda: len(asked.answers) == 1)
    assert asked.answers[0]["id"] == 1 and asked.answers[0]["error"]["code"] == "superseded"
    os.kill(arm.ask("status")["lawd_pid"], signal.SIGCONT)
    assert [each["ok"] for each in sorted(asked.wait(), key=lambda each: each["id"])] == [True, False, True]


def test_a_disarmed_or_stopped_robot_takes_a_law_but_no_shadow(arm: RobotRig) -> None:
    """The law lies ready for the next arming; a shadow needs a law that runs."""
    for command in ("disarm", "estop"):
        arm.ask(command)
        assert arm.ask("swap", "gravity_pd")["verdict"] == "committed"
        error = arm.ask("swap", "pd", "--shadow", "1s", code=1)["error"]
        assert error["code"] == "refused_mode" and "arm" in error["next"]
    assert arm.ask("status")["mode"] == "estop"


def test_terms_out_of_range_are_refused_by_name(arm: RobotRig) -> None:
    """Before anything is compiled or recorded."""
    before = len(certificates(arm))
    for args, name in (({"blend_s": -1}, "blend_s"), ({"shadow": 2}, "shadow"), ({"budget_us": 1e9}, "budget_us")):
        request = {"id": 1, **swap_request("pd", **args)}
        error = arm.raw(json.dumps(request).encode() + b"\n")["error"]
        assert error["code"] == "usage" and name in error["message"]
    assert len(certificates(arm)) == before


def test_a_robot_without_its_trial_does_not_start_unless_the_gates_are_opened(rig: RobotRig) -> None:
    """A missing program is no reason to load laws untried."""
    other = rig.dir / "bin"
    other.mkdir()
    for program in ("lithe", "lawd", "lithe-spine-sim"):
        shutil.copy(BIN / program, other)
    command = [other / "lithe", "run", rig.config]
    refused = subprocess.run(command, check=False, env=rig.env, capture_output=True, text=True, timeout=60)
    assert refused.returncode == 1 and "lithe-trial" in refused.stderr
    with (rig.dir / "ungated.log").open("w") as log:
        rig.started.append(subprocess.Popen([*command, "--ungated"], env=rig.env, stdout=log, stderr=log, text=True))
    rig.wait_for(lambda: rig.socket.exists() or rig.started[-1].poll() is not None, 60)
    assert rig.ask("status")["gates"] == "open"
    assert "THE GATES ARE OPEN" in (rig.dir / "ungated.log").read_text()
    assert "THE GATES ARE OPEN" in rig.lithe("status").stdout
    told = certificates(rig)[0]
    assert told["reasons"]["admitted"].startswith("skipped") and told["reasons"]["tried"].startswith("skipped")


def test_a_supervisor_that_is_killed_leaves_a_chain_that_the_next_one_goes_on_with(arm: RobotRig) -> None:
    """The numbers go on, the hashes fit."""
    arm.ask("swap", "gravity_pd")
    pid = arm.ask("status")["spine_pid"]
    arm.started[0].kill()
    arm.started[0].wait()
    assert alive(pid)
    arm.socket.unlink(missing_ok=True)
    arm.run()
    arm.ask("swap", "pd")
    assert [each["law"] for each in certificates(arm)] == ["pd", "gravity_pd", "pd"]
    assert_chained(arm)
