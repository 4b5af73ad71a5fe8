# SPDX-License-Identifier: Apache-2.0
"""What a client of the gateway is told to do, it can do: with verbs, not with commands of a terminal."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from lithe.errors import Refused
from lithe.remote import Remote
from lithe.vocabulary import in_verbs
from system.robot_rig import ROOT

COMMAND = re.compile(r"\blithe [a-z]")
HEADING = re.compile(r"^### `lithe ([a-z]+(?: [a-z]+)?)", re.M)
# Whatever a supervisor or a Spine says; the command line itself and its buses talk to a terminal.
SPEAKERS = ("supervisor/serve", "supervisor/swap", "supervisor/link", "supervisor/run", "supervisor/events",
            "supervisor/incident", "spine", "trial", "lawd")  # fmt: skip
LITERAL = re.compile(r'"((?:[^"\\\n]|\\.)*\blithe [a-z](?:[^"\\\n]|\\.)*)"')


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("what happened: lithe events; then: lithe reset", "what happened: events; then: reset"),
        ("see which are still there: lithe law list", "see which are still there: law_list"),
        ("swap a law in (lithe swap hold), then: lithe arm", "swap a law in (swap), then: arm"),
        (
            "the running law is unchanged; lithe law check tells more",
            "the running law is unchanged; law_check tells more",
        ),
        ("look at the log of `lithe run`", "look at the log of run (on the robot's computer)"),
        ("next: lithe run ROBOT.toml", "next: run ROBOT.toml (on the robot's computer)"),
        ("then: lithe sim reset", "then: sim_reset"),
        ("python -m lithe.mcp allow; using lithe::Param", "python -m lithe.mcp allow; using lithe::Param"),
    ],
)
def test_a_command_becomes_the_verb_that_does_the_same(text: str, says: str) -> None:
    assert in_verbs(text) == says


def test_no_command_of_the_command_line_is_left() -> None:
    commands = HEADING.findall((ROOT / "docs/reference/cli.md").read_text())
    assert {"run", "law list", "tune shield", "param save"} <= set(commands)
    assert [words for words in commands if COMMAND.search(in_verbs(f"next: lithe {words}; then"))] == []


def test_no_text_that_a_client_may_get_keeps_a_command() -> None:
    texts = []
    for folder in SPEAKERS:
        for path in [each for kind in ("cpp", "hpp") for each in Path(ROOT / folder).rglob(f"*.{kind}")]:
            if not path.stem.endswith("_test") and "test" not in path.parts:
                texts += LITERAL.findall(path.read_text(encoding="utf-8"))
    assert len(texts) > 40
    assert [text for text in texts if COMMAND.search(in_verbs(text).replace("{}", "x"))] == []


def test_refusals_alarms_and_events_of_a_robot_name_verbs(remote: Remote) -> None:
    remote.call("estop")
    told: list[Any] = [remote.call("status"), remote.call("events"), remote.call("incidents")]
    assert "then: reset" in told[0]["alarms"][0]["text"]
    asked: list[tuple[str, dict[str, Any]]] = [
        ("arm", {}), ("recover", {}), ("rollback", {"steps": 9}), ("activate", {"law": [3]}), ("sim_reset", {}),
        ("swap", {"source": "x", "shadow_s": 1}), ("incident", {"id": 999}),
    ]  # fmt: skip
    for verb, args in asked:
        with pytest.raises(Refused) as caught:
            remote.call(verb, **args)
        told.append([caught.value.message, caught.value.next, caught.value.detail])
    remote.call("reset")
    remote.call("arm")
    assert "then arm" in told[3][1] and "law_list" in told[5][1]
    assert COMMAND.findall(json.dumps(told)) == []
