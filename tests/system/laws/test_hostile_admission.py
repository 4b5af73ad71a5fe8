# SPDX-License-Identifier: Apache-2.0
"""Every hostile law is stopped at the stage it names: compile, admission, or trial. No robot runs here.

Each is tried as a shared object and, where this system has a code arena, placed in a slot of it, as a robot would do.
"""

import contextlib
import errno
import json
import os
import queue
import re
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from system.robot_rig import BIN, ROOT, RobotRig

pytestmark = pytest.mark.early

CORPUS = sorted((ROOT / "tests" / "laws_hostile").glob("*.cpp"))
STAGES = ["compile", "admission", "trial"]
LATER = ["containment", "guard", "none"]
WITHOUT_GATES = re.compile(
    r"bad_access|bus_error|arithmetic|illegal_instruction|aborted|trapped|system_call|overran|not_finite|state_broken"
    r"|clamp|harmless|uncompilable|unloadable|unplaceable|not_contained"
)
NO_LINE = {"size", "descriptor"}  # rules about the law as a whole
ARENA_BYTES = 16 * (256 << 10)  # spine/arena/layout.hpp
MFD_EXEC = 0x10
SLOT = 5


def header(law: Path, key: str) -> str | None:
    """What the first lines of a law say under a key."""
    for line in law.read_text().splitlines()[:5]:
        if match := re.fullmatch(rf"// {key}: (\S+)", line):
            return match[1]
    return None


def make_arena() -> int:
    """The memory of a code arena, as the supervisor makes it."""
    flags = os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING
    try:
        fd = os.memfd_create("lithe-arena", flags | MFD_EXEC)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
        fd = os.memfd_create("lithe-arena", flags)
    os.ftruncate(fd, ARENA_BYTES)
    return fd


class Talk:
    """A program that answers JSON lines."""

    def __init__(self, *words: str | Path, env: dict[str, str], arena: int) -> None:
        """Start it, with the arena where it looks for it: as descriptor 3."""
        hand_over = ["bash", "-c", f'exec "$@" 3<&{arena}', "bash"]
        self.process = subprocess.Popen(
            [*hand_over, *words],
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            pass_fds=[arena],
        )
        self.has_arena = bool(self.ask(verb="ping")["arena"])

    def ask(self, **request: Any) -> dict[str, Any]:
        """Send one request and wait for its answer."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        answer: dict[str, Any] = json.loads(self.process.stdout.readline())
        return answer

    def close(self) -> None:
        """End its input, and wait for it."""
        self.process.communicate(timeout=10)


def attempt(who: Talk, **request: Any) -> dict[str, Any]:
    """The answer of the compile service or the trial, once it had the time to find one.

    A starved one says so, and judges nothing: only that is asked again. The last answer counts, also if it is starved.
    """
    for _ in range(20):
        answer = who.ask(**request)
        if not answer.get("starved"):
            break
    return answer


def bring(law: Path, lawd: Talk, trial: Talk) -> list[dict[str, Any]]:
    """The answer of the first stage that refuses a law, or of the last one: as an object, and in its slot."""
    compiled = attempt(lawd, verb="compile", source=law.read_text(), name=law.name, joints=1, dry_run=False)
    if not compiled["ok"]:
        return [compiled]
    answers = [attempt(trial, verb="try", object=compiled["object"])]
    if lawd.has_arena and trial.has_arena:
        placed = attempt(lawd, verb="place", hash=compiled["hash"], slot=SLOT)
        assert placed["ok"], f"{law.name}: what is admitted can be placed: {placed}"
        where = {key: placed[key] for key in ("slot", "entry", "code_bytes", "image_hash")}
        answers.append(attempt(trial, verb="try", **where))
    return answers


def compiler_and_trial(rig: RobotRig, env: dict[str, str], started: contextlib.ExitStack) -> tuple[Talk, Talk]:
    """A lawd and a lithe-trial with one arena; `started` ends them."""
    arena = make_arena()
    try:
        lawd = Talk(BIN / "lawd", env=env, arena=arena)
        started.callback(lawd.close)
        trial = Talk(BIN / "lithe-trial", rig.config, env=env, arena=arena)
        started.callback(trial.close)
    finally:
        os.close(arena)
    return lawd, trial


@pytest.fixture(scope="module")
def answers() -> Iterator[dict[str, list[dict[str, Any]]]]:
    """What became of each law of the corpus, two at a time."""
    if not (BIN / "lithe-trial").exists():
        pytest.fail(f"no binaries in {BIN}: make, or set LITHE_BIN_DIR")
    pairs: queue.Queue[tuple[Talk, Talk]] = queue.Queue()
    with contextlib.ExitStack() as started:
        rig = started.enter_context(RobotRig())
        env = rig.env | {"LITHE_CACHE_DIR": str(rig.dir / "cache")}
        for _ in range(2):
            pair = compiler_and_trial(rig, env, started)  # the second lawd finds the contract precompiled
            if not (pair[0].has_arena and pair[1].has_arena):
                print("this system refuses the code arena: laws are tried as shared objects only")
            pairs.put(pair)

        def one(law: Path) -> list[dict[str, Any]]:
            pair = pairs.get()
            try:
                return bring(law, *pair)
            finally:
                pairs.put(pair)

        with ThreadPoolExecutor(2) as two:
            results = dict(zip([law.stem for law in CORPUS], two.map(one, CORPUS), strict=True))
        yield results


def test_the_corpus_is_large_and_says_what_it_expects() -> None:
    """At least sixty laws, each with its stage and with what happens when nothing stops it before the tick."""
    assert len(CORPUS) >= 60
    for law in CORPUS:
        assert header(law, "stopped-by") in STAGES + LATER, law.name
        assert WITHOUT_GATES.fullmatch(header(law, "without-gates") or ""), law.name


@pytest.mark.parametrize("law", CORPUS, ids=lambda law: law.stem)
def test_law_is_stopped_at_its_stage(law: Path, answers: dict[str, list[dict[str, Any]]]) -> None:
    """There and not earlier, which could be for another reason; a law that only looks bad is let through."""
    for answer in answers[law.stem]:
        check(law, answer)


def check(law: Path, answer: dict[str, Any]) -> None:
    """One answer against the law's first lines."""
    wanted = header(law, "stopped-by")
    if wanted in LATER:  # what passes here is what the tick's own containment is tested with
        assert answer["ok"], answer.get("reason") or answer.get("text")
        return
    assert not answer["ok"], f"nothing stopped it before the tick; expected at {wanted}"
    assert answer["stage"] == wanted, f"{answer['stage']}: {answer.get('reason') or answer.get('text')}"
    if answer["stage"] == "trial":
        assert len(answer["reason"]) > 20
        assert not answer["unavailable"], answer["reason"]
    if answer["stage"] == "admission":
        gates = [entry["gate"] for entry in answer["diagnostics"]]
        assert header(law, "gate") in gates, answer["text"]
        assert all(entry["line"] > 0 or entry["gate"] in NO_LINE for entry in answer["diagnostics"][:1]), answer["text"]


def test_good_laws_pass_every_gate(answers: dict[str, list[dict[str, Any]]]) -> None:
    """The laws LITHE ships are not refused by rules meant for others."""
    assert answers  # the programs are there
    with contextlib.ExitStack() as started:
        rig = started.enter_context(RobotRig())
        env = rig.env | {"LITHE_CACHE_DIR": str(rig.dir / "cache")}
        lawd, trial = compiler_and_trial(rig, env, started)
        for law in sorted((ROOT / "laws").glob("*.cpp")):
            if law.name.endswith("_test.cpp"):
                continue
            compiled = attempt(lawd, verb="compile", source=law.read_text(), name=law.name, joints=1)
            assert compiled["ok"], compiled.get("text")
            assert [gate["gate"] for gate in compiled["gates"] if not gate["ok"]] == []
            assert len(compiled["gates"]) == 13
            tried = attempt(trial, verb="try", object=compiled["object"], box_ms=1000)
            assert tried["ok"], tried.get("reason")
