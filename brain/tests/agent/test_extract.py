# SPDX-License-Identifier: Apache-2.0
"""Where a law is found in an answer, and which answers hold none."""

import html
import json

import pytest
from lithe.agent.extract import MOST_SOURCE_BYTES, NoLaw, law_in
from lithe.agent.model import Reply
from model_server import fenced, law

GOOD = law("u.torque_nm[j] = e;")
OTHER = law("u.torque_nm[j] = de;", "other")
CALL = json.dumps({"name": "propose_law", "arguments": {"source": GOOD}})


@pytest.mark.parametrize(
    ("reply", "place"),
    [
        (Reply("", [json.dumps({"source": GOOD})]), "tool call"),
        (Reply("", [{"source": GOOD}]), "tool call"),
        (Reply(fenced(OTHER), [{"source": GOOD}]), "tool call"),
        (Reply(json.dumps({"source": GOOD})), "JSON in the text"),
        (Reply(CALL), "JSON in the text"),
        (Reply(fenced(CALL, "json")), "JSON in the text"),
        (Reply(f"<tool_call>\n{CALL}\n</tool_call>"), "JSON in the text"),
        (Reply(json.dumps({"function": {"arguments": json.dumps({"source": GOOD})}})), "JSON in the text"),
        (Reply(fenced(GOOD)), ""),
        (Reply(fenced(GOOD, "C++")), ""),
        (Reply(fenced(OTHER, "python") + fenced(GOOD)), ""),
        (Reply("<think>" + fenced(OTHER) + "</think>" + fenced(GOOD)), ""),
        (Reply(fenced("x = 1;\n") + fenced(GOOD)), "left out"),
        (Reply(fenced(GOOD) + fenced("lithe param set kp=1\n", "")), ""),
        (Reply(fenced(GOOD) + fenced(GOOD)), "left out"),
        (Reply(fenced(GOOD, "")), "block"),
        (Reply(GOOD), "whole text"),
        (Reply("Sure! Here it is.\n" + GOOD + "It has no gravity term."), "whole text"),
        (Reply("```cpp\n" + GOOD), ""),
        (Reply(fenced(html.escape(GOOD, quote=False))), "HTML"),
        (Reply(html.escape(GOOD, quote=False)), "HTML"),
    ],
)
def test_the_law_is_found_wherever_models_put_it(reply: Reply, place: str) -> None:
    source, told = law_in(reply)
    assert source == GOOD
    assert place in " ".join(told) and bool(told) == bool(place)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("", "no_code"),
        ("I would add gravity compensation, and lower the damping.", "no_code"),
        (fenced(GOOD) + fenced(OTHER), "several"),
        (fenced(GOOD + OTHER), "several"),
        (fenced("struct Law { static double step(double e) { return e; } };\n"), "no_entry"),
        (fenced(GOOD + "// " + "x" * MOST_SOURCE_BYTES + "\n"), "too_long"),
        (json.dumps({"source": 3}), "no_code"),
        ("[" * 100_000, "no_code"),
        ("{" * 3 + '"source"', "no_code"),
    ],
)
def test_an_answer_without_one_law_is_named(text: str, kind: str) -> None:
    with pytest.raises(NoLaw) as caught:
        law_in(Reply(text))
    assert caught.value.kind == kind
