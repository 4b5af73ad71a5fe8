# SPDX-License-Identifier: Apache-2.0
"""The robot as tools of MCP: the protocol, its answers, and the permission to move."""

import json
import re
import threading
import time
from pathlib import Path
from typing import Any

import lithe
import pytest
from lithe.errors import NotRunning, Refused
from lithe.gateway import Gateway, documents
from lithe.gateway.answers import check
from lithe.mcp import library, permission, plots
from lithe.mcp.protocol import HANDSHAKE, META, MOST_LINE_BYTES, STATELESS, VERSIONS
from lithe.mcp.server import INSTRUCTIONS, MOST_ANSWER_BYTES, MOST_CALLS, MOST_STOPS, Server
from lithe.remote import Remote
from lithe.shm import dtype
from lithe.vocabulary import BY_NAME, VERBS, Effect, Tier, nearest
from system.robot_rig import RobotRig

Json = dict[str, Any]


class Fake:
    """A robot that answers what it was asked, and a server for it."""

    def __init__(self, folder: Path) -> None:
        self.asked: list[tuple[str, Json]] = []
        self.answers: list[Json] = []
        self.permission = folder / "may-move"
        self.result: Any = {"fine": True}
        self.server = Server(self.call, self.permission)

    def call(self, verb: str, args: Json) -> Any:
        self.asked.append((verb, args))
        if verb == "documents":
            return {"documents": documents.listed()}
        if verb == "document":
            return documents.read(args["name"], lambda: Path(self.result["records"]))
        if isinstance(self.result, Exception):
            raise self.result
        return self.result

    def send(self, method: str, params: Any = None, name: Any = 1) -> Json:
        """The answer to one request."""
        self.line(json.dumps({"jsonrpc": "2.0", "id": name, "method": method, "params": params or {}}).encode())
        return self.answers[-1]

    def line(self, line: bytes) -> None:
        self.server.line(line, self.answers.append)
        self.server.finish()

    def tool(self, name: str, /, **args: Any) -> Json:
        result: Json = self.send("tools/call", {"name": name, "arguments": args})["result"]
        return result


@pytest.fixture
def fake(tmp_path: Path) -> Fake:
    return Fake(tmp_path)


def text(result: Json) -> str:
    return str(result["content"][0]["text"])


@pytest.mark.parametrize(
    ("asked", "given"),
    [(HANDSHAKE[2], HANDSHAKE[2]), ("1999-01-01", HANDSHAKE[0]), (STATELESS, HANDSHAKE[0]), (7, HANDSHAKE[0])],
)
def test_both_sides_agree_on_a_version(fake: Fake, asked: Any, given: str) -> None:
    told = fake.send("initialize", {"protocolVersion": asked, "capabilities": {}})["result"]
    assert told["protocolVersion"] == given and told["serverInfo"] == {"name": "lithe", "version": lithe.__version__}
    assert set(told["capabilities"]) == {"tools", "resources", "prompts"}
    fake.line(b'{"jsonrpc": "2.0", "method": "notifications/initialized"}')
    assert len(fake.answers) == 1, "a notification gets no answer"
    assert fake.send("ping", name="a")["id"] == "a"


def test_a_client_without_a_handshake_is_told_the_same(fake: Fake) -> None:
    meta = {META + "protocolVersion": STATELESS, META + "clientCapabilities": {}}
    told = fake.send("server/discover", {"_meta": meta})["result"]
    assert told["supportedVersions"] == VERSIONS and set(told["capabilities"]) == {"tools", "resources", "prompts"}
    assert told["_meta"][META + "serverInfo"]["name"] == "lithe" and "`describe`" in told["instructions"]
    listed = fake.send("tools/list", {"_meta": meta})["result"]
    assert listed == fake.send("tools/list")["result"] | {"resultType": "complete", "ttlMs": 0, "cacheScope": "private"}
    assert fake.send("server/discover")["error"]["message"].startswith("params._meta lacks io.modelcontextprotocol")


def test_a_robot_that_does_not_run_is_an_answer_and_the_server_lives(fake: Fake) -> None:
    fake.server._call = lambda *_: (_ for _ in ()).throw(NotRunning("no gateway at 127.0.0.1:7423"))
    for method, params in (("resources/list", {}), ("resources/read", {"uri": "lithe://contract"})):
        told = fake.send(method, params)["error"]
        assert (told["code"], told["message"]) == (-32603, "no gateway at 127.0.0.1:7423")
    assert fake.send("ping")["result"] == {}


@pytest.mark.parametrize("method", ["tools/list", "resources/list", "resources/templates/list", "prompts/list"])
def test_there_is_one_page(fake: Fake, method: str) -> None:
    (key,) = set(fake.send(method)["result"])
    assert key.endswith("s"), "and no nextCursor"
    assert fake.send(method, {"cursor": "2"})["error"]["code"] == -32602


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b"{", -32700),
        (b"[" * 100_000, -32700),
        (b"\xff\xfe", -32700),
        (b"[]", -32600),
        (b'{"id": 1, "method": "ping"}', -32600),
        (b'{"jsonrpc": "2.0", "id": null, "method": "ping"}', -32600),
        (b'{"jsonrpc": "2.0", "id": 1, "method": "ping", "params": [1]}', -32600),
        (b'{"jsonrpc": "2.0", "id": 1, "method": "dance"}', -32601),
        (b'{"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "dance"}}', -32602),
        (b'{"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "arm", "arguments": [1]}}', -32602),
        (b'{"jsonrpc": "2.0", "id": 1, "method": "resources/read", "params": {"uri": "file:///etc/passwd"}}', -32602),
        (b'{"jsonrpc": "2.0", "id": 1, "method": "resources/read", "params": {"uri": "lithe://laws/../x"}}', -32602),
        (b'{"jsonrpc": "2.0", "id": 1, "method": "prompts/get", "params": {"name": "dance"}}', -32602),
        (b" " * (MOST_LINE_BYTES + 1), -32600),
    ],
)
def test_a_bad_message_gets_an_error_and_reaches_no_robot(fake: Fake, line: bytes, code: int) -> None:
    fake.line(line)
    assert fake.answers[-1]["error"]["code"] == code and fake.answers[-1]["error"]["message"]
    assert isinstance(fake.answers[-1].get("id", 0), int), "its own, or none"
    assert [verb for verb, _ in fake.asked if verb != "document"] == [], "the gateway refuses an unknown document"
    assert fake.send("ping")["result"] == {}, "the next message is handled"


def test_every_verb_is_a_tool_with_its_arguments(fake: Fake) -> None:
    tools = {each["name"]: each for each in fake.send("tools/list")["result"]["tools"]}
    assert set(tools) == set(BY_NAME)
    assert tools["swap"]["inputSchema"]["required"] == ["source"]
    assert "annotations" not in tools["swap"], "not read-only, and destructive"
    assert tools["status"]["annotations"] == {"readOnlyHint": True}
    assert tools["hold"]["annotations"] == {"destructiveHint": False}


def test_nothing_moves_without_a_persons_permission(fake: Fake) -> None:
    moving = [each.name for each in VERBS if each.effect is Effect.moves]
    assert {"swap", "arm", "publish", "set_params", "recover", "reset"} <= set(moving)
    for name in moving:
        told = fake.tool(name)
        assert told["isError"] and text(told).startswith("no_permission") and "lithe.mcp allow" in text(told)
    assert fake.asked == []
    permission.give(fake.permission, 1)
    assert not fake.tool("arm")["isError"] and fake.asked == [("arm", {})]
    permission.take_back(fake.permission)
    assert fake.tool("arm")["isError"] and len(fake.asked) == 1


def test_a_stop_never_needs_one(fake: Fake) -> None:
    stopping = [each.name for each in VERBS if each.effect is Effect.stops and each.tier is Tier.observe]
    assert set(stopping) == {"hold", "disarm", "estop", "stop_reference"}
    for name in stopping:
        assert not fake.tool(name)["isError"]
    assert [verb for verb, _ in fake.asked] == stopping


def test_a_permission_ends_and_cannot_be_made_longer(tmp_path: Path) -> None:
    file = tmp_path / "may-move"
    for minutes in (0, -1, float("nan"), 1e9):
        with pytest.raises(lithe.LitheError, match="minutes"):
            permission.give(file, minutes)
    permission.give(file, 5)
    assert permission.tier_in(file) is Tier.move, "if nothing is said"
    permission.give(file, 5, Tier.tune)
    assert permission.tier_in(file) is Tier.tune
    for spoilt in (
        "",
        "{",
        "[]",
        '{"until_unix_s": "x"}',
        '{"until_unix_s": 1}',
        '{"until_unix_s": 1e300}',
        '{"until_unix_s": NaN}',
        f'{{"until_unix_s": {time.time() + 60}}}',
        f'{{"until_unix_s": {time.time() + 60}, "tier": "god"}}',
    ):
        file.write_text(spoilt)
        assert permission.tier_in(file) is Tier.observe, spoilt
    permission.give(file, 5)
    file.chmod(0o644)
    assert permission.tier_in(file) is Tier.observe, "others could have had it"
    permission.give(file, 5)
    file.rename(tmp_path / "other")
    file.symlink_to(tmp_path / "other")
    assert permission.tier_in(file) is Tier.observe, "a link"


def test_a_refusal_says_code_and_next_step(fake: Fake) -> None:
    fake.result = Refused("trial_failed", "joint 1 swings", "less gain", {"section": "rough"})
    told = fake.tool("law_check", source="x")
    assert told["isError"] and text(told) == 'trial_failed: joint 1 swings\nnext: less gain\n{"section": "rough"}'
    fake.result = NotRunning("no gateway at 127.0.0.1:7423: python -m lithe.gateway")
    assert text(fake.tool("status")).startswith("not_running: no gateway")


def test_a_history_that_is_too_long_is_thinned_until_it_fits_and_says_so(fake: Fake) -> None:
    def history(verb: str, args: Json) -> Json:
        fake.asked.append((verb, args))
        return {"tick": [n for n in range(100_000, 140_000) if n % args.get("every", 1) == 0], "lost": 0}

    fake.server._call = history
    told = json.loads(text(fake.tool("history", seconds=40)))
    assert told["every"] == 10 and "every=10" in told["note"] and told["tick"][:2] == [100_000, 100_010]
    assert len(fake.asked) == 2, "what cannot fit is not asked for"
    asked = json.loads(text(fake.tool("history", seconds=40, every=3)))
    assert asked["every"] == 6 and asked["tick"][0] % 6 == 0, "a multiple of what was asked for"
    short = json.loads(text(fake.tool("history", every=1000)))
    assert "every" not in short and "note" not in short


def test_an_answer_that_would_fill_the_context_is_refused_with_a_remedy(fake: Fake) -> None:
    fake.result = ["x" * MOST_ANSWER_BYTES]
    told = fake.tool("history", seconds=4)
    assert told["isError"] and "too_long" in text(told) and "every=N" in text(told)


def test_a_stop_does_not_wait_for_calls_that_last(tmp_path: Path) -> None:
    slow, asked = threading.Event(), threading.Event()
    answers: list[Json] = []

    def call(verb: str, _: Json) -> Any:
        if verb == "status":
            asked.set()
            slow.wait(60)
        return verb

    server = Server(call, tmp_path / "none")
    for name in range(MOST_CALLS + 1):
        server.line(
            b'{"jsonrpc": "2.0", "id": %d, "method": "tools/call", "params": {"name": "status"}}' % name, answers.append
        )
    assert asked.wait(60)
    assert [(each["id"], text(each["result"])[:4]) for each in answers] == [(MOST_CALLS, "busy")]
    server.line(
        b'{"jsonrpc": "2.0", "id": "stop", "method": "tools/call", "params": {"name": "estop"}}', answers.append
    )
    until = time.monotonic() + 60
    while len(answers) < 2 and time.monotonic() < until:
        time.sleep(0.01)
    assert answers[1]["id"] == "stop", "while all other calls still run"
    slow.set()
    server.finish()
    assert len(answers) == MOST_CALLS + 2


def test_contract_rules_laws_and_swaps_can_be_read(fake: Fake, tmp_path: Path) -> None:
    uris = [each["uri"] for each in fake.send("resources/list")["result"]["resources"]]
    assert {"lithe://contract", "lithe://rules", "lithe://swaps", "lithe://laws/pd.cpp"} <= set(uris)
    (tmp_path / "0001.json").write_text('{"law": "pd", "verdict": "confirmed", "toolchain": {}}')
    (tmp_path / "0002.json").write_text("{")
    fake.result = {"records": str(tmp_path)}
    for uri in (each for each in uris if not each.endswith(".png")):
        one = fake.send("resources/read", {"uri": uri})["result"]["contents"][0]
        assert one["uri"] == uri and one["text"]
    swaps = json.loads(fake.send("resources/read", {"uri": "lithe://swaps"})["result"]["contents"][0]["text"])
    assert swaps == [{"certificate": "swaps/0001", "law": "pd", "verdict": "confirmed"}]
    (tmp_path / "0003.json").write_text(json.dumps({"law": "x" * MOST_ANSWER_BYTES}))
    told = fake.send("resources/read", {"uri": "lithe://swaps/0003"})["error"]["message"]
    assert f"at most {MOST_ANSWER_BYTES}" in told and "swaps has every certificate in short" in told
    told = text(fake.tool("document", name="swaps/0003"))
    assert told.startswith("too_long") and "swaps has every certificate in short" in told and "every=N" not in told


def test_prompts_take_the_words_of_the_person(fake: Fake) -> None:
    for each in fake.send("prompts/list")["result"]["prompts"]:
        told = fake.send("prompts/get", {"name": each["name"], "arguments": {"about": "joint 2"}})["result"]
        assert told["messages"][0]["content"]["text"].endswith("\n\njoint 2")
        assert library.prompt(each["name"], {})["messages"][0]["content"]["text"].endswith("."), "no empty heading"
    assert "`identify`" in library.prompt("identify_then_compensate", {})["messages"][0]["content"]["text"]
    assert "`swap` with dry_run" in library.prompt("explain_this_refusal", {})["messages"][0]["content"]["text"]


def test_wrong_names_of_arguments_are_named() -> None:
    check(BY_NAME["swap"], {"source": "x", "blend_s": 0.1})
    with pytest.raises(Refused, match="'swap' has no argument 'probation'") as wrong:
        check(BY_NAME["swap"], {"source": "x", "probation": 1})
    assert wrong.value.code == "usage" and wrong.value.next.startswith("did you mean 'probation_s'?")
    with pytest.raises(Refused) as wrong:
        check(BY_NAME["estop"], {"now": 1})
    assert wrong.value.next == "it takes none"
    assert nearest("statis", BY_NAME).startswith("did you mean 'status'?")


def test_a_thousand_stops_take_a_bounded_number_of_threads_and_an_estop_still_has_a_place(fake: Fake) -> None:
    go_on, call = threading.Event(), fake.server._call

    def slow(verb: str, args: Json) -> Any:
        if verb == "hold":
            go_on.wait(60)
        return call(verb, args)

    fake.server._call = slow
    before = threading.active_count()
    for name in range(1000):
        line = {"jsonrpc": "2.0", "id": name, "method": "tools/call", "params": {"name": "hold"}}
        fake.server.line(json.dumps(line).encode(), fake.answers.append)
    assert threading.active_count() - before <= MOST_STOPS
    assert len(fake.answers) == 1000 - MOST_STOPS and "busy" in text(fake.answers[0]["result"])
    stop = b'{"jsonrpc": "2.0", "id": "e", "method": "tools/call", "params": {"name": "estop"}}'
    fake.server.line(stop, fake.answers.append)
    until = time.monotonic() + 60
    while fake.answers[-1]["id"] != "e" and time.monotonic() < until:
        time.sleep(0.01)
    assert fake.answers[-1]["id"] == "e"
    go_on.set()
    fake.server.finish()
    assert len(fake.answers) == 1001


def test_a_thousand_stops_keep_no_other_client_waiting(gateway: Gateway, remote: Remote, tmp_path: Path) -> None:
    answers: list[Json] = []
    with Remote("127.0.0.1", gateway.port, "sesame") as flooding:
        server = Server(lambda verb, args: flooding.call(verb, **args), tmp_path / "none")
        for name in range(1000):
            line = {"jsonrpc": "2.0", "id": name, "method": "tools/call", "params": {"name": "hold"}}
            server.line(json.dumps(line).encode(), answers.append)
            if name % 100 == 50:
                assert remote.call("latest", fields=["tick"])["tick"] > 0
        server.finish()
    assert sorted(each["id"] for each in answers) == list(range(1000))
    assert gateway.robot.status()["mode"] == "hold"


def test_a_reference_ends_with_the_permission(gateway: Gateway, tmp_path: Path) -> None:
    permit = tmp_path / "may-move"
    permission.give(permit, 5)
    answers: list[Json] = []
    asked = {"kind": "sine", "centre_rad": 0.0, "amplitude_rad": 0.3, "frequency_hz": 1.0, "stay": True}
    with Remote("127.0.0.1", gateway.port, "sesame") as robot:
        server = Server(lambda verb, args: robot.call(verb, **args), permit)
        line = {"jsonrpc": "2.0", "id": 1, "method": "tools/call",
                "params": {"name": "set_reference", "arguments": asked}}  # fmt: skip
        server.line(json.dumps(line).encode(), answers.append)
        RobotRig.wait_for(lambda: len(answers) == 1)
        assert not answers[0]["result"]["isError"], answers
        assert robot.call("reference")["asked"]["kind"] == "sine"
        permission.take_back(permit)
        RobotRig.wait_for(lambda: robot.call("reference")["asked"]["kind"] == "rest")
        assert robot.call("reference")["ended"] == "stopped"
        permission.give(permit, 5)
        server.line(json.dumps(line).encode(), answers.append)
        server.finish()
    RobotRig.wait_for(lambda: gateway.references.told()["asked"]["kind"] == "rest")
    assert gateway.references.told()["ended"] == "its client has left", "nobody watches the permission any more"


def test_a_reference_that_is_to_stay_keeps_its_time_of_silence_and_is_told_how_it_ends(fake: Fake) -> None:
    permission.give(fake.permission, 5)
    for given, sent in (({}, 3600.0), ({"client_stale_s": 900}, 900)):
        fake.result = {"since_ns": 0, "asked": {"kind": "sine", "client_stale_s": sent}}
        told = json.loads(text(fake.tool("set_reference", kind="sine", stay=True, **given)))
        asked = next(args for verb, args in reversed(fake.asked) if verb == "set_reference")
        assert asked == {"kind": "sine", "stay": False, "client_stale_s": sent}
        assert "stay is false here: over MCP a reference ends" in told["note"] and f"{sent:g} s" in told["note"]
    permission.take_back(fake.permission)


def test_describe_leaves_out_the_verbs_that_are_tools(fake: Fake) -> None:
    fake.result = {"robot": "arm", "verbs": [each.described() for each in VERBS]}
    assert json.loads(text(fake.tool("describe"))) == {"robot": "arm"}


def test_no_tool_names_a_file_that_an_agent_cannot_read(fake: Fake) -> None:
    told = json.dumps([fake.send("tools/list"), fake.send("prompts/list")])
    assert ".md" not in told and {"agents", "telemetry", "verbs"} <= set(documents.FIXED)
    assert str(MOST_ANSWER_BYTES) in BY_NAME["history"].what


def test_a_prompt_moves_the_robot_by_a_reference_that_outlasts_a_thought(fake: Fake) -> None:
    for name in ("identify_then_compensate", "improve_by_one_term"):
        told = fake.send("prompts/get", {"name": name})["result"]["messages"][0]["content"]["text"]
        assert "`set_reference`" in told and "client_stale_s 900" in told and "`publish`" not in told
        assert "verdict" in told and "`rollback`" in told


def test_what_a_prompt_names_is_there(fake: Fake, tmp_path: Path) -> None:
    """For a model that has nothing else: every tool, argument, field and resource."""
    (tmp_path / "0001.cpp").write_text("// a law")
    fake.result = {"records": str(tmp_path)}
    there = {each["uri"] for each in fake.send("resources/list")["result"]["resources"]}
    words = {*BY_NAME, *(dtype("Telemetry").names or ()), *(arg for verb in VERBS for arg in verb.args)}
    words |= {"no_permission", "rolled_back"}  # of answers
    for name in library.PROMPTS:
        told = library.prompt(name, {})["messages"][0]["content"]["text"]
        assert set(re.findall(r"`(\w+)`", told)) <= set(BY_NAME), name
        named = set(re.findall(r"lithe://[\w./-]*\w", told))
        laws = {"lithe://swaps/NUMBER.cpp", "lithe://laws/NAME.cpp"}
        assert named - laws <= there and named, named - there
        assert set(re.findall(r"\b[a-z]+(?:_[a-z]+)+\b", told)) <= words, name
    assert "text" in fake.send("resources/read", {"uri": "lithe://swaps/0001.cpp"})["result"]["contents"][0]
    assert set(re.findall(r"`(\w+)`", INSTRUCTIONS)) <= set(BY_NAME)
    assert set(re.findall(r"(plots/[\w-]+\.png)", INSTRUCTIONS)) <= set(plots.ALWAYS)
