# SPDX-License-Identifier: Apache-2.0
"""What happens around a swap: the running law goes on, the client hears why, and a certificate tells."""

import concurrent.futures
import contextlib
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from system.robot_rig import ROOT, RobotRig, alive
from system.swapping import Asks, assert_chained, becomes, certificate, certificates, law, swap_request

# A good law that takes its compiler a second or two.
SLOW = """
#include <lithe/law.hpp>
constexpr unsigned long work() {
  unsigned long n = %d;
  for (int i = 0; i < 5; ++i)
    for (int j = 0; j < 100000; ++j) n = n * 1664525UL + 1013904223UL;
  return n;
}
struct Slow {
  struct Params {};
  struct State {};
  static void step(const lithe::Tick& in, const Params&, State&, lithe::Effort& out) {
    constexpr unsigned long kWork = work();
    static_assert(kWork != 0);
    out.torque_nm[0] = -0.5 * in.position_rad[0] - 0.02 * in.velocity_rad_s[0];
  }
};
LITHE_LAW(Slow, "slow");
"""
COMPILER = "cc1plus"


def slow_request(seed: int) -> dict[str, object]:
    return {"verb": "swap", "args": {"source": SLOW % seed, "name": "slow.cpp"}}


def compilers_of(lawd: int) -> list[int]:
    """Those that work for one compile service, and no others."""
    parents, found = {}, []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # gone meanwhile
            match = re.match(r"(\d+) \((.*)\) . (\d+)", stat.read_text())
            if match:
                parents[int(match[1])] = int(match[3])
                found += [int(match[1])] if match[2] == COMPILER else []
    return [pid for pid in found if lawd in (parents.get(pid), parents.get(parents.get(pid, 0)))]


def wait_for_source(rig: RobotRig, text: str) -> None:
    """Until the certificate of a swap with this source is there: it is queued."""
    wanted = hashlib.sha256(text.encode()).hexdigest()
    rig.wait_for(lambda: wanted in {each["source_sha256"] for each in certificates(rig)})


def ticks_on(rig: RobotRig) -> None:
    """The law that ran goes on: mode active, and time passes."""
    before = rig.ask("status")
    rig.wait_for(lambda: rig.ask("status")["tick"] > before["tick"] + 20)
    assert rig.ask("status")["mode"] == "active"


@contextlib.contextmanager
def stopped(pid: int) -> Iterator[None]:
    """A process that does not get on."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


@pytest.fixture
def own_cache(rig: RobotRig) -> RobotRig:
    """Armed, with a law cache of its own: a killed compiler costs nobody else the precompiled contract."""
    rig.env["LITHE_CACHE_DIR"] = str(rig.dir / "cache")
    rig.run()
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
    return rig


def test_a_source_that_is_removed_while_it_is_compiled_is_not_missed(arm: RobotRig) -> None:
    """The client read it when it was asked to."""
    path = arm.dir / "mine.cpp"
    text = (ROOT / "laws/gravity_pd.cpp").read_text()
    path.write_text(text)
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        with stopped(arm.ask("status")["lawd_pid"]):
            asked = pool.submit(arm.ask, "swap", path)
            wait_for_source(arm, text)
            path.unlink()
        assert certificate(arm, asked.result()["request_id"])["verdict"] in ("committed", "unproven", "confirmed")
    error = arm.ask("swap", path, code=2)["error"]
    assert error["code"] == "no_source"
    assert_chained(arm)


def test_a_compiler_that_is_killed_once_is_run_again(own_cache: RobotRig) -> None:
    """Whoever killed it (the kernel, short of memory): the law is not to blame, and the service lives."""
    lawd = own_cache.ask("status")["lawd_pid"]
    asked = Asks(own_cache, [slow_request(1)])
    own_cache.wait_for(lambda: compilers_of(lawd))
    os.kill(compilers_of(lawd)[0], signal.SIGKILL)
    (answer,) = asked.wait()
    assert answer["ok"], answer
    assert own_cache.ask("status")["lawd_pid"] == lawd
    headers = (own_cache.dir / "cache/contract").glob("*/lithe/law.hpp.gch")
    assert len(list(headers)) == 1, "the contract is precompiled again"


def test_a_compiler_that_is_killed_every_time_costs_the_law_it_had(own_cache: RobotRig) -> None:
    """The reason names it; the next request is served by the same service."""
    status = own_cache.ask("status")
    asked = Asks(own_cache, [slow_request(2)])
    while asked.thread.is_alive():
        for pid in compilers_of(status["lawd_pid"]):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.01)
    (answer,) = asked.wait()
    assert answer["error"]["code"] == "compile_failed" and "illed" in answer["error"]["message"], answer
    told = certificate(own_cache, answer["error"]["detail"]["swap"]["request_id"])
    assert (told["verdict"], told["refused_after"]) == ("refused", "submitted")
    assert law(own_cache) == "pd"
    ticks_on(own_cache)
    assert own_cache.ask("swap", "gravity_pd")["verdict"] == "committed"
    assert own_cache.ask("status")["lawd_restarts"] == status["lawd_restarts"]


class SmallDisk:
    """A disk of its own for one directory of a RobotRig, seen by that robot only."""

    def __init__(self, rig: RobotRig, name: str, size: str) -> None:
        """Mounted when the robot starts. Skips where this user may not mount anything."""
        self.rig = rig
        self.dir = rig.dir / name
        self.dir.mkdir()
        words = ["unshare", "-m"] if os.geteuid() == 0 else ["unshare", "-rm"]
        mount = f'mount -t tmpfs -o size={size},mode=0750 tmpfs "$0" && exec "$@"'
        rig.wrapper = [*words, "sh", "-c", mount, str(self.dir)]
        may = subprocess.run([*rig.wrapper, "true"], check=False, capture_output=True, text=True)
        if may.returncode != 0:
            pytest.skip(f"no privilege to mount a small disk: {may.stderr.strip()}")

    @property
    def seen(self) -> Path:
        """The directory as the robot's supervisor sees it."""
        return Path(f"/proc/{self.rig.ask('status')['supervisor_pid']}/root{self.dir}")

    def fill(self) -> None:
        """To the last byte."""
        with (self.seen / "filler").open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(1 << 20))
        with (self.seen / "rest").open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(512))

    def clear(self) -> None:
        """Room again."""
        for name in ("filler", "rest"):
            (self.seen / name).unlink()


def test_a_full_disk_under_the_law_cache_refuses_the_law_and_says_so(rig: RobotRig) -> None:
    """Code cache_failed; once there is room the same law is compiled."""
    disk = SmallDisk(rig, "cache", "256m")
    rig.env["LITHE_CACHE_DIR"] = str(disk.dir)
    rig.run()
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
    disk.fill()
    error = rig.ask("swap", "gravity_pd", code=1)["error"]
    assert error["code"] == "cache_failed" and "full" in error["message"], error
    told = certificate(rig, error["detail"]["swap"]["request_id"])
    assert (told["verdict"], told["refused_after"], told["error"]["code"]) == ("refused", "submitted", "cache_failed")
    assert law(rig) == "pd"
    ticks_on(rig)
    disk.clear()
    assert rig.ask("swap", "gravity_pd")["verdict"] == "committed"
    assert_chained(rig)


def test_a_full_disk_under_the_certificates_costs_no_swap_and_is_told(rig: RobotRig) -> None:
    """The answer carries the certificate and says that no file could be made; with room again it is made up for."""
    disk = SmallDisk(rig, "out", "256k")
    rig.run()
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
    swaps = disk.seen / "arm/swaps"
    rig.wait_for(lambda: "measured" in json.loads((swaps / "0001.json").read_text()))
    disk.fill()
    done = rig.ask("swap", "gravity_pd", "--probation", "3s")
    assert done["verdict"] == "committed" and "No space left" in done["record_lost"], done
    assert "No space left" in rig.log() and law(rig) == "gravity_pd"
    assert "certificate" in rig.lithe("swap", "pd").stdout
    ticks_on(rig)
    disk.clear()
    assert "record_lost" not in rig.ask("swap", "gravity_pd")

    def made_up_for() -> bool:
        told = [json.loads(path.read_text()) for path in swaps.glob("*.json")]
        return len(told) == 4 and all("measured" in each for each in told)

    rig.wait_for(made_up_for)
    chain = rig.ask("law", "verify", "--folder", swaps)
    assert chain["holds"] and chain["certificates"] == 4
    assert rig.ask("law", "show", "2", "--folder", swaps)["law"] in ("gravity_pd", "pd")


def test_certificates_that_found_no_room_until_the_end_are_told_as_lost(rig: RobotRig) -> None:
    """The robot stops in order; the log says how many there were, and where they should have been."""
    disk = SmallDisk(rig, "out", "256k")
    process = rig.run()
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
    disk.fill()
    assert "record_lost" in rig.ask("swap", "gravity_pd")
    process.terminate()
    assert process.wait(60) == 0
    assert f"lost: nothing could be written to {disk.dir}/arm/swaps" in rig.log()


@pytest.mark.alone
@pytest.mark.parametrize(
    ("names", "load_s"),
    [(["gravity_pd"], 6), pytest.param(["gravity_pd", "pd", "hold"], 20, marks=pytest.mark.long)],
)
def test_a_loader_that_is_starved_on_its_core_makes_a_swap_slow_and_no_worse(
    arm: RobotRig, names: list[str], load_s: int
) -> None:
    """Six processes that want its core for themselves; done or refused with a reason, and the law runs."""
    core = arm.ask("status")["cpus"]["housekeeping"]
    busy = f"import os, sys, time; os.sched_setaffinity(0, [int(sys.argv[1])]); end = time.monotonic() + {load_s}\n"
    busy += "while time.monotonic() < end: pass"
    load = [subprocess.Popen([sys.executable, "-IS", "-c", busy, str(core)]) for _ in range(6)]
    try:
        for name in names:
            before = law(arm)
            path = arm.dir / f"{name}.cpp"
            path.write_text((ROOT / f"laws/{name}.cpp").read_text() + f"// {arm.dir.name}\n")  # not in the cache
            asked = arm.lithe("--json", "swap", path)
            told = json.loads(asked.stdout)
            if asked.returncode == 0:
                assert certificate(arm, told["request_id"])["verdict"] in ("committed", "unproven", "confirmed")
                assert law(arm) == name
            else:
                assert told["error"]["code"] in ("compile_starved", "trial_starved", "timeout"), told
                assert certificate(arm, told["error"]["detail"]["swap"]["request_id"])["verdict"] == "refused"
                assert law(arm) == before
            ticks_on(arm)
    finally:
        for each in load:
            each.kill()
            each.wait()
    assert_chained(arm)


def test_a_client_that_leaves_in_the_middle_leaves_nothing_half_done(arm: RobotRig) -> None:
    """What was asked for whole is done and certified; a line without an end was never asked for."""
    before = len(certificates(arm))
    with stopped(arm.ask("status")["lawd_pid"]):
        for request in (swap_request("gravity_pd"), swap_request("hold")):
            asked = Asks(arm, [request])
            wait_for_source(arm, request["args"]["source"])
            asked.leave()
        whole = json.dumps({"id": 1, **swap_request("pd")}).encode()
        cut = Asks(arm, [])
        cut.link.sendall(whole[: len(whole) // 2])
        cut.leave()
        ticks_on(arm)
    done = [each["request_id"] for each in certificates(arm)[before:]]
    for request_id, name in zip(done, ("gravity_pd", "hold"), strict=True):
        told = becomes(arm, request_id, lambda each: each["verdict"] in ("committed", "unproven", "confirmed"))
        assert told["law"] == name
    arm.wait_for(lambda: law(arm) == "hold")
    assert len(certificates(arm)) == before + 2
    assert_chained(arm)


@pytest.mark.parametrize("stage", ["submitted", "shadow"])
def test_a_spine_that_is_killed_ends_the_swap_with_a_reason(arm: RobotRig, stage: str) -> None:
    """The client hears it, the certificate says it, the supervisor leaves with 3."""
    status = arm.ask("status")
    terms = {"shadow_s": 20.0} if stage == "shadow" else {}
    with stopped(status["lawd_pid"]) if stage == "submitted" else contextlib.nullcontext():
        asked = Asks(arm, [swap_request("gravity_pd", **terms)])
        arm.wait_for(lambda: len(certificates(arm)) == 2)
        if stage == "shadow":
            arm.wait_for(lambda: "shadow_started" in [each["kind"] for each in arm.ask("events")["events"]])
        os.kill(status["spine_pid"], signal.SIGKILL)
        (answer,) = asked.wait()
    error = answer["error"]
    assert error["code"] == "robot_fault" and "the Spine" in error["message"] and error["next"], answer
    told = certificate(arm, error["detail"]["swap"]["request_id"])
    verdict = "refused" if stage == "submitted" else "not_confirmed"  # what the Spine had, it may have committed
    assert (told["verdict"], told["refused_after"]) == (verdict, stage)
    assert arm.started[0].wait(60) == 3
    arm.wait_for(lambda: not alive(status["lawd_pid"]))
    assert_chained(arm)


def test_two_clients_with_different_laws_are_served_one_after_the_other(arm: RobotRig) -> None:
    """Both laws are committed, each on a tick of its own; the later one runs."""
    clients = [Asks(arm, [swap_request(name)]) for name in ("gravity_pd", "hold")]
    answers = [answer for client in clients for answer in client.wait()]
    assert all(answer["ok"] for answer in answers), answers
    done = sorted((answer["result"] for answer in answers), key=lambda each: each["commit_tick"])
    assert {each["law"] for each in done} == {"gravity_pd", "hold"}
    assert done[0]["commit_tick"] < done[1]["commit_tick"]
    assert law(arm) == done[1]["law"]
    told = [certificate(arm, each["request_id"]) for each in done]
    assert told[0]["times_ns"]["committed"] <= told[1]["times_ns"]["started"], "the second waited for the first"
    assert_chained(arm)
