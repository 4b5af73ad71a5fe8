# SPDX-License-Identifier: Apache-2.0
"""Words from outside are printable when they come in, at every connection; so nothing else comes out anywhere."""

import json
from pathlib import Path
from typing import Any

from system.cli.connections import both_connections
from system.robot_rig import ROOT, RobotRig
from unprintable import CHARACTERS, GOOD, NO_UTF8, is_shown_as_it_is

LAW = (ROOT / "laws" / "hold.cpp").read_text()
PLACES: list[Any] = [  # where a client can put a word
    lambda word: {"verb": word, "args": {}},
    lambda word: {"verb": "swap", "args": {"source": LAW, "name": word}},
    lambda word: {"verb": "law_check", "args": {"source": LAW, "name": word}},
    lambda word: {"verb": "swap", "args": {"source": LAW, word: 1}},
    lambda word: {"verb": "swap", "args": {"source": LAW, "params": {word: 1.0}}},
    lambda word: {"verb": "set_params", "args": {"values": {word: 1.0}}},
    lambda word: {"verb": "set_params", "args": {"name": word, "value": 1.0}},
    lambda word: {"verb": "latest", "args": {"fields": [word]}},
]


def requests() -> list[bytes]:
    """Every bad word in every place, and bytes that are no UTF-8."""
    words = [json.dumps({"id": 1, **place(word)}).encode() for place in PLACES for word in CHARACTERS]
    return words + [b'{"id":1,"verb":"swap","args":{"source":"x","name":"' + raw + b'"}}' for raw in NO_UTF8]


def law_called(literal: str) -> str:
    """A good law under a name as it would stand in the source."""
    return LAW.replace('"hold"', f'"{literal}"')


def everything_shown(rig: RobotRig) -> str:
    """What people look at, in their terminal and in files."""
    looks = [
        rig.lithe(*words) for words in (("status",), ("events",), ("law", "list"), ("law", "show"), ("param", "get"))
    ]
    files = [path.read_text(errors="replace") for path in (rig.dir / "out").rglob("*.json*")]
    return "\n".join([*(each.stdout + each.stderr for each in looks), rig.log(), *files])


def test_no_door_takes_what_is_not_printable(rig: RobotRig) -> None:
    """Control socket, gateway and the law's own name; then status, events, log and certificates are clean."""
    rig.run()
    with both_connections(rig) as connections:
        for connection in connections:
            for request in requests():
                answer = connection.say(request)
                assert answer["error"]["code"] == "bad_request", (request, answer)
                assert is_shown_as_it_is(answer["error"]["message"] + answer["error"]["next"])
        for literal in (r"a\x1b[2J", r"a\nb", r"\u202eb", r"\xff", r"\xc0\xaf"):
            error = connections[0].ask("swap", source=law_called(literal), name="x.cpp")["error"]
            assert error["code"] == "admission_failed" and "printable" in error["message"], error
        for name in GOOD:
            assert connections[0].ask("swap", source=LAW, name=name)["ok"]
    assert is_shown_as_it_is(everything_shown(rig))


def test_a_robot_file_with_escapes_is_refused_without_them(rig: RobotRig) -> None:
    """TOML has escapes of its own; the message quotes what is wrong and no terminal obeys it."""
    for number, word in enumerate(CHARACTERS):
        wrong = rig.dir / f"wrong{number}.toml"
        name = json.dumps(word) if word < "\U00010000" else '"\\U000E0041"'
        wrong.write_text((ROOT / "robots/arm.toml").read_text().replace('name = "arm"', f"name = {name}"))
        done = rig.lithe("run", wrong)
        assert done.returncode == 2 and wrong.name in done.stderr, done.stderr
        assert is_shown_as_it_is(done.stdout + done.stderr), (word, done.stderr)


def test_a_certificate_of_somebody_else_is_shown_harmlessly(rig: RobotRig) -> None:
    """`lithe law show` prints files that others may have written."""
    folder = Path(rig.dir / "out" / "arm" / "swaps")
    folder.mkdir(parents=True)
    (folder / "0001.json").write_text(json.dumps({"law": "\x1b[2J\u202e", "verdict": "committed\x9b", "\x1b]0;": 1}))
    for words in (("law", "show"), ("--json", "law", "show"), ("law", "verify")):
        done = rig.lithe(*words, "--folder", folder)
        assert is_shown_as_it_is(done.stdout + done.stderr), words
