# SPDX-License-Identifier: Apache-2.0
"""What a client of the gateway is told to do, it can do: with verbs, not with commands of a terminal."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from lithe.errors import Refused
from lithe.gateway import Gateway
from lithe.gateway.answers import check
from lithe.remote import Remote
from lithe.vocabulary import BY_NAME, VERBS, in_verbs
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


def test_an_estop_of_a_client_is_its_own_and_not_a_process(remote: Remote, gateway: Gateway) -> None:
    remote.call("estop")
    with Remote("127.0.0.1", gateway.port, "sesame") as other:
        mine, theirs = (each.call("status")["alarms"][0]["text"] for each in (remote, other))
    assert mine == "the e-stop was pressed by this client: find out why, then: reset, arm"
    assert theirs.startswith("the e-stop was pressed by client 127.0.0.1:") and "pid" not in theirs
    remote.call("reset")
    assert all("e-stop" not in each["text"] for each in remote.call("status")["alarms"])


@pytest.mark.parametrize(
    ("verb", "args", "says"),
    [
        ("lease", {"take": "yes"}, 'take = "yes" is not true or false'),
        ("lease", {"take": 1, "seconds": True}, "seconds = true is not a number"),
        ("set_params", {"values": {"kp": "big"}}, 'values.kp = "big" is not a number'),
        ("set_params", {"name": "kp", "value": None}, "value = null is not a number"),
        ("publish", {}, "'publish' needs 't_ns' and 'position_rad'"),
        ("publish", {"t_ns": [1, 1.5], "position_rad": [0]}, "t_ns[1] = 1.5 is not a whole number"),
        ("publish", {"t_ns": [1], "position_rad": [[0, "x"]]}, 'position_rad[0][1] = "x" is not a number'),
        ("set_reference", {"kind": "sine", "amplitude_rad": {}}, "amplitude_rad = {} is not a number or a list"),
        ("swap", {"source": 3, "name": []}, "source = 3 is not a text; name = [] is not a text"),
    ],
)
def test_every_argument_of_another_type_is_named_and_all_that_is_missing(
    verb: str, args: dict[str, Any], says: str
) -> None:
    with pytest.raises(Refused) as wrong:
        check(BY_NAME[verb], args)
    assert says in wrong.value.message and wrong.value.code == "bad_request"


def test_each_type_of_every_argument_is_checked() -> None:
    none_fits = {"number": "x", "integer": "x", "string": 1, "boolean": "x", "array": 1, "object": 1}
    for verb in VERBS:
        for name, schema in verb.args.items():
            value = none_fits[schema["type"]] if "type" in schema else {"none": 1}
            with pytest.raises(Refused, match=rf"{name} = .* is not "):
                check(verb, dict.fromkeys(verb.required, "") | {name: value})
