# SPDX-License-Identifier: Apache-2.0
"""Mistakes in laws (tests/mistakes/table.toml): each gets the words that say what to write instead. No robot runs here.

`python tests/system/laws/test_mistakes.py --write` makes docs/mistakes.md from the table.
"""

import html
import json
import os
import platform
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]
BIN = Path(os.environ.get("LITHE_BIN_DIR", ROOT / "build" / "release" / "bin"))
TABLE = tomllib.loads((ROOT / "tests" / "mistakes" / "table.toml").read_text())
BASE: str = TABLE["base"].lstrip("\n")
MISTAKES: list[dict[str, Any]] = TABLE["mistake"]
DOC = ROOT / "docs" / "mistakes.md"
JOINTS = 3  # of robots/chain.toml
HEAD = """# Mistakes and what LITHE says

What a law's author is told (the words that do not change), and what to write instead. `make test` sends each of these
laws to the compile service and, where it compiles, to a trial with `robots/chain.toml`. The table is made from
`tests/mistakes/table.toml`: `python tests/system/laws/test_mistakes.py --write`.

Text around a law is taken off before it is compiled: the answer lists what, in `cleaned`, and every line keeps its
number. What a trial says about the control of a joint (sign, damping, degrees, a steady load ...) is computed from the
run, never from the text. When the numbers do not show the cause, it says only what was seen.

Six readers (language models) saw nothing but such a law and its message, and corrected 56 of the 58 that need a
change at their first try (2026-11-27). They missed a damping that was of the wrong sign and also too high, and gave an
integral against gravity too little gain for the second that a trial lasts. Both messages have a number more now, and
what the readers had to read twice was written anew: three further readers corrected 18 of the 18 laws whose messages
had changed.

| mistake | found by | message | instead |
|---|---|---|---|
"""


def source_of(mistake: dict[str, Any]) -> str:
    """The text that is sent."""
    law: str = BASE
    for key in ("edit", "more"):
        if key in mistake:
            before, after = mistake[key]
            assert before in law, f"{mistake['name']}: the law has no {before!r}"
            law = law.replace(before, after)
    if mistake.get("html"):
        law = html.escape(law)
    text = str(mistake.get("source", "BASE")).replace("BASE", law)
    return text + " " * int(mistake.get("padded", 0))


def render() -> str:
    """The text of docs/mistakes.md."""
    found = {"none": "not refused", "admission": "rules", "compile": "compiler", "dry_run": "dry run", "trial": "trial"}
    rows = []
    for mistake in MISTAKES:
        says = " ... ".join(f"`{part}`" for part in mistake["says"])
        name, instead = html.escape(mistake["name"]), html.escape(mistake["instead"])
        rows.append(f"| {name} | {found[mistake['stage']]} | {says} | {instead} |\n")
    return HEAD + "".join(rows)


def as_told(words: str) -> dict[str, str]:
    """Three laws with a gain that is too high, changed to the values in these words; by the name of the mistake."""
    kp, kd, most_nm = (
        float(found[1]) if (found := re.search(rf"{about} ([0-9.]+)", words)) else None
        for about in ("lower the stiffness to about", "damping to about", "the integral give at most")
    )
    stiff = BASE.replace("kp_nm_rad{4,", f"kp_nm_rad{{{kp},").replace("kd_nm_s_rad{0.1,", f"kd_nm_s_rad{{{kd},")
    part = f"std::clamp(s.sum_rad_s[j] + error_rad * t.dt_s, -{most_nm} / 60, {most_nm} / 60);"
    integral = BASE.replace("s.sum_rad_s[j] += error_rad * t.dt_s;", f"s.sum_rad_s[j] = {part}")
    return {
        "a gain that is too high": stiff,
        "a damping that is too high": BASE.replace("kd_nm_s_rad{0.1,", f"kd_nm_s_rad{{{kd},"),
        "an integral that winds up": integral.replace("p.kp_nm_rad *", "60 * s.sum_rad_s[j] + p.kp_nm_rad *"),
    }


class Talk:
    """A program that answers JSON lines."""

    def __init__(self, *words: str | Path, cache: Path) -> None:
        """Start it."""
        self.process = subprocess.Popen(
            words,
            env=os.environ | {"LITHE_CACHE_DIR": str(cache)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, **request: Any) -> dict[str, Any]:
        """Its answer; asked again while a busy machine gives it no processor time."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        answer: dict[str, Any] = {}
        for _ in range(20):
            self.process.stdin.write(json.dumps(request) + "\n")
            self.process.stdin.flush()
            answer = json.loads(self.process.stdout.readline())
            if not answer.get("starved"):
                break
        return answer

    def close(self) -> None:
        """End its input, and wait for it."""
        self.process.communicate(timeout=60)


def bring(source: str, lawd: Talk, trial: Talk) -> dict[str, Any]:
    """The answer of the stage that refuses it, or of the trial; with what was cleaned."""
    compiled = lawd.ask(verb="compile", source=source, name="law.cpp", joints=JOINTS)
    if not compiled["ok"]:
        return compiled
    tried = trial.ask(verb="try", object=compiled["object"], box_ms=1000)
    return tried | {"cleaned": compiled.get("cleaned", [])}


def words_of(answer: dict[str, Any]) -> str:
    """All that its author reads."""
    said = [answer.get("text", ""), answer.get("reason", "")]
    return "\n".join([*said, *answer.get("hints", []), *answer.get("cleaned", []), *answer.get("warnings", [])])


def check(mistake: dict[str, Any], answer: dict[str, Any]) -> None:
    """Whether the answer is what the table says."""
    words = words_of(answer)
    assert answer["ok"] == (mistake["stage"] == "none"), words
    if not answer["ok"]:
        assert answer["stage"] == mistake["stage"], words
    for part in mistake["says"]:
        assert part in words, f"{part!r} is not in: {words}"
    if "line" not in mistake or (answer["stage"] == "dry_run" and platform.machine() != "x86_64"):
        return
    first = answer["diagnostics"][0]
    assert first["line"] == mistake["line"], words
    assert first["text"] == source_of(mistake).splitlines()[mistake["line"] - 1], "the line is quoted"


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, dict[str, Any]]]:
    """What each mistake was told; "" is the law without one."""
    if not (BIN / "lithe-trial").exists():
        pytest.fail(f"no binaries in {BIN}: make, or set LITHE_BIN_DIR")
    folder = tmp_path_factory.mktemp("mistakes")
    robot = folder / "raised.toml"
    chain = (ROOT / "robots" / "chain.toml").read_text()
    raised = chain.replace("[defaults.joint.sim]\n", "[defaults.joint.sim]\ninitial_position_rad = 0.6\n")
    assert raised != chain
    robot.write_text(raised.replace("../laws", str(ROOT / "laws")))
    lawd = Talk(BIN / "lawd", cache=folder)
    trial = Talk(BIN / "lithe-trial", robot, cache=folder)
    try:
        told = {mistake["name"]: bring(source_of(mistake), lawd, trial) for mistake in MISTAKES}
        better = {f"{name}, as told": bring(as_told(words_of(told[name]))[name], lawd, trial) for name in as_told("")}
        yield told | better | {"": bring(BASE, lawd, trial)}
    finally:
        lawd.close()
        trial.close()


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake["name"])
def test_it_is_told_what_to_write_instead(mistake: dict[str, Any], answers: dict[str, dict[str, Any]]) -> None:
    """At its stage, with its line and in these words."""
    check(mistake, answers[mistake["name"]])


@pytest.mark.parametrize("name", as_told(""))
def test_a_gain_that_is_too_high_is_told_a_value_that_holds(name: str, answers: dict[str, dict[str, Any]]) -> None:
    """The law passes with the values of its message."""
    assert answers[f"{name}, as told"]["ok"], words_of(answers[name]) + "\n" + words_of(answers[f"{name}, as told"])


def test_the_law_without_a_mistake_passes(answers: dict[str, dict[str, Any]]) -> None:
    """So each mistake is mended by what the table says; and the check of a mistake can fail."""
    assert answers[""]["ok"], words_of(answers[""])
    assert answers[""]["cleaned"] == []
    for mistake in MISTAKES:
        if mistake["stage"] != "none":
            with pytest.raises(AssertionError):
                check(mistake, answers[""])


def test_there_are_forty_and_the_page_has_them_all() -> None:
    """docs/mistakes.md is made from the table."""
    assert len(MISTAKES) >= 40
    assert len({mistake["name"] for mistake in MISTAKES}) == len(MISTAKES)
    assert DOC.read_text() == render(), f"run: python {Path(__file__).relative_to(ROOT)} --write"


if __name__ == "__main__":
    if sys.argv[1:] != ["--write"]:
        sys.exit("usage: python tests/system/laws/test_mistakes.py --write")
    DOC.write_text(render())
