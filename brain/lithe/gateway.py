# SPDX-License-Identifier: Apache-2.0
"""The Brain's TCP gateway: an agent in another process, or on another machine, does all that the Brain can.

JSON lines. The first line is {"token": "..."}; then requests {"id", "verb", "args"}, answered as on the control socket:
{"id", "ok": true, "result"} or {"id", "ok": false, "error": {"code", "message", "next"}}. The gateway's own verbs:

    describe  {}                                        robot, rate, joints with their limits, time now
    latest    {fields?}                                 the newest telemetry record
    history   {seconds?, since_tick?, every?, fields?}  columns of records, at most the last 4096 ticks
    publish   {t_ns, position_rad, velocity_rad_s?, streaming?}   a plan of up to 16 waypoints
    estop     {}                                        at once, through shared memory; answered when a tick has obeyed
    reset     {}                                        lifts that e-stop too, which the supervisor cannot

An application may add verbs. Every other verb (status, swap, rollback, params, set_params, arm, ...) goes to the
supervisor. Loopback by default; the token lies in a file of mode 0600.

Threads: one per client; plans and telemetry are serialised by a lock.
"""

from __future__ import annotations

import argparse
import contextlib
import hmac
import json
import math
import os
import secrets
import socketserver
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .control import run_dir
from .errors import LitheError, Refused
from .robot import Robot, connect

MOST_REQUEST_BYTES = 1 << 20
MOST_POINTS = 20_000
Verb = Callable[[dict[str, Any]], Any]


def write_token(path: Path) -> str:
    """A fresh token in a file that only its owner can read."""
    token = secrets.token_hex(16)
    path.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(FileNotFoundError):
        path.unlink()
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(fd, "w") as file:
        file.write(token + "\n")
    return token


def encode(answer: dict[str, Any]) -> bytes:
    """One line of JSON; NaN and infinity, which JSON has no words for, become null."""
    try:
        return json.dumps(answer, allow_nan=False).encode() + b"\n"
    except ValueError:
        return json.dumps(_with_nulls(answer)).encode() + b"\n"


def _with_nulls(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _with_nulls(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_nulls(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class Gateway:
    """Serves one Robot. `verbs` are the application's own, added to or in place of the gateway's."""

    def __init__(
        self,
        robot: Robot,
        verbs: dict[str, Verb] | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
        token: str = "",
    ) -> None:
        self.robot = robot
        self.token = token
        self.lock = threading.Lock()
        self.verbs: dict[str, Verb] = {
            "describe": self._describe,
            "latest": self._latest,
            "history": self._history,
            "publish": self._publish,
            "estop": lambda _: robot.estop(),
            "reset": lambda _: robot.reset(),
            **(verbs or {}),
        }
        gateway = self

        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                gateway._serve(self)

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address = True
            daemon_threads = True

        try:
            self._server = Server((host, port), Handler)
        except OSError as error:
            raise LitheError(f"cannot listen on {host}:{port} ({error.strerror}): choose another port") from None
        self.port = int(self._server.server_address[1])

    def start(self) -> None:
        """Serves in a thread of its own until close()."""
        threading.Thread(target=self._server.serve_forever, name="lithe-gateway", daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()

    def _serve(self, handler: socketserver.StreamRequestHandler) -> None:
        first = handler.rfile.readline(4096)
        try:
            given = str(json.loads(first).get("token", ""))
        except (ValueError, AttributeError):
            given = ""
        if not hmac.compare_digest(given.encode(), self.token.encode()):
            answer = {
                "ok": False,
                "error": {"code": "token", "message": "wrong token", "next": "read it from the token file"},
            }
            handler.wfile.write(json.dumps(answer).encode() + b"\n")
            return
        handler.wfile.write(b'{"ok": true}\n')
        while line := handler.rfile.readline(MOST_REQUEST_BYTES + 1):
            answer = self._answer(line)
            with contextlib.suppress(OSError):  # the client left: nothing to answer
                handler.wfile.write(encode(answer))
            if len(line) > MOST_REQUEST_BYTES:
                return  # the rest of an oversized line cannot be told from a new request

    def _answer(self, line: bytes) -> dict[str, Any]:
        request: Any = None
        try:
            if len(line) > MOST_REQUEST_BYTES:
                raise Refused("too_long", f"a request has at most {MOST_REQUEST_BYTES} bytes")
            request = json.loads(line)
            if not isinstance(request, dict) or not isinstance(request.get("args", {}), dict):
                raise Refused("bad_request", "a request is an object with id, verb and args")
            result = self._call(str(request.get("verb", "")), request.get("args", {}))
            return {"id": request.get("id"), "ok": True, "result": result}
        except Refused as error:
            body = {"code": error.code, "message": error.message, "next": error.next, "detail": error.detail}
        except LitheError as error:
            body = {"code": "error", "message": str(error), "next": ""}
        except (ValueError, TypeError, KeyError, ArithmeticError, RecursionError) as error:
            body = {
                "code": "bad_request",
                "message": f"bad request: {error}",
                "next": "verbs and arguments: docs/reference/verbs.md",
            }
        return {"id": request.get("id") if isinstance(request, dict) else None, "ok": False, "error": body}

    def _call(self, verb: str, args: dict[str, Any]) -> Any:
        own = self.verbs.get(verb)
        return own(args) if own is not None else self.robot.call(verb, **args)

    # ---- the gateway's own verbs
    def _describe(self, _: dict[str, Any]) -> Any:
        info = self.robot.spine.info
        joints = range(self.robot.spine.joint_count)
        limits = ("position_min_rad", "position_max_rad", "velocity_max_rad_s", "torque_max_nm", "torque_slew_nm_s")
        return {
            "robot": self.robot.name,
            "rate_hz": float(info["rate_hz"]),
            "joints": [
                {"name": self.robot.spine.joint_names[j], **{key: float(info[key][j]) for key in limits}}
                for j in joints
            ],
            "now_ns": time.monotonic_ns(),
        }

    def _records(self, records: Any, fields: list[str]) -> dict[str, Any]:
        joints = self.robot.spine.joint_count
        out: dict[str, Any] = {}
        for name in fields:
            if name not in records.dtype.names:
                raise Refused(
                    "unknown_field", f"telemetry has no field '{name}'", f"one of {', '.join(records.dtype.names)}"
                )
            column = records[name]
            out[name] = (column[..., :joints] if column.ndim > records.ndim and name != "probe" else column).tolist()
        return out

    def _latest(self, args: dict[str, Any]) -> Any:
        with self.lock:
            record = self.robot.telemetry.latest()
        if record is None:
            raise Refused("not_ready", "no tick yet", "ask again")
        return self._records(record, args.get("fields") or list(record.dtype.names or ()))

    def _history(self, args: dict[str, Any]) -> Any:
        """The last `seconds` (at most 4096 ticks), or all records after tick `since_tick`; every `every`-th one."""
        with self.lock:
            records = self.robot.telemetry.history(float(args.get("seconds", 1.0)))
        if "since_tick" in args:
            records = records[records["tick"] > int(args["since_tick"])]
        records = records[:: max(1, int(args.get("every", 1)))][-MOST_POINTS:]
        return self._records(records, args.get("fields") or ["tick", "release_ns", "position_rad"])

    def _publish(self, args: dict[str, Any]) -> Any:
        velocity = args.get("velocity_rad_s")
        with self.lock:
            plan_id = self.robot.publish(
                np.asarray(args["t_ns"], dtype=np.int64),
                np.asarray(args["position_rad"], dtype=np.float64),
                None if velocity is None else np.asarray(velocity, dtype=np.float64),
                bool(args.get("streaming", True)),
            )
        return {"plan_id": plan_id}


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m lithe.gateway", description="Opens a running robot to agents over TCP."
    )
    parser.add_argument("--robot", help="name; the only one running if left out")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    parser.add_argument("--port", type=int, default=7423)
    parser.add_argument("--token-file", type=Path, default=run_dir() / "gateway.token")
    args = parser.parse_args()
    try:
        robot = connect(args.robot)
        gateway = Gateway(robot, host=args.host, port=args.port, token=write_token(args.token_file))
    except (LitheError, OSError) as error:
        print(f"lithe.gateway: {error}")
        return 1
    gateway.start()
    print(f"robot {robot.name} at {args.host}:{gateway.port}, token in {args.token_file}", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            robot.beat()
            time.sleep(0.05)
    gateway.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
