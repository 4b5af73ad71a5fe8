# SPDX-License-Identifier: Apache-2.0
"""What a soak does to its robot. Each action has random numbers of its own, and leaves no fault behind."""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import signal
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from random import Random
from typing import Any

from lithe.control import LineSocket, connect_control, run_dir
from lithe.errors import LitheError, Refused
from lithe.programs import ROOT

from . import machine
from .judge import Broken, Judge, corpus_stage
from .rig import Rig
from .watch import Watch

LAWS = sorted(path for path in (ROOT / "laws").glob("*.cpp") if not path.name.endswith("_test.cpp"))
HOSTILE = sorted((ROOT / "tests/laws_hostile").glob("*.cpp"))
VARIANTS = 40  # of each law's text: most are compiled, some come from the cache
DELAY = ("20'000", "5'000")  # steps after which a delayed law fails: later than its trial, which has 4000 in a row
BACK_S, REPLACED_S = 180.0, 120.0
BRAINS = 5  # tries to give the robot a new Brain
PLAIN = ("arm", "disarm", "hold", "reset", "estop", "recover", "rollback", "revert_params", "sim_reset", "status")
BUS = [{"fault": "drop", "share": 1.0}, {"fault": "drop", "share": 0.05}, {"fault": "corrupt", "share": 0.1},
       {"fault": "duplicate", "share": 0.5}, {"fault": "replay", "share": 0.5}, {"fault": "delay", "ms": 5},
       {"fault": "bus_off", "on": True}, {"fault": "unplug", "for_s": 0.5}]  # fmt: skip
DEVICE = (
    "reset",
    "over_temperature",
    "encoder",
    "device_fault",
    "watchdog",
    "homing",
    "register_map",
    "twin",
    "wrong_id",
)
BAD_LINES = [b"", b"{", b"[]", b"null", b'{"verb": 7}', b'{"verb": "dance"}', b'{"verb": "swap"}', b"\xff\xfe",
             b'{"verb": "swap", "args": {"source": 1}}', b'{"verb": "rollback", "args": {"steps": 1e99}}',
             b'{"verb": "set_params", "args": {"values": []}}', b'{"verb": "events", "args": {"since": -1}}',
             b'{"verb": "swap", "args": {"source": "", "probation_s": "x"}}', b"[" * 5000]  # fmt: skip
WAITS = ("refused_not_ready", "busy", "timeout")
NEEDS_LAW = ("refused_fault", "refused_law", "refused_marked")


class Soak:
    """A robot, who watches it, and the actions."""

    def __init__(self, rig: Rig, watch: Watch, judge: Judge, whole_machine: bool) -> None:
        self.rig, self.watch, self.judge = rig, watch, judge
        self.whole_machine = whole_machine
        self.load = machine.Load(rig.out / "load.log")
        self.codes: Counter[str] = Counter()  # "verb code"
        self.not_done: dict[str, str] = {}  # action: why

    def ask(self, verb: str, **args: Any) -> tuple[str, Any]:
        """Rig.ask(), counted."""
        code, told = self.rig.ask(verb, **args)
        self.codes[f"{verb} {code}"] += 1
        return code, told

    def swap(self, source: str, name: str, **terms: Any) -> str:
        """A swap whose answer is compared with its certificate; the code."""
        code, told = self.ask("swap", source=source, name=name, **terms)
        self.answered(source, code, told)
        return code

    def answered(self, source: str, code: str, told: Any) -> None:
        """The answer to a swap is compared with its certificate, which must be of this text."""
        if code == "ok":
            told["source_sha256"] = hashlib.sha256(source.encode()).hexdigest()
        self.watch.swap_answered(code, told)

    def good_law(self) -> str:
        """The robot's own law, at once and without a probation."""
        law = ROOT / "laws/pd.cpp"
        return self.swap(law.read_text(encoding="utf-8"), law.name, probation_s=0)

    def way_back(self) -> None:
        """To mode `active`, with every joint under the law and a Brain that moves them: by verbs alone."""
        brain = self.rig.processes.get("brain")
        if brain is None or brain.poll() is not None:
            self.codes["the Brain ended by itself"] += brain is not None
            self.new_brain()
        self.by_verbs()

    def new_brain(self) -> None:
        """A Brain that moves the robot. Broken: its reference is refused each time, also after the verbs."""
        for _ in range(BRAINS):
            if not (told := self.rig.start_brain()):
                return
            self.codes[f"set_reference {told}"] += 1
            self.by_verbs()
        raise Broken("way_back", f"{BRAINS} new Brains were refused their reference, the last one with '{told}'")

    def by_verbs(self) -> None:
        """To mode `active`, whoever the Brain is."""
        began, said, told = time.monotonic(), Counter[str](), ""
        while True:
            status = self.rig.status()
            verb = next_verb(status, told)
            if verb == "done":
                return self.judge.holds("way_back", True, "", way_back_s=time.monotonic() - began)
            if time.monotonic() - began > BACK_S:
                where = {key: status[key] for key in ("mode", "fault", "law", "recovering", "alarms")}
                raise Broken("way_back", f"not active after {BACK_S:.0f} s: {where}; said {dict(said)}")
            told = "" if verb == "wait" else self.good_law() if verb == "swap" else self.ask(verb)[0]
            said[f"{verb} {told}".strip()] += 1
            if told == "refused_damaged":
                raise Broken("way_back", f"memory of the Spine is damaged: {status['alarms']}")
            if verb == "wait" or told in WAITS:
                time.sleep(0.2)


def next_verb(status: dict[str, Any], told: str) -> str:
    """What a person would say next; `told` is the code of the answer before. "done" and "wait" are no verbs."""
    mode = status["mode"]
    if mode == "active":
        whole = status["fault"] == "none" and all(joint["rung"] == "law" for joint in status["joints"])
        return "done" if whole else "reset"
    if mode == "safe_stop" and told == "refused_fault":  # armed, and stopped at once
        return "swap"
    if mode in ("safe_stop", "estop") or (mode == "disarmed" and status["fault"] != "none"):
        return "reset"
    if mode == "recover":
        return "wait" if status["recovering"] else "arm"
    if told == "refused_outside":
        return "recover"
    return "swap" if told in NEEDS_LAW else "arm"


def swap_law(soak: Soak, random: Random) -> None:
    """A law that comes with LITHE."""
    law = random.choice(LAWS)
    terms: dict[str, float] = random.choice(
        [{}, {}, {"probation_s": 0}, {"probation_s": 0.3}, {"shadow_s": 0.3}, {"blend_s": 0.2}]
    )
    soak.swap(f"{law.read_text(encoding='utf-8')}// {random.randrange(VARIANTS)}\n", law.name, **terms)
    time.sleep(random.uniform(0, 1))


def swap_hostile(soak: Soak, random: Random) -> None:
    """A law that must be refused; or one that fails later, in the tick."""
    law = random.choice(HOSTILE)
    stage = corpus_stage(law)
    code = soak.swap(law.read_text(encoding="utf-8").replace(*DELAY), law.name)
    if stage in ("compile", "admission") or (stage == "trial" and soak.rig.name == "arm"):  # written for the arm
        soak.judge.must_be_refused(law.name, stage, code)
    elif code == "ok":
        time.sleep(random.uniform(0, 8))
        soak.good_law()


def params(soak: Soak, random: Random) -> None:
    """New parameters of the running law: some good, some absurd."""
    code, told = soak.ask("params")
    for _ in range(random.randrange(1, 4)):
        if code != "ok" or not told["params"]:
            return
        values = {}
        for each in random.sample(told["params"], random.randrange(1, len(told["params"]) + 1)):
            near = each["value"] * random.uniform(0.5, 2)
            values[each["name"]] = random.choice([near, near, near, random.uniform(each["min"], each["max"])])
        if random.random() < 0.2:
            values |= random.choice([{"no_such": 1.0}, {next(iter(values)): 1e300}, {next(iter(values)): "much"}])
        soak.ask("set_params", values=values)
        if random.random() < 0.3:
            soak.ask("revert_params")


def verbs(soak: Soak, random: Random) -> None:
    """Verbs in any order."""
    for _ in range(random.randrange(1, 8)):
        verb = random.choice(PLAIN)
        steps = {"steps": random.randrange(1, 5)} if verb == "rollback" else {}
        soak.ask(verb, **steps)
        time.sleep(random.uniform(0, 0.5))


def bad_requests(soak: Soak, random: Random) -> None:
    """Lines that are no requests: each is answered with a code."""
    for line in random.sample(BAD_LINES, 4):
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(60)
            link.connect(str(run_dir() / f"{soak.rig.name}.sock"))
            try:
                answer = LineSocket(link).exchange(line, "a bad request")
            except LitheError as error:
                raise Broken("answers", f"{line[:60]!r} was not answered: {error}") from None
            code = "ok" if answer.get("ok") else str((answer.get("error") or {}).get("code"))
            soak.judge.answer("a bad request", code)
            soak.codes[f"bad_request {code}"] += 1


def brain_kill(soak: Soak, random: Random) -> None:
    """SIGKILL; after a while another Brain comes."""
    soak.rig.end("brain")
    time.sleep(random.uniform(0, 3))


def brain_freeze(soak: Soak, random: Random) -> None:
    """SIGSTOP for a while."""
    brain = soak.rig.processes["brain"]
    brain.send_signal(signal.SIGSTOP)
    try:
        time.sleep(random.uniform(0.1, 3))
    finally:
        brain.send_signal(signal.SIGCONT)


def bus_fault(soak: Soak, random: Random) -> None:
    """One fault of a bus or a device, as `lithe sim` knows them."""
    config = soak.rig.config
    order: dict[str, Any] = dict(random.choice(BUS)) | {"bus": random.choice(config["bus"])["name"]}
    if random.random() < 0.6:
        order = {"fault": random.choice(DEVICE), "device": random.choice(config["device"])["name"]}
    with soak.watch.blind():
        try:
            soak.rig.order(**order)
        except LitheError:  # not every kind of device has every fault
            soak.codes[f"sim refused {order['fault']}"] += 1
            return
        soak.codes[f"sim {order['fault']}"] += 1
        time.sleep(random.uniform(0.05, 2))
        soak.rig.order(fault="clear")
        soak.way_back()


def load(soak: Soak, random: Random) -> None:
    """Busy loops and compilers, beside the next actions."""
    soak.load.start(random.randrange(1, 1 + 2 * (os.cpu_count() or 1)), random.randrange(0, 3), random.uniform(5, 20))


def memory(soak: Soak, random: Random) -> None:
    """A process that takes a part of the memory that is free, beside the next actions."""
    soak.load.take_memory(random.uniform(0.05, 0.25), random.uniform(2, 10))


def helper_kill(soak: Soak, random: Random) -> None:
    """SIGKILL to the compile service or the trial, sometimes while it works; it is replaced."""
    name = random.choice(["lawd", "trial"])
    pid = int(soak.rig.status()[f"{name}_pid"])
    text = f"{random.choice(LAWS).read_text(encoding='utf-8')}// {random.randrange(VARIANTS)}\n"
    asked = InThread(soak.rig.name, text) if random.random() < 0.7 else None
    time.sleep(random.uniform(0, 0.5))
    with contextlib.suppress(ProcessLookupError):
        if pid > 0:  # 0: not started yet
            os.kill(pid, signal.SIGKILL)
    if asked is not None:
        code, told = asked.wait()
        soak.judge.holds("answers", code != "", f"a swap during which {name} was killed was never answered")
        soak.judge.answer("swap", code)
        soak.answered(text, code, told)
    until = time.monotonic() + REPLACED_S
    while (now := int(soak.rig.status()[f"{name}_pid"])) in (0, pid):
        soak.judge.holds("processes", time.monotonic() < until, f"{name} was killed, and not replaced (pid {now})")
        time.sleep(0.2)
        if now == 0 or name == "trial":
            answer = soak.good_law()  # some are started for the next request only
            if answer in ("compile_starved", "trial_starved", "busy"):  # the machine had no time for it
                until = time.monotonic() + REPLACED_S


class InThread:
    """A swap over a connection of its own, during which something is killed."""

    def __init__(self, robot: str, source: str) -> None:
        self.code = ""  # the connection broke
        self.told: Any = {}
        self._thread = threading.Thread(target=self._ask, args=(robot, source), daemon=True)
        self._thread.start()

    def _ask(self, robot: str, source: str) -> None:
        with contextlib.suppress(LitheError):
            client = connect_control(robot, BACK_S)
            try:
                self.told = client.call("swap", {"source": source, "name": "in_thread.cpp"})
                self.code = "ok"
            except Refused as refused:
                self.code, self.told = refused.code, refused.detail
            finally:
                client.close()

    def wait(self) -> tuple[str, Any]:
        """The code of its answer and what it tells, as of Soak.ask(); "" when there was none."""
        self._thread.join(BACK_S + 30)
        return self.code, self.told


def supervisor_kill(soak: Soak, random: Random) -> None:
    """SIGKILL, sometimes during a swap; the Spine ticks on, and a new supervisor adopts it."""
    asked = None
    if random.random() < 0.5:
        text = f"{random.choice(LAWS).read_text(encoding='utf-8')}// {random.randrange(VARIANTS)}\n"
        asked = InThread(soak.rig.name, text)
        time.sleep(random.uniform(0, 0.6))
    soak.rig.kill_supervisor()
    before = soak.rig.spine.latest()
    time.sleep(random.uniform(0.2, 3))
    if asked is not None:
        asked.wait()  # not judged: the supervisor that would have written its certificate is dead
    until = time.monotonic() + REPLACED_S
    while before is not None and int(soak.rig.spine.latest()["tick"]) <= int(before["tick"]) + 1:  # type: ignore[index]
        soak.judge.holds("processes", time.monotonic() < until, "the Spine stands still without its supervisor")
        time.sleep(0.05)
    soak.rig.run()
    soak.watch.check(excused=asked is not None)
    soak.watch.chain()


def spine_kill(soak: Soak, _: Random) -> None:
    """SIGKILL to the Spine: `lithe run` ends with 3, and begins anew."""
    code = soak.rig.kill_spine()
    soak.judge.holds("processes", code == 3, f"`lithe run` ended with {code} after its Spine was killed, not with 3")
    soak.watch.forget()
    soak.rig.run()
    soak.watch.attach()
    soak.rig.end("brain")


def clock_step(soak: Soak, random: Random) -> None:
    """The time of day jumps, and back."""
    machine.step_clock(math.copysign(random.uniform(1, 7200), random.random() - 0.5), random.uniform(0.1, 2))


def cpu_unplug(soak: Soak, random: Random) -> None:
    """One core goes away for a while."""
    machine.unplug_core(random, random.uniform(0.5, 3))


Action = Callable[[Soak, Random], None]
# How often which, and what.
ACTIONS: dict[str, tuple[int, Action]] = {
    "swap": (300, swap_law), "hostile": (140, swap_hostile), "params": (140, params), "verbs": (100, verbs),
    "bad_requests": (30, bad_requests), "brain_kill": (50, brain_kill), "brain_freeze": (40, brain_freeze),
    "bus_fault": (120, bus_fault), "load": (50, load), "memory": (20, memory), "helper_kill": (15, helper_kill),
    "supervisor_kill": (15, supervisor_kill), "spine_kill": (7, spine_kill), "clock_step": (3, clock_step),
    "cpu_unplug": (3, cpu_unplug),
}  # fmt: skip
WHOLE_MACHINE = ("clock_step", "cpu_unplug")
# A process that is killed says nothing of its growth: only some actions of each round kill one that is watched for it.
KILLS = ("helper_kill", "supervisor_kill", "spine_kill")
ROUND, WITH_KILLS = 2500, 300


def drawn(seed: int, number: int) -> tuple[str, Random]:
    """Which action that number is, and its random numbers: the same wherever a soak begins."""
    random = Random(f"{seed}/{number}")
    calm = number % ROUND >= WITH_KILLS
    weights = [0 if calm and name in KILLS else weight for name, (weight, _) in ACTIONS.items()]
    return random.choices(list(ACTIONS), weights)[0], random


def do(soak: Soak, name: str, random: Random) -> bool:
    """One action and the way back; False when it is not possible here."""
    if name in WHOLE_MACHINE and not soak.whole_machine:
        soak.not_done[name] = "it changes this machine for every program: --whole-machine permits it"
        return False
    try:
        ACTIONS[name][1](soak, random)
    except machine.NotHere as why:
        soak.not_done[name] = str(why)
        return False
    soak.way_back()
    soak.watch.check()
    return True
