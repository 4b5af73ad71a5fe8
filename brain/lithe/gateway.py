# SPDX-License-Identifier: Apache-2.0
"""The Brain's TCP gateway: an agent in another process, or on another machine, does all that the Brain can.

JSON lines. The first line is {"token": "..."}; then requests {"id", "verb", "args"}, answered as on the control socket:
{"id", "ok": true, "result"} or {"id", "ok": false, "error": {"code", "message", "next"}}. The gateway's own verbs:

    describe  {}                                        robot, rate, joints with their limits, time now
    latest    {fields?}                                 the newest telemetry record
    history   {seconds? or since_tick?, every?, fields?}    columns of records, at most the last 4096 ticks, and `lost`
    publish   {t_ns, position_rad, velocity_rad_s?, streaming?}   a plan of up to 16 waypoints
    estop     {}                                        at once, through shared memory; answered when a tick has obeyed
    reset     {}                                        lifts that e-stop too, which the supervisor cannot

An application may add verbs. Every other verb (status, swap, rollback, params, set_params, arm, ...) goes to the
supervisor. Loopback by default; the token lies in a file of mode 0600.

Threads: one per client, of whom there are 32 at most; one client's long call holds no other up. Nothing a client sends
ends more than its own connection.
"""

from __future__ import annotations

import argparse
import contextlib
import hmac
import json
import math
import os
import secrets
import signal
import socket
import socketserver
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .control import plain, run_dir
from .errors import LitheError, NotRunning, Refused
from .robot import Robot, connect

MOST_REQUEST_BYTES = 1 << 20
MOST_CLIENTS = 32  # each may keep a connection to the supervisor, which serves 64
HELLO_S = 10.0  # how long a client may take to show its token
UNREAD_S = 30  # how long one may leave an answer unread
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
    """One line of JSON; NaN and infinity, which JSON has no words for, become null. TypeError for what has no form."""
    try:
        text = json.dumps(answer, default=plain, allow_nan=False)
    except ValueError:
        text = json.dumps(_with_nulls(answer), default=lambda value: _with_nulls(plain(value)))
    return text.encode() + b"\n"


def _with_nulls(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _with_nulls(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_with_nulls(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _refusal(name: Any, code: str, message: str, next_step: str = "", detail: dict[str, Any] | None = None) -> bytes:
    body = {"code": code, "message": message, "next": next_step, "detail": detail or {}}
    return encode({"id": name, "ok": False, "error": body})


class Gateway:
    """Serves one Robot on `host`:`port` (0: any free one, see .port) to who knows `token`.

    `verbs` are the application's own, added to or in place of the gateway's: functions of the args, called in the
    client's thread.
    """

    def __init__(
        self,
        robot: Robot,
        verbs: dict[str, Verb] | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        token: str,
    ) -> None:
        if not token.strip():
            raise LitheError(
                "the gateway's token is empty: anybody could move the robot\n  next: token=write_token(path)"
            )
        self.robot = robot
        self.token = token.strip()
        self._places = threading.BoundedSemaphore(MOST_CLIENTS)
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
        """Takes no more clients; those that are connected stay until they leave."""
        self._server.shutdown()
        self._server.server_close()

    def _serve(self, handler: socketserver.StreamRequestHandler) -> None:
        if not self._places.acquire(blocking=False):
            with contextlib.suppress(OSError):
                handler.wfile.write(_refusal(None, "busy", f"{MOST_CLIENTS} clients are served already", "try later"))
                handler.connection.settimeout(0.2)
                handler.connection.recv(4096)  # closing on an unread hello would take the answer back
            return
        try:
            with contextlib.suppress(OSError):  # the client left, or does not read what it asked for
                self._talk(handler)
        finally:
            self._places.release()

    def _talk(self, handler: socketserver.StreamRequestHandler) -> None:
        link = handler.connection
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        link.settimeout(HELLO_S)
        first = handler.rfile.readline(4096)
        try:
            given = str(json.loads(first).get("token", ""))
        except (ValueError, AttributeError, RecursionError):
            given = ""
        if not hmac.compare_digest(given.encode(errors="replace"), self.token.encode()):
            handler.wfile.write(_refusal(None, "token", "wrong token", "read it from the token file"))
            return
        link.settimeout(None)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", UNREAD_S, 0))
        handler.wfile.write(b'{"ok": true}\n')
        while line := handler.rfile.readline(MOST_REQUEST_BYTES + 1):
            handler.wfile.write(self._answer(line))
            if len(line) > MOST_REQUEST_BYTES:
                return  # the rest of an oversized line cannot be told from a new request

    def _answer(self, line: bytes) -> bytes:
        name: Any = None
        try:
            if len(line) > MOST_REQUEST_BYTES:
                raise Refused("too_long", f"a request has at most {MOST_REQUEST_BYTES} bytes")
            request = json.loads(line)
            if not isinstance(request, dict):
                raise Refused("bad_request", "a request is an object with id, verb and args")
            name = request.get("id")
            args = request.get("args", {})
            if not isinstance(args, dict):
                raise Refused("bad_request", "args is an object", "docs/reference/verbs.md")
            return encode({"id": name, "ok": True, "result": self._call(str(request.get("verb", "")), args)})
        except Refused as error:
            return _refusal(name, error.code, error.message, error.next, error.detail)
        except NotRunning as error:
            return _refusal(name, "disconnected", str(error), "start the robot, then ask again")
        except RecursionError:
            return _refusal(None, "bad_request", "bad request: nested too deeply")
        except (ValueError, TypeError, KeyError, ArithmeticError) as error:
            what = f"missing: {error}" if isinstance(error, KeyError) else str(error)
            return _refusal(name, "bad_request", f"bad request: {what}", "verbs and arguments: docs/reference/verbs.md")
        except LitheError as error:
            return _refusal(name, "error", str(error))
        except Exception as error:  # an application's verb: its fault must not look like a gateway that died
            return _refusal(name, "error", f"{type(error).__name__}: {error}")

    def _call(self, verb: str, args: dict[str, Any]) -> Any:
        own = self.verbs.get(verb)
        return own(args) if own is not None else self.robot.call(verb, **args)

    # ---- the gateway's own verbs
    def _describe(self, _: dict[str, Any]) -> Any:
        if not self.robot.attached:
            raise NotRunning(f"robot '{self.robot.name}' has ended, or was started anew")
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
            "sensors": self.robot.spine.sensor_names,
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
            if name == "sensor":  # JSON knows no NaN: what is not valid is null
                valid = column[..., : len(self.robot.spine.sensor_names)].astype(object)
                valid[np.isnan(column[..., : valid.shape[-1]])] = None
                out[name] = valid.tolist()
            elif column.ndim > records.ndim and name != "probe":
                out[name] = column[..., :joints].tolist()
            else:
                out[name] = column.tolist()
        return out

    def _latest(self, args: dict[str, Any]) -> Any:
        record = self.robot.telemetry.latest()
        if record is None:
            raise Refused("not_ready", "no tick yet", "ask again")
        return self._records(record, args.get("fields") or list(record.dtype.names or ()))

    def _history(self, args: dict[str, Any]) -> Any:
        """All records after tick `since_tick`, else those of the last `seconds`; of these every `every`-th one."""
        lost = 0
        if "since_tick" in args:
            records, lost = self.robot.telemetry.since(int(args["since_tick"]))
        else:
            records = self.robot.telemetry.history(float(args.get("seconds", 1.0)))
        thinned = records[:: max(1, int(args.get("every", 1)))]
        return {
            **self._records(thinned, args.get("fields") or ["tick", "release_ns", "position_rad"]),
            "lost": lost,
        }

    def _publish(self, args: dict[str, Any]) -> Any:
        velocity = args.get("velocity_rad_s")
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
    # A shell starts background jobs with SIGINT ignored; whoever sends it to a gateway means it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
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
            time.sleep(0.2)
            if not robot.attached:
                with contextlib.suppress(LitheError):  # not yet
                    robot.reconnect()
    gateway.close()
    robot.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
