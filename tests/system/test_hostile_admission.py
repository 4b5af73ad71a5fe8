# SPDX-License-Identifier: Apache-2.0
"""Every hostile law is stopped at or before the stage it names: compile, admission, or trial. No robot runs here."""

import json
import queue
import re
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from system.house import BIN, ROOT, House

CORPUS = sorted((ROOT / "tests" / "laws_hostile").glob("*.cpp"))
STAGES = ["compile", "admission", "trial"]
LATER = ["containment", "guard", "none"]
WITHOUT_GATES = re.compile(
    r"bad_access|bus_error|arithmetic|illegal_instruction|aborted|trapped|system_call|overran|not_finite|state_broken"
    r"|clamp|harmless|uncompilable|unloadable|unplaceable"
)
NO_LINE = {"size", "descriptor"}  # rules about the law as a whole


def header(law: Path, key: str) -> str | None:
    """What the first lines of a law say under a key."""
    for line in law.read_text().splitlines()[:5]:
        if match := re.fullmatch(rf"// {key}: (\S+)", line):
            return match[1]
    return None


class Talk:
    """A program that answers JSON lines."""

    def __init__(self, *words: str | Path, env: dict[str, str]) -> None:
        """Start it."""
        self.process = subprocess.Popen(words, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

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


def bring(law: Path, lawd: Talk, trial: Talk) -> dict[str, Any]:
    """The answer of the first stage that refuses a law, or of the last one."""
    compiled = lawd.ask(verb="compile", source=law.read_text(), name=law.name, joints=1, dry_run=False)
    if not compiled["ok"]:
        return compiled
    tried = trial.ask(verb="try", object=compiled["object"])
    for _ in range(20):
        if not tried.get("starved"):
            break
        tried = trial.ask(verb="try", object=compiled["object"])
    return tried


@pytest.fixture(scope="module")
def answers() -> Iterator[dict[str, dict[str, Any]]]:
    """What became of each law of the corpus, two at a time."""
    if not (BIN / "lithe-trial").exists():
        pytest.fail(f"no binaries in {BIN}: make, or set LITHE_BIN_DIR")
    house = House()
    env = house.env | {"LITHE_CACHE_DIR": str(house.dir / "cache")}
    pairs: queue.Queue[tuple[Talk, Talk]] = queue.Queue()
    started: list[Talk] = []
    for _ in range(2):
        pair = (Talk(BIN / "lawd", env=env), Talk(BIN / "lithe-trial", house.config, env=env))
        assert pair[0].ask(verb="ping")["ok"]  # the second one finds the contract precompiled
        assert pair[1].ask(verb="ping")["ok"]
        pairs.put(pair)
        started += pair

    def one(law: Path) -> dict[str, Any]:
        pair = pairs.get()
        try:
            return bring(law, *pair)
        finally:
            pairs.put(pair)

    with ThreadPoolExecutor(2) as two:
        results = dict(zip([law.stem for law in CORPUS], two.map(one, CORPUS), strict=True))
    yield results
    for talk in started:
        talk.close()
    house.close()


def test_the_corpus_is_large_and_says_what_it_expects() -> None:
    """At least sixty laws, each with its stage and with what happens when nothing stops it before the tick."""
    assert len(CORPUS) >= 60
    for law in CORPUS:
        assert header(law, "stopped-by") in STAGES + LATER, law.name
        assert WITHOUT_GATES.fullmatch(header(law, "without-gates") or ""), law.name


@pytest.mark.parametrize("law", CORPUS, ids=lambda law: law.stem)
def test_law_is_stopped_at_its_stage(law: Path, answers: dict[str, dict[str, Any]]) -> None:
    """At or before its stage, with a reason; a law that only looks bad is let through."""
    answer = answers[law.stem]
    wanted = header(law, "stopped-by")
    if wanted in LATER:  # what passes here is what the tick's own containment is tested with
        assert answer["ok"], answer.get("reason") or answer.get("text")
        return
    assert not answer["ok"], f"nothing stopped it before the tick; expected at {wanted}"
    assert STAGES.index(answer["stage"]) <= STAGES.index(str(wanted)), answer.get("reason") or answer.get("text")
    if answer["stage"] == "trial":
        assert len(answer["reason"]) > 20
    if answer["stage"] == "admission":
        gates = [entry["gate"] for entry in answer["diagnostics"]]
        assert header(law, "gate") in gates, answer["text"]
        assert all(entry["line"] > 0 or entry["gate"] in NO_LINE for entry in answer["diagnostics"][:1]), answer["text"]


def test_good_laws_pass_every_gate(answers: dict[str, dict[str, Any]]) -> None:
    """The laws LITHE ships are not refused by rules meant for others."""
    assert answers  # the programs are there
    house = House()
    env = house.env | {"LITHE_CACHE_DIR": str(house.dir / "cache")}
    lawd, trial = Talk(BIN / "lawd", env=env), Talk(BIN / "lithe-trial", house.config, env=env)
    for law in sorted((ROOT / "laws").glob("*.cpp")):
        if law.name.endswith("_test.cpp"):
            continue
        compiled = lawd.ask(verb="compile", source=law.read_text(), name=law.name, joints=1)
        assert compiled["ok"], compiled.get("text")
        assert [gate["gate"] for gate in compiled["gates"] if not gate["ok"]] == []
        assert len(compiled["gates"]) == 13
        tried = trial.ask(verb="try", object=compiled["object"], box_ms=1000)
        assert tried["ok"], tried.get("reason")
    lawd.close()
    trial.close()
    house.close()
