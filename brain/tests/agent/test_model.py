# SPDX-License-Identifier: Apache-2.0
"""The client of a model's server, with a server that misbehaves as real ones do."""

from typing import Any

import pytest
from lithe.agent.model import MOST_ANSWER_BYTES, Model, ModelError
from lithe.errors import LitheError
from model_server import ModelServer, tool_call

QUESTION = [{"role": "user", "content": "a law, please"}]


def asked(server: ModelServer, **more: Any) -> Any:
    pauses: list[float] = []
    terms: dict[str, Any] = {"timeout_s": 30.0, "sleep": pauses.append, **more}
    return Model(server.url, "coder", **terms).ask(QUESTION)


def test_an_openai_server_is_asked_as_it_wants() -> None:
    with ModelServer(["hello"]) as server:
        assert asked(server, key="secret").text == "hello"
    assert server.paths == ["/v1/chat/completions"] and server.keys == ["Bearer secret"]
    assert server.asked[0]["model"] == "coder" and server.asked[0]["messages"] == QUESTION


def test_an_ollama_is_recognised_and_given_its_context() -> None:
    with ModelServer(["hello"], ollama=True) as server:
        for path in ("", "/v1", "/api"):
            assert Model(server.url + path, "coder", timeout_s=30.0).ask(QUESTION).text == "hello"
    assert server.paths == ["/api/chat"] * 3
    assert server.asked[0]["options"]["num_ctx"] == 16384 and server.asked[0]["stream"] is False


@pytest.mark.parametrize("arguments", ['{"source": "x"}', {"source": "x"}])
def test_tool_calls_come_as_text_or_object(arguments: Any) -> None:
    with ModelServer([tool_call(arguments)]) as server:
        assert asked(server).arguments == [arguments]


@pytest.mark.parametrize(
    ("entry", "kind", "questions"),
    [
        ({"status": 500}, "http", 3),
        ({"status": 429}, "http", 3),
        ({"status": 401}, "http", 1),
        ({"drop": True}, "disconnected", 3),
        ({"short": 50}, "disconnected", 3),
        ({"finish": "length"}, "truncated", 1),
        ({"huge": True}, "too_long", 1),
        ({"raw": b"x" * (MOST_ANSWER_BYTES + 1)}, "too_long", 1),
        ({"raw": b"<html>proxy</html>"}, "no_chat_answer", 1),
        ({"raw": b"[" * 100_000}, "no_chat_answer", 1),
        ({"raw": b'{"choices": []}'}, "no_chat_answer", 1),
        ({"raw": b'{"choices": [3]}'}, "no_chat_answer", 1),
        ({"raw": b'{"choices": [{"message": null}]}'}, "no_chat_answer", 1),
    ],
)
def test_each_failure_has_a_name_and_is_asked_again_where_that_may_help(
    entry: dict[str, Any], kind: str, questions: int
) -> None:
    with ModelServer([entry]) as server:
        with pytest.raises(ModelError) as caught:
            asked(server, api="openai")
        assert caught.value.kind == kind and len(server.asked) == questions
        assert "next:" in str(caught.value)


@pytest.mark.parametrize("entry", [{"hang": 60}, {"drip": 0.2}])
def test_a_server_that_hangs_or_drips_is_given_up(entry: dict[str, Any]) -> None:
    with ModelServer([entry]) as server, pytest.raises(ModelError) as caught:
        asked(server, api="openai", timeout_s=0.5, retries=0)
    assert caught.value.kind == "timeout"


@pytest.mark.parametrize(("entry", "kind"), [({"finish": "length"}, "truncated"), ({"used": 16384}, "prompt_cut")])
def test_ollama_says_when_it_ran_out_of_tokens(entry: dict[str, Any], kind: str) -> None:
    with ModelServer([entry], ollama=True) as server, pytest.raises(ModelError) as caught:
        asked(server)
    assert caught.value.kind == kind


def test_a_server_that_recovers_is_no_failure_and_the_key_is_told_to_nobody() -> None:
    told: list[Any] = []
    with ModelServer([{"status": 503}, {"drop": True}, "hello"]) as server:
        answer = asked(server, key="secret", say=lambda kind, **what: told.append((kind, what)))
    assert answer.text == "hello" and "secret" not in repr(told)
    assert [what["error"] for kind, what in told if kind == "model_error"] == ["http", "disconnected"]


def test_no_server_and_no_url_are_named() -> None:
    with ModelServer([""]) as server:
        pass
    with pytest.raises(ModelError, match="is the model's server running"):
        asked(server)
    for url in ("", "ftp://x", "http://", "http://x:99999", "http://user:word@x"):
        with pytest.raises(LitheError, match="is no URL"):
            Model(url, "coder")
