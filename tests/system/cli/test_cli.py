# SPDX-License-Identifier: Apache-2.0
"""`lithe` as a person and a script use it, against the real Spine and the real compile service."""

import concurrent.futures
import json
import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

from system.robot_rig import BIN, ROOT, RobotRig, alive

LAWS = ROOT / "laws"


def test_run_arms_and_every_verb_does_what_it_says(rig: RobotRig) -> None:
    """The whole list of design section 10, in the order a person would try it."""
    rig.run()
    status = rig.ask("status")
    assert (status["robot"], status["mode"], status["fault"], status["law"]) == ("arm", "active", "none", "pd")
    assert status["rate_hz"] == 1000.0
    assert set(status["release_jitter_us"]) == {"p50", "p99", "p999", "max"}
    assert rig.ask("hold")["mode"] == "hold"
    assert rig.ask("arm")["mode"] == "active"
    assert rig.ask("disarm")["mode"] == "disarmed"
    assert rig.ask("hold", code=1)["error"]["code"] == "refused_mode"
    assert rig.ask("arm")["mode"] == "active"
    assert rig.ask("estop")["mode"] == "estop"
    refused = rig.ask("arm", code=1)["error"]
    assert refused["code"] == "refused_estop" and "lithe reset" in refused["next"]
    assert rig.ask("reset")["mode"] == "disarmed"
    assert rig.ask("reset", code=1)["error"]["code"] == "refused_mode"
    assert rig.ask("arm")["mode"] == "active"
    kinds = [each["kind"] for each in rig.ask("events")["events"]]
    wanted = ["law_committed", "armed", "held", "disarmed", "estop", "reset"]
    assert [kind for kind in wanted if kind not in kinds] == []
    assert rig.lithe("top", "--turns", "2").returncode == 0


def test_each_law_swaps_in_and_rollback_returns(rig: RobotRig) -> None:
    """A swap tells its whole story and leaves it on disk."""
    rig.run()
    laws = sorted(each for each in LAWS.glob("*.cpp") if not each.stem.endswith("_test"))
    for number, law in enumerate(laws, 2):  # the first record is the first law's
        swap = rig.ask("swap", law)
        assert swap["verdict"] == "committed" and swap["commit_tick"] > 0
        order = [swap["times_ns"][word] for word in ("submitted", "started", "compiled", "staged", "committed")]
        assert order == sorted(order)
        assert swap.pop("certificate") == f"{number:04}.json"
        record = json.loads((rig.dir / "out" / "arm" / "swaps" / f"{number:04}.json").read_text())
        later = {"verdict", "stage", "times_ns"}  # the record goes on when the answer has left
        assert {key: record[key] for key in swap if key not in later} == {
            key: value for key, value in swap.items() if key not in later
        }
        assert record["times_ns"] | swap["times_ns"] == record["times_ns"]
        assert rig.ask("status")["law"] == swap["law"]
    before = rig.ask("status")["law_id"]
    rig.ask("swap", LAWS / "hold.cpp")
    held = rig.ask("status")["law_id"]
    back = rig.ask("rollback")
    assert back["law_id"] == before and back["left"] == {"law": "hold", "law_id": held}
    dropped = back["dropped"]
    assert [(each["law"], each["law_id"]) for each in dropped] == [("hold", held)]
    assert (rig.dir / "out" / "arm" / dropped[0]["source"]).read_text() == (LAWS / "hold.cpp").read_text()
    far = rig.ask("rollback", "2")
    assert [each["law_id"] for each in far["dropped"]] == [before, before - 1] and far["law_id"] == before - 2
    names = {each["name"] for each in rig.ask("law", "list")["files"]}
    assert {law.stem for law in laws} == names


def test_a_wrong_law_changes_nothing_and_says_why(rig: RobotRig) -> None:
    """Diagnostics with file and line, exit code 1, a record, and the same law as before."""
    rig.run()
    wrong = rig.dir / "wrong.cpp"
    wrong.write_text('#include <lithe/law.hpp>\nstruct Wrong { int x = "no"; };\n')
    before = rig.ask("status")["law_id"]
    error = rig.ask("swap", wrong, code=1)["error"]
    assert error["code"] == "compile_failed" and "wrong.cpp:2" in error["message"]
    assert error["detail"]["diagnostics"][0]["line"] == 2
    assert rig.ask("status")["law_id"] == before
    record = json.loads((rig.dir / "out" / "arm" / "swaps" / "0002.json").read_text())
    assert record["verdict"] == "refused" and record["error"]["code"] == "compile_failed"
    assert rig.ask("law", "check", wrong, code=1)["error"]["code"] == "compile_failed"
    assert rig.ask("law", "check", LAWS / "pd.cpp")["law"]["name"] == "pd"
    assert "wrong.cpp:2" in rig.lithe("swap", str(wrong)).stderr
    assert rig.ask("swap", rig.dir / "absent.cpp", code=2)["error"]["code"] == "no_source"


def test_parameters_are_read_set_and_kept_in_their_range(rig: RobotRig) -> None:
    """Live values, ranges in the refusal, and parameters that come with a swap."""
    rig.run()
    params = {each["name"]: each for each in rig.ask("param", "get")["params"]}
    name, param = next(iter(params.items()))
    middle = 0.9 * param["value"]  # near enough to be good
    changed = rig.ask("param", "set", name, str(middle))
    assert next(each["value"] for each in changed["params"] if each["name"] == name) == middle
    assert rig.ask("param", "get", name)["params"][0]["value"] == middle
    error = rig.ask("param", "set", f"{name}={param['max'] + 1}", code=1)["error"]
    assert error["code"] == "refused_range" and str(name) in error["message"]
    assert rig.ask("param", "set", "no_such=1", code=1)["error"]["code"] == "unknown_param"
    assert rig.ask("param", "set", f"{name}=nan", code=2)["error"]["code"] == "usage"
    assert rig.ask("param", "get", name)["params"][0]["value"] == middle
    rig.ask("swap", LAWS / "pd.cpp", "--param", f"{name}={param['min']}")
    assert rig.ask("param", "get", name)["params"][0]["value"] == param["min"]
    law_id = rig.ask("status")["law_id"]
    error = rig.ask("swap", LAWS / "pd.cpp", "--param", f"{name}={param['max'] + 1}", code=1)["error"]
    assert error["code"] == "refused_range"
    assert rig.ask("status")["law_id"] == law_id


def test_many_clients_swap_at_once_and_each_gets_its_own_verdict(rig: RobotRig) -> None:
    """Requests wait their turn; one in three is wrong and harms nobody."""
    rig.run()
    wrong = rig.dir / "wrong.cpp"
    wrong.write_text("this is not C++\n")
    laws = [wrong if i % 3 == 0 else LAWS / ("pd.cpp" if i % 2 else "hold.cpp") for i in range(9)]
    with concurrent.futures.ThreadPoolExecutor(9) as pool:
        answers = list(pool.map(lambda law: rig.ask("swap", law, code=1 if law == wrong else 0), laws))
    ticks = [each["commit_tick"] for each in answers if "commit_tick" in each]
    assert len(ticks) == 6 and len(set(ticks)) == 6


def test_ctrl_c_stops_everything_and_leaves_nothing(rig: RobotRig) -> None:
    """SIGINT, SIGTERM and `lithe stop`: exit 0, no process, no segment, no socket."""
    for stop in (signal.SIGINT, signal.SIGTERM, None):
        process = rig.run()
        status = rig.ask("status")
        if stop is None:
            rig.ask("stop")
        else:
            process.send_signal(stop)
        assert process.wait(30) == 0, rig.log()
        assert not alive(status["spine_pid"]) and not alive(status["lawd_pid"])
        assert rig.segments() == [] and not rig.socket.exists()
        assert "disarmed" in rig.log()


def test_a_dead_spine_is_explained_and_exits_3(rig: RobotRig) -> None:
    """The reason, the last tick, and no orphan."""
    process = rig.run()
    status = rig.ask("status")
    os.kill(status["spine_pid"], signal.SIGKILL)
    assert process.wait(30) == 3
    assert "killed by signal 9" in rig.log() and "last tick" in rig.log()
    assert not alive(status["lawd_pid"]) and rig.segments() == []


def test_the_robot_outlives_its_supervisor_and_is_adopted(rig: RobotRig) -> None:
    """SIGKILL of the supervisor: the Spine ticks on, lawd dies, a new `lithe run` takes over."""
    process = rig.run()
    before = rig.ask("status")
    process.kill()
    process.wait()
    rig.wait_for(lambda: not alive(before["lawd_pid"]))
    time.sleep(0.2)
    assert alive(before["spine_pid"])
    for verb in ("status", "arm", "stop"):
        alone = rig.ask(verb, code=1)["error"]
        assert alone["code"] == "no_supervisor" and f"pid {before['spine_pid']}) ticks: mode active" in alone["message"]
        assert f"lithe run {rig.config}" in alone["next"]
    rig.socket.unlink(missing_ok=True)
    second = rig.run()
    rig.wait_for(lambda: rig.lithe("status").returncode == 0)
    after = rig.ask("status")
    assert after["adopted"] and after["spine_pid"] == before["spine_pid"] and after["tick"] > before["tick"]
    assert after["mode"] == "active" and after["law"] == "pd"
    assert rig.ask("swap", LAWS / "hold.cpp")["verdict"] == "committed"
    second.send_signal(signal.SIGTERM)
    assert second.wait(30) == 0
    assert not alive(before["spine_pid"]) and rig.segments() == []


def test_estop_works_without_a_supervisor(rig: RobotRig) -> None:
    """Straight through shared memory, and the next supervisor finds it latched."""
    process = rig.run()
    process.kill()
    process.wait()
    assert rig.ask("estop")["mode"] == "estop"
    rig.socket.unlink(missing_ok=True)
    rig.run()
    rig.wait_for(lambda: rig.lithe("status").returncode == 0)
    assert rig.ask("status")["mode"] == "estop"
    assert rig.ask("arm", code=1)["error"]["code"] == "refused_estop"
    assert rig.ask("reset")["mode"] == "disarmed"
    assert rig.ask("arm")["mode"] == "active"


def test_a_second_run_of_the_same_robot_is_refused_with_the_pid(rig: RobotRig) -> None:
    """And the first one does not notice."""
    first = rig.run()
    second = rig.run(wait=False)
    assert second.wait(30) == 1
    assert f"pid {first.pid}" in rig.log(1)
    assert rig.ask("status")["mode"] == "active"


def test_files_of_a_crashed_run_are_no_obstacle(rig: RobotRig) -> None:
    """Everything killed at once; the next start cleans up."""
    process = rig.run()
    status = rig.ask("status")
    process.kill()
    os.kill(status["spine_pid"], signal.SIGKILL)
    process.wait()
    rig.wait_for(lambda: not alive(status["spine_pid"]))
    assert rig.socket.exists() and rig.segments() != []
    rig.socket.unlink()  # only so that the wait in run() means the new one
    rig.run()
    assert rig.ask("status")["spine_pid"] != status["spine_pid"]


def test_a_crash_of_the_compile_service_is_repaired(rig: RobotRig) -> None:
    """The request in its hands is refused with the reason; the next one works."""
    rig.run()
    status, since = rig.ask("status"), rig.ask("events")["cursor"]
    os.kill(status["lawd_pid"], signal.SIGSTOP)
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        swap = pool.submit(rig.ask, "swap", LAWS / "hold.cpp", code=1)
        rig.wait_for_event("swap_submitted", since)
        os.kill(status["lawd_pid"], signal.SIGKILL)
        assert swap.result()["error"]["code"] == "lawd_died"
    assert rig.ask("swap", LAWS / "hold.cpp")["verdict"] == "committed"
    assert rig.ask("status")["lawd_restarts"] == 1


def test_the_socket_survives_what_clients_do(rig: RobotRig) -> None:
    """Garbage, a request over 1 MiB, and a client that leaves in the middle of its swap."""
    rig.run()
    assert rig.raw(b"}{\n")["error"]["code"] == "bad_request"
    assert rig.raw(b'{"id":1,"verb":"dance"}\n')["error"]["code"] == "unknown_verb"
    big = json.dumps({"id": 1, "verb": "swap", "args": {"source": "x" * (1 << 20)}}).encode()
    assert rig.raw(big + b"\n")["error"]["code"] == "too_long"
    source = (LAWS / "hold.cpp").read_text()
    with socket.socket(socket.AF_UNIX) as link:
        link.connect(str(rig.socket))
        link.sendall(json.dumps({"verb": "swap", "args": {"source": source, "name": "hold.cpp"}}).encode() + b"\n")
    rig.wait_for(lambda: rig.ask("status")["law"] == "hold")


def test_a_swap_leaves_a_record_from_the_moment_it_is_queued(rig: RobotRig) -> None:
    """Its client is gone before the compiler has begun; what becomes of it is written down all the same."""
    process = rig.run()
    lawd = rig.ask("status")["lawd_pid"]
    record = rig.dir / "out" / "arm" / "swaps" / "0002.json"  # the first record is the first law's

    def verdict(path: Path) -> str:
        return str(json.loads(path.read_text())["verdict"]) if path.exists() else "none"

    source = (LAWS / "hold.cpp").read_text()
    request = json.dumps({"verb": "swap", "args": {"source": source, "name": "hold.cpp"}}).encode() + b"\n"
    os.kill(lawd, signal.SIGSTOP)
    try:
        for _ in range(2):
            with socket.socket(socket.AF_UNIX) as link:
                link.connect(str(rig.socket))
                link.sendall(request)
        second = record.with_name("0003.json")
        rig.wait_for(lambda: second.exists())
        assert (verdict(record), verdict(second)) == ("submitted", "submitted")
    finally:
        os.kill(lawd, signal.SIGCONT)
    rig.wait_for(lambda: {verdict(record), verdict(second)} <= {"committed", "unproven"})
    os.kill(lawd, signal.SIGSTOP)
    with socket.socket(socket.AF_UNIX) as link:
        link.connect(str(rig.socket))
        link.sendall(request)
        rig.wait_for(lambda: record.with_name("0004.json").exists())
        process.kill()
    assert verdict(record.with_name("0004.json")) == "submitted", "nobody knows what became of it, and it says so"


def test_nine_checks_at_once_are_one_too_many(rig: RobotRig) -> None:
    """Beside the one in the compiler's hands eight may wait; the next is refused at once and says why."""
    rig.run()
    lawd = rig.ask("status")["lawd_pid"]
    request = json.dumps({"verb": "law_check", "args": {"source": (LAWS / "pd.cpp").read_text()}}).encode() + b"\n"
    os.kill(lawd, signal.SIGSTOP)
    with socket.socket(socket.AF_UNIX) as link:
        link.connect(str(rig.socket))
        link.settimeout(60)
        link.sendall(request * 10)
        with link.makefile("rb") as lines:
            first = json.loads(lines.readline())
            assert first["error"]["code"] == "busy"
            os.kill(lawd, signal.SIGCONT)
            assert all(json.loads(lines.readline())["ok"] for _ in range(9))


def test_a_full_disk_loses_the_record_and_nothing_else(rig: RobotRig) -> None:
    """The place of the records is a file: no directory can be made there."""
    (rig.dir / "out").write_text("in the way")
    rig.run()
    assert rig.ask("swap", LAWS / "hold.cpp")["verdict"] == "committed"
    assert "cannot create" in rig.log()


def test_a_robot_that_starts_is_not_said_to_be_absent(rig: RobotRig) -> None:
    process = rig.run(wait=False)
    rig.wait_for(lambda: any(rig.socket.parent.glob("*.pid")))
    process.send_signal(signal.SIGSTOP)  # held where it is
    said = json.loads(rig.lithe("--json", "status").stdout)
    process.send_signal(signal.SIGCONT)
    assert said["error"]["code"] in ("starting", "no_answer"), said


def test_usage_errors_exit_2(rig: RobotRig) -> None:
    """Unknown words, missing words, a wrong robot file, no robot at all."""
    for words in ((), ("dance",), ("swap",), ("law",), ("param", "set"), ("status", "--no-such")):
        assert rig.lithe(*words).returncode == 2, words
    assert rig.lithe("--help").returncode == 0
    assert rig.ask("status", code=1)["error"]["code"] == "no_robot"
    wrong = rig.dir / "wrong.toml"
    wrong.write_text('name = "arm"\nrate = 1000\n')
    done = rig.lithe("run", wrong)
    assert done.returncode == 2 and "wrong.toml:2" in done.stderr
    assert rig.lithe("run", rig.dir / "absent.toml").returncode == 2
    for words, said in (
        (("--nosuch",), "no option '--nosuch'"),
        (("jog", "elbow", "abc"), "a number is wanted"),
        (("law", "check", wrong), "does not end in .cpp"),
        (("swap", "grvity_pd"), "next: did you mean 'gravity_pd'? one of: constant_torque, gravity_pd, hold,"),
        (("swap", "grvity_pd.cpp"), "next: did you mean 'gravity_pd'?"),
        (("law", "check", "laws/gravity.cpp"), "next: did you mean 'gravity_pd'?"),
        (("swap", "damp"), "next: 'damp' is the guard's, no law: lithe estop (the drives damp), lithe disarm (off)"),
        (("swap", "wheels"), "next: one of: constant_torque, gravity_pd, hold,"),
        (("run", rig.config, "--law", "absent.cpp"), "cannot read the law absent.cpp"),
        (("sim", rig.dir / "absent.toml"), "absent.toml"),
        (("sim", "--fault", "garbage", rig.config), "not a JSON object"),
    ):
        done = rig.lithe(*words)
        assert done.returncode == 2 and said in done.stderr, (words, done.stderr)
    for verb in ("verify", "show"):
        assert "there is no folder" in rig.lithe("law", verb, "--folder", rig.dir / "none").stderr
    assert "there is no folder" in rig.lithe("incident", "list", "--folder", rig.dir / "none").stderr


def test_a_first_law_that_does_not_compile_refuses_the_start(rig: RobotRig) -> None:
    """Exit 1 with the compiler's words; no process stays."""
    wrong = rig.dir / "wrong.cpp"
    wrong.write_text("#include <lithe/law.hpp>\nint x = y;\n")
    process = rig.run("--law", str(wrong), wait=False)
    assert process.wait(60) == 1
    assert "wrong.cpp:2" in rig.log() and rig.segments() == []


def test_no_arm_leaves_the_drives_off(rig: RobotRig) -> None:
    """Until somebody arms."""
    rig.run("--no-arm")
    assert rig.ask("status")["mode"] == "disarmed"
    assert rig.ask("arm")["mode"] == "active"


def cpus_of(pid: int) -> set[int]:
    """Cores a process may use."""
    return os.sched_getaffinity(pid)


def test_nobody_but_the_spine_uses_its_core(rig: RobotRig) -> None:
    """Supervisor and compile service keep off, and compilers come last."""
    process = rig.run()
    status: dict[str, Any] = rig.ask("status")
    taken = status["cpus"]["spine"]
    if len(os.sched_getaffinity(0)) > 1:
        assert taken not in cpus_of(process.pid) and taken not in cpus_of(status["lawd_pid"])
    assert os.sched_getscheduler(status["lawd_pid"]) == os.SCHED_IDLE
    assert os.getpriority(os.PRIO_PROCESS, status["lawd_pid"]) == 19
    devices = status["cpus"]["spine_core"]["interrupts"]
    assert len(devices["named"]) == min(devices["count"] or 0, 8) and "may land there" in devices["words"]
    assert "    interrupts: " in rig.lithe("status").stdout


def test_run_announces_itself_in_json(rig: RobotRig) -> None:
    """One line on stdout that a program can wait for."""
    process = rig.run("--json")
    rig.wait_for(lambda: '"running"' in rig.log())
    line = next(each for each in rig.log().splitlines() if '"running"' in each)
    assert json.loads(line)["supervisor_pid"] == process.pid
    assert Path(json.loads(line)["socket"]) == rig.socket
    assert isinstance(process, subprocess.Popen)


def test_words_of_python_run_its_modules_and_say_what_is_missing(tmp_path: Path) -> None:
    """The rest of the line and the exit code pass; without an interpreter that has the package, the way on."""

    def said(*words: str | Path, **env: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(words, check=False, capture_output=True, text=True, timeout=120, env=os.environ | env)

    for name in ("agent", "mcp", "evolve", "identify", "model"):
        done = said(BIN / "lithe", name, "--help")
        assert done.returncode == 0 and f"python -m lithe.{name}" in done.stdout, done.stdout + done.stderr
        done = said(BIN / "lithe", name, "--no-such")
        assert done.returncode == 2 and "usage: " in done.stderr, done.stderr
    done = said(shutil.copy(BIN / "lithe", tmp_path / "lithe"), "agent", PATH=str(tmp_path))
    assert done.returncode == 2, done.stderr
    assert "needs a Python with the package lithe" in done.stderr and "tools/setup" in done.stderr, done.stderr
