# SPDX-License-Identifier: Apache-2.0
"""Client of a language model's server: OpenAI's `/v1/chat/completions`, and Ollama's `/api/chat`.

Standard library only. Every wait, every answer and every number of repetitions is bounded. One thread at a time.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from ..errors import LitheError

Json = dict[str, Any]
MOST_ANSWER_BYTES = 1 << 20
PIECE_BYTES = 64 << 10
MOST_SHOWN_CHARS = 300
PROBE_S = 5.0  # to find out which kind of server it is
TOO_MANY, SERVER_ERROR = 429, 500  # from here on a status may pass by itself


class ModelError(LitheError):
    """The model gave no usable answer. `kind` is one word for programs, `again`: asking again may help."""

    def __init__(self, kind: str, message: str, next_step: str, again: bool = False) -> None:
        super().__init__(f"{message}\n  next: {next_step}")
        self.kind, self.message, self.next, self.again = kind, message, next_step, again


@dataclass(frozen=True)
class Reply:
    """`text` as the model wrote it; `arguments` of its tool calls, as the server gave them: strings or objects."""

    text: str
    arguments: list[Any] = field(default_factory=list)
    prompt_tokens: int | None = None


def _bad(what: str) -> ModelError:
    return ModelError("no_chat_answer", f"the server's answer {what}", "is the URL that of a chat server?")


def _object(value: Any, what: str) -> Json:
    if not isinstance(value, dict):
        raise _bad(f"has no {what}")
    return value


class Model:
    """`url`: "http://host:11434" (Ollama), "http://host:8000/v1" (OpenAI). `api`: "openai", "ollama", or "auto": asks.

    `timeout_s` bounds one whole request; `retries` more follow after an error that may pass. `key` is sent as a bearer
    token and never recorded. `say(kind, **what)` is told of each request, answer and error.
    """

    def __init__(
        self,
        url: str,
        model: str,
        *,
        api: str = "auto",
        key: str = "",
        timeout_s: float = 180.0,
        retries: int = 2,
        context_tokens: int = 16384,
        answer_tokens: int = 4096,
        temperature: float = 0.2,
        seed: int = 1,
        say: Callable[..., None] = lambda kind, **what: None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        parts = urlsplit(url)
        try:
            port = parts.port
        except ValueError:
            port = -1
        if parts.scheme not in ("http", "https") or not parts.hostname or port == -1 or parts.username is not None:
            raise LitheError(f"'{url}' is no URL of a model's server\n  next: for example http://127.0.0.1:11434")
        self.url, self.model, self._key = url, model, key
        self._https, self._host, self._port = parts.scheme == "https", parts.hostname, port
        self._path = parts.path.rstrip("/")
        self._timeout_s, self._retries, self._say, self._sleep = timeout_s, retries, say, sleep
        self._context, self._answer_tokens, self._temperature, self._seed = (
            context_tokens, answer_tokens, temperature, seed,
        )  # fmt: skip
        self._api = "" if api == "auto" else api

    def ask(self, messages: list[Json]) -> Reply:
        """The model's answer. ModelError: there is none that can be used, after all repetitions."""
        for repetition in range(self._retries + 1):
            try:
                return self._ask(messages)
            except ModelError as error:
                self._say("model_error", error=error.kind, message=error.message)
                if not error.again or repetition == self._retries:
                    raise
                self._sleep(min(2.0**repetition, 8.0))
        raise AssertionError("unreachable")

    def _ask(self, messages: list[Json]) -> Reply:
        self._api = self._api or self._found()
        body: Json = {"model": self.model, "messages": messages, "stream": False}
        if self._api == "ollama":
            root = self._path.removesuffix("/v1").removesuffix("/api")
            options = {"num_ctx": self._context, "num_predict": self._answer_tokens}
            body["options"] = {**options, "temperature": self._temperature, "seed": self._seed}
            return self._of_ollama(self._exchange("POST", f"{root}/api/chat", body, self._timeout_s))
        body |= {"max_tokens": self._answer_tokens, "temperature": self._temperature, "seed": self._seed}
        return _of_openai(self._exchange("POST", f"{self._path or '/v1'}/chat/completions", body, self._timeout_s))

    def _found(self) -> str:
        """An Ollama is asked by its own way: behind `/v1` it ignores num_ctx, and silently cuts the prompt."""
        with contextlib.suppress(ModelError):
            root = self._path.removesuffix("/v1").removesuffix("/api")
            if "version" in self._exchange("GET", f"{root}/api/version", None, min(PROBE_S, self._timeout_s)):
                return "ollama"
        return "openai"

    def _exchange(self, method: str, path: str, body: Json | None, timeout_s: float) -> Json:
        data = None if body is None else json.dumps(body).encode()
        self._say("asked", url=self.url, path=path, body=body)
        kind = http.client.HTTPSConnection if self._https else http.client.HTTPConnection
        link = kind(self._host, self._port, timeout=timeout_s)
        until_s = time.monotonic() + timeout_s
        headers = {"Content-Type": "application/json", "Accept-Encoding": "identity"}
        if self._key:
            headers["Authorization"] = f"Bearer {self._key}"
        try:
            link.request(method, path, data, headers)
            sock = link.sock  # taken away from `link` where the server closes after its answer
            with link.getresponse() as answer:
                raw = self._read(answer, sock, until_s)
        except TimeoutError:
            raise ModelError(
                "timeout",
                f"{self.url} did not answer within {timeout_s:g} s",
                "a smaller model, or --model-timeout SECONDS",
                again=True,
            ) from None
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise ModelError(
                "disconnected",
                f"no answer from {self.url} ({type(error).__name__}: {str(error)[:MOST_SHOWN_CHARS]})",
                "is the model's server running there?",
                again=True,
            ) from None
        finally:
            link.close()
        text = raw.decode("utf-8", "replace")
        self._say("answered", path=path, status=answer.status, text=text)
        if answer.status != 200:
            raise ModelError(
                "http",
                f"{self.url}{path} answered with status {answer.status}: {text[:MOST_SHOWN_CHARS]!r}",
                "see the log of the model's server; 401 or 403: --key-file, 404: --url or --model",
                again=answer.status == TOO_MANY or answer.status >= SERVER_ERROR,
            )
        try:
            return _object(json.loads(text), "JSON object")
        except (ValueError, RecursionError):
            raise _bad(f"is no JSON: {text[:MOST_SHOWN_CHARS]!r}") from None

    def _read(self, answer: http.client.HTTPResponse, sock: Any, until_s: float) -> bytes:
        """All of the answer, at most MOST_ANSWER_BYTES, and not longer than `until_s` however slowly it comes."""
        raw = bytearray()
        while True:
            left_s = until_s - time.monotonic()
            if left_s <= 0:
                raise TimeoutError
            with contextlib.suppress(OSError):  # closed already: all of it has been read
                sock.settimeout(left_s)
            piece = answer.read1(PIECE_BYTES)
            raw += piece
            if len(raw) > MOST_ANSWER_BYTES or (answer.length or 0) > MOST_ANSWER_BYTES:
                head = bytes(raw[:MOST_SHOWN_CHARS]).decode("utf-8", "replace")
                self._say("answered", status=answer.status, text=head, cut=True)
                raise ModelError(
                    "too_long",
                    f"the answer of {self.url} is longer than {MOST_ANSWER_BYTES >> 10} KiB and was cut off",
                    "another model, or fewer --answer-tokens",
                )
            if not piece:
                if answer.length:
                    raise http.client.IncompleteRead(b"", answer.length)
                return bytes(raw)

    def _of_ollama(self, answer: Json) -> Reply:
        used = answer.get("prompt_eval_count")
        reply = _reply(_object(answer.get("message"), "message"), used)
        if answer.get("done") is False or answer.get("done_reason") == "length":
            raise _truncated()
        if isinstance(used, int) and used >= self._context:
            raise ModelError(
                "prompt_cut", f"the prompt filled all {self._context} tokens of the context", "--context-tokens MORE"
            )
        return reply


def _truncated() -> ModelError:
    return ModelError("truncated", "the model's answer ended at its limit of tokens", "more --answer-tokens")


def _of_openai(answer: Json) -> Reply:
    choices = answer.get("choices")
    if not isinstance(choices, list) or not choices:
        raise _bad("has no choices")
    choice = _object(choices[0], "choice")
    usage = answer.get("usage")
    used = usage.get("prompt_tokens") if isinstance(usage, dict) else None
    reply = _reply(_object(choice.get("message"), "message"), used)
    if choice.get("finish_reason") == "length":
        raise _truncated()
    return reply


def _reply(message: Json, used: Any) -> Reply:
    text, calls = message.get("content"), message.get("tool_calls")
    found = []
    for call in calls if isinstance(calls, list) else []:
        function = call.get("function") if isinstance(call, dict) else None
        if isinstance(function, dict) and "arguments" in function:
            found.append(function["arguments"])
    return Reply(text if isinstance(text, str) else "", found, used if isinstance(used, int) else None)
