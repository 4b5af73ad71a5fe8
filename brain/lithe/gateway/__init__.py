# SPDX-License-Identifier: Apache-2.0
"""The Brain's TCP gateway: an agent in another process, or on another computer, can do everything that the Brain can.

JSON lines. The first line is {"token": "..."}; with "client": "SECRET" all connections that name it are one client
(peer.py). Then requests {"id", "verb", "args"}, answered as on the control socket:
{"id", "ok": true, "result"} or {"id", "ok": false, "error": {"code", "message", "next"}}. All verbs are in one table
(vocabulary.py); those of `_ours` are the gateway's own, an application may add others, and the rest goes to the
supervisor. A token has a tier (vocabulary.py), which says what its client may do; an application's verbs need `move`.
`estop` is done through shared memory and answered after a tick saw it; `reset` also clears that word, which
the supervisor cannot. Loopback by default; the token lies in a file of mode 0600.

Who is served when: an e-stop ahead of everything, also of this client's own requests, and also where all places are
taken (hello {"token": "...", "estop": true}, which is answered as the verb is, and hung up on). Then verbs that move or
stop the robot. Long answers are made one at a time, in pieces, in turn.

Bounds: 32 clients; who has not shown the token waits apart from them, 6 s at most (lobby.py). A client has
256 KiB of requests pending; a long answer has 8 MiB at most, all that are not yet read 32 MiB together; who does not
read for 5 s is disconnected, and the gateway says so on stderr. Nothing a client sends ends more than its own
connection.
"""

from __future__ import annotations

import contextlib
import json
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .._wire import Mode
from ..certificates import params_with_verdict, with_verdict
from ..errors import LitheError, NotRunning, Refused
from ..identify import live
from ..robot import Robot
from ..vocabulary import BY_NAME, VERBS, Effect, Tier, nearest, tier_of
from . import changes, documents, dry, happened
from .answers import Encoded, check, encode, in_the_words_of_verbs, refusal, refused_by, unprintable_in
from .brief import brief, brief_detail, brief_params, brief_status, diff
from .changes import LawWatch, unproven
from .client import MOST_REQUEST_BYTES, Client
from .lease import USUAL_S, Lease
from .lobby import Hello, Lobby
from .parts import chain_of, parts_of, simulation_of
from .peer import AWAY_S, Peer, Peers, Pressed, peer_of
from .records import Records
from .references import References
from .token import lower, write_token
from .turns import Turns

__all__ = ["Gateway", "encode", "write_token"]

MOST_CLIENTS = 32  # each may keep a connection to the supervisor, which serves 64
FIRST = frozenset(each.name for each in VERBS if each.first)  # they move or stop the robot
Verb = Callable[[dict[str, Any]], Any]


def _text(raw: Any) -> str:
    return bytes(raw).split(b"\0", 1)[0].decode(errors="replace")


class Gateway:
    """Serves one Robot on `host`:`port` (0: any free one, see .port) to clients with `token`, which may do what `tier`
    says, and to those with a token of a lower tier (token.lower).

    `verbs` are the application's own; they add to or replace the gateway's: functions of the args, called in a thread
    of the client's. `say` gets a line for each disconnected client; the default writes to stderr.
    """

    def __init__(
        self,
        robot: Robot,
        verbs: dict[str, Verb] | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        token: str,
        tier: Tier = Tier.move,
        say: Callable[[str], None] | None = None,
    ) -> None:
        if not token.strip():
            raise LitheError(
                "the gateway's token is empty: anybody could move the robot\n  next: token=write_token(path)"
            )
        self.robot = robot
        self.token = token.strip()
        self.turns = Turns()
        self._say = say or (lambda words: print(f"lithe.gateway: {words}", file=sys.stderr, flush=True))
        self._places = threading.BoundedSemaphore(MOST_CLIENTS)
        self.references = References(robot)
        self.pressed = Pressed(robot)
        self.lease = Lease()
        self.peers = Peers()
        self.laws = LawWatch(robot)
        self.records = Records(robot, self.turns)
        # .client: whose request this thread handles; .stop_waits(): it has asked for a stop since
        self._asking = threading.local()
        self._ours: dict[str, Verb] = {
            "describe": self._describe,
            "status": self._status,
            "latest": self.records.latest,
            "history": self.records.history,
            "measure": self.records.measure,
            "publish": self._publish,
            "set_inputs": self._set_inputs,
            "swap": self._swap,
            "shadow": lambda args: self._swap(dry.compared(args)),
            "identify": self._identify,
            "estop": lambda _: self.pressed.estop(self._asking.client),
            "reset": lambda _: self.pressed.reset(),
            "state": lambda _: robot.state(),
            "documents": lambda _: {"documents": documents.listed()},
            "document": self._document,
            "sim_truth": lambda _: self._sim_truth(),
            "events": lambda args: happened.told(robot.call("events", **happened.asked(args)), args),
            "set_reference": self._set_reference,
            "reference": lambda _: self.references.told(),
            "stop_reference": lambda _: self.references.stop(),
            "lease": self._lease_verb,
        }
        self.verbs: dict[str, Verb] = {**self._ours, **(verbs or {})}
        no = refusal(None, Refused("token", "wrong token", "read it from the token file"))
        try:
            tokens = {self.token: tier} | {lower(self.token, each): each for each in Tier if each < tier}
            self._lobby = Lobby(host, port, tokens, self._admit, no)
        except (OSError, OverflowError) as error:  # OverflowError: no number of a port
            why = error.strerror if isinstance(error, OSError) else error
            raise LitheError(f"cannot listen on {host}:{port} ({why}): choose another host or port") from None
        self.port = self._lobby.port

    def start(self) -> None:
        """Serves in its own threads until close()."""
        self._lobby.start()

    def close(self) -> None:
        """Accepts no more clients; connected ones stay until they leave."""
        self._lobby.close()

    def _admit(self, link: socket.socket, hello: Hello, rest: bytes, tier: Tier) -> bytes | None:
        """A client that knows the token gets a place, or is refused; for an e-stop it needs none."""
        if hello.get("estop") is True:
            who = link, peer_of(link, hello, tier)
            threading.Thread(target=self._estop_only, args=who, name="lithe-gateway-estop", daemon=True).start()
            return None
        if not self._places.acquire(blocking=False):
            many = f"{MOST_CLIENTS} clients are served already"
            return refusal(None, Refused("busy", many, "try later; an e-stop needs no place"))
        words = link, rest, self.peers.came(link, hello, tier)
        threading.Thread(target=self._serve, args=words, name="lithe-gateway-client", daemon=True).start()
        return None

    def _estop_only(self, link: socket.socket, me: Peer) -> None:
        with link, contextlib.suppress(OSError):
            link.settimeout(5.0)
            link.sendall(self._answer(b'{"id": 1, "verb": "estop"}', me)[0])

    def _serve(self, link: socket.socket, rest: bytes, me: Peer) -> None:
        try:
            with link:
                client = Client(
                    link, rest, lambda line: self._answer(line, me, client.stop_waits), self.turns, self._say
                )
                client.serve()
        except OSError:
            pass  # it has left already
        finally:
            if self.peers.left(me):
                self.references.left(me)
                self.lease.left(me, AWAY_S if me.lasts else 0.0)
            self._places.release()

    def _answer(
        self, line: bytes, client: Peer | None = None, stop_waits: Callable[[], bool] = lambda: False
    ) -> tuple[bytes, int]:
        """The line that answers a request, and how much of it `turns` keeps as not yet sent."""
        self._asking.client, self._asking.stop_waits = client, stop_waits
        self.references.heard(client)
        name: Any = None
        kept = 0
        try:
            if len(line) > MOST_REQUEST_BYTES:
                raise Refused("too_long", f"a request has at most {MOST_REQUEST_BYTES} bytes", "send less at once")
            request = json.loads(line)
            if not isinstance(request, dict):
                raise Refused("bad_request", "a request is an object with id, verb and args")
            name = request.get("id")
            args = request.get("args", {})
            if not isinstance(args, dict):
                raise Refused("bad_request", "args is an object", "see the document verbs")
            if word := unprintable_in({"verb": request.get("verb"), "args": args}):
                raise Refused("bad_request", f"{word} is not printable text", "names hold no control characters")
            result = in_the_words_of_verbs(self._call(str(request.get("verb", "")), args))
            kept = len(result) if isinstance(result, Encoded) else 0
            return encode({"id": name, "ok": True, "result": result}), kept
        except Exception as error:  # also one in an application's verb: it must not look like a dead gateway
            return refusal(None if isinstance(error, RecursionError) else name, refused_by(error)), kept

    def _call(self, verb: str, args: dict[str, Any]) -> Any:
        own = self.verbs.get(verb)
        if own is None and verb not in BY_NAME:
            raise Refused("unknown_verb", f"there is no verb '{verb}'", nearest(verb, {*BY_NAME, *self.verbs}))
        ours = own is self._ours.get(verb)
        self._may(verb, args, ours)
        # An application's verbs are not in the table. What stops the robot is never refused for an argument too many.
        if ours and BY_NAME[verb].effect is not Effect.stops:
            check(BY_NAME[verb], args)
        if ours and verb in BY_NAME and "dry_run" in BY_NAME[verb].args and args.pop("dry_run", False):
            return self._dry_run(verb, args)
        if verb in BY_NAME and BY_NAME[verb].effect is Effect.moves:
            self.lease.moves(self._asking.client)
        if verb not in changes.TELL:
            return self._done(own, verb, args)
        client, itself, asked_ns = self._asking.client, verb in changes.OWN, time.monotonic_ns()
        changed, now = self.laws.change(client) if itself else (None, None)
        result = self._done(own, verb, args)
        if not isinstance(result, dict):  # the application's own
            return result
        if itself:
            self.laws.did(client, result, asked_ns)
        else:
            changed, now = self.laws.change(client)
            self.laws.knows(client, now)
        return result | {"law_changed": changed} if changed else result

    @property
    def _tier(self) -> Tier:
        """Of the client whose request this thread handles."""
        client: Peer | None = self._asking.client
        return client.tier if client is not None else Tier.observe

    def _may(self, verb: str, args: dict[str, Any], ours: bool) -> None:
        """Raises Refused when the client's token does not permit it. An application's own verb knows no dry_run."""
        words = args if ours else {key: value for key, value in args.items() if key != "dry_run"}
        needed = tier_of(BY_NAME[verb], words) if verb in BY_NAME else Tier.move
        if needed > self._tier:
            raise Refused(
                "no_permission",
                f"'{verb}' needs a token of tier {needed.name}; this client's is of tier {self._tier.name}",
                f"ask the person who started the gateway for one, or to start it with --tier {needed.name}",
            )

    def _done(self, own: Verb | None, verb: str, args: dict[str, Any]) -> Any:
        wait = verb == "set_params" and own is None and bool(args.pop("wait", False))
        with self.turns.moving() if verb in FIRST else contextlib.nullcontext():
            result = own(args) if own is not None else self.robot.call(verb, **args)
        if not wait:
            return result
        answer = params_with_verdict(self.robot, result, self._wants_more)
        return brief_params(answer | {"warnings": [*self._shows_nothing(), *answer.get("warnings", [])]})

    def _shows_nothing(self) -> list[str]:
        """Why new values have no effect that could be seen now: a sentence, or none."""
        record = self.robot.telemetry.latest()
        if record is not None and int(record["mode"]) not in (Mode.active, Mode.hold):
            mode = Mode(int(record["mode"])).name
            return [f"no law runs: the robot is in mode {mode}; status says why, and what leads back"]
        ended = self.references.told()["ended"]
        return [f"no reference runs ({ended}): at rest nothing shows what the values do"] if ended else []

    # ---- the gateway's own verbs
    def _status(self, args: dict[str, Any]) -> Any:
        whole = self.pressed.told(self.robot.status(), self._asking.client)
        return brief_status(whole) if args.get("brief", True) else whole

    def _describe(self, args: dict[str, Any]) -> Any:
        if "verb" in args:
            if args["verb"] not in BY_NAME:
                raise Refused("unknown_verb", f"there is no verb '{args['verb']}'", nearest(str(args["verb"]), BY_NAME))
            return BY_NAME[args["verb"]].described()
        if not self.robot.attached:
            raise NotRunning(f"robot '{self.robot.name}' has ended, or was started again")
        info = self.robot.spine.info
        names, sensors = self.robot.spine.joint_names, self.robot.spine.sensor_names
        robot_file = self._robot_file()
        drives, kinds = parts_of(robot_file)
        groups = np.array(info["joint_group"]).reshape(-1)
        limits = ("position_min_rad", "position_max_rad", "velocity_max_rad_s", "torque_max_nm", "torque_slew_nm_s")
        return {
            "robot": self.robot.name,
            "rate_hz": float(info["rate_hz"]),
            "joints": [
                {
                    "name": name,
                    "group": _text(groups[j]),
                    "drive": drives.get(name),
                    **{key: float(info[key][j]) for key in limits},
                }
                for j, name in enumerate(names)
            ],
            "chain": chain_of(robot_file),
            "sensors": sensors,
            "sensor_kinds": {name: kinds.get(name) for name in sensors},
            "inputs": self.robot.inputs.get(),
            "documents": [each["name"] for each in documents.listed()],
            "tier": self._tier.name,
            "verbs": [each.described() for each in VERBS],
            "application_verbs": sorted(name for name, one in self.verbs.items() if one is not self._ours.get(name)),
            "now_ns": time.monotonic_ns(),
        }

    def _sim_truth(self) -> Any:
        truth = simulation_of(self._robot_file())
        if truth is None:
            raise Refused("not_simulated", "no joint is simulated by the Spine, or the robot file is gone")
        return truth

    def _robot_file(self) -> Path:
        return Path(_text(self.robot.spine.info["config_path"]))

    def _set_reference(self, args: dict[str, Any]) -> Any:
        return self.references.set(args, self._asking.client) | unproven(self.robot)

    def _dry_run(self, verb: str, args: dict[str, Any]) -> Any:
        args = dry.compared(args) if verb == "shadow" else args
        told = dry.told(self.robot, self.references, verb, args, self._tier)
        lease = self.lease.told(self._asking.client)
        if BY_NAME[verb].effect is Effect.moves and lease["holder"] and not lease["yours"]:
            told["leased_by"] = lease["holder"]
        return told | (self._diff(args) if verb in ("swap", "shadow") else {})

    def _diff(self, args: dict[str, Any]) -> dict[str, Any]:
        """The law of a swap beside the one that runs; {}: its text is not known."""
        with contextlib.suppress(LitheError):
            resident = self.robot.call("law_list")["resident"]
            name = next((each["source"] for each in resident if each["active"] and each.get("source")), "")
            if name:
                return {"diff": diff(self._document({"name": name})["text"], str(args.get("source", "")))}
        return {}

    def _identify(self, args: dict[str, Any]) -> Any:
        with self.turns.long_answer():
            records = self.robot.telemetry.history(float(args.get("seconds", 4.0)))
            names, chain = self.robot.spine.joint_names, chain_of(self._robot_file())
            return live.identified(records, names, chain, self.references.limits())

    def _swap(self, args: dict[str, Any]) -> Any:
        wait = bool(args.pop("wait", args.get("brief", False)))
        short = bool(args.pop("brief", True))
        differs = self._diff(args)
        try:
            certificate = self.robot.call("swap", **args, fenced=self._tier < Tier.person)
        except Refused as error:
            if short:
                raise Refused(error.code, error.message, error.next, brief_detail(error.detail)) from None
            raise
        if wait:
            certificate = with_verdict(self.robot, certificate, self._wants_more)
        return (brief(certificate, self.robot.spine.joint_names) if short else certificate) | differs

    def _wants_more(self) -> bool:
        """Whether the client that waits for a verdict has asked for a stop meanwhile; else it is not silent."""
        self.references.heard(self._asking.client)
        return bool(self._asking.stop_waits())

    def _document(self, args: dict[str, Any]) -> Any:
        def records() -> Path:
            return Path(self.robot.call("status")["records"])

        return documents.read(args["name"], records, self.robot.spine.joint_names)

    def _lease_verb(self, args: dict[str, Any]) -> Any:
        who = self._asking.client
        take = args.get("take")
        if take is False:
            self.lease.give_back(who)
        elif take is not None or "seconds" in args:
            return self.lease.take(who, who.name, float(args.get("seconds", USUAL_S)))
        return self.lease.told(who)

    def _set_inputs(self, args: dict[str, Any]) -> Any:
        self.robot.inputs.set(**args["values"])
        return {"sent": args["values"]}

    def _publish(self, args: dict[str, Any]) -> Any:
        velocity = args.get("velocity_rad_s")
        if any(not 0 <= t_ns < 1 << 63 for t_ns in args["t_ns"]):
            raise Refused("usage", "t_ns are nanoseconds of CLOCK_MONOTONIC, below 2^63", "describe.now_ns is now")
        plan_id = self.robot.publish(
            np.asarray(args["t_ns"], dtype=np.int64),
            np.asarray(args["position_rad"], dtype=np.float64),
            None if velocity is None else np.asarray(velocity, dtype=np.float64),
            bool(args.get("streaming", True)),
            args.get("interpolation", "cubic"),
        )
        return {"plan_id": plan_id, "accepted": self.robot.decided(plan_id) or None}
