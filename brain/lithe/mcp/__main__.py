# SPDX-License-Identifier: Apache-2.0
"""Serves MCP on stdin and stdout, or gives and takes back the permission to change the robot."""

from __future__ import annotations

import argparse
import functools
import sys
import threading
import time
from pathlib import Path

from .. import mcp
from ..control import run_dir
from ..errors import LitheError
from ..remote import Remote
from ..vocabulary import Tier
from . import http, permission
from .protocol import MOST_LINE_BYTES, Json, encoded
from .server import Server

_writing = threading.Lock()


def send(answer: Json) -> None:
    """One line on stdout; the client may have left."""
    with _writing:
        sys.stdout.buffer.write(encoded(answer).encode() + b"\n")
        sys.stdout.buffer.flush()


def serve(args: argparse.Namespace) -> int:
    """Until stdin ends; over HTTP, until Ctrl-C."""
    robot = functools.cache(lambda: Remote(args.host, args.port, args.token_file))  # at the first call
    server = Server(lambda verb, words: robot().call(verb, **words), permission.path_of(args.port))
    if args.http is not None:
        return http.serve(server, args.http)
    try:
        while line := sys.stdin.buffer.readline(MOST_LINE_BYTES + 1):
            server.line(line.strip(), send) if line.strip() else None
            while not line.endswith(b"\n") and line:  # the rest of a line that was too long
                line = sys.stdin.buffer.readline(MOST_LINE_BYTES)
        server.finish()
    except (BrokenPipeError, KeyboardInterrupt):
        pass
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m lithe.mcp", description=mcp.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--host", default="127.0.0.1", help="the gateway's address")
    parser.add_argument("--port", type=int, default=7423, help="the gateway's port")
    parser.add_argument("--token-file", type=Path, default=run_dir() / "gateway.token", help="the gateway wrote it")
    parser.add_argument(
        "--http", type=int, metavar="PORT", help="serve over HTTP on this port of 127.0.0.1; 0: any free one"
    )
    jobs = parser.add_subparsers(dest="job")
    allow = jobs.add_parser("allow", help="permit agents to change the robot, for a time")
    allow.add_argument(
        "--tier",
        choices=[each.name for each in Tier][1:],
        default=Tier.move.name,
        help="with all before it (default: move); person also needs a gateway that was started with --tier person",
    )
    allow.add_argument("--minutes", type=float, default=15.0)
    jobs.add_parser("forbid", help="take the permission back")
    args = parser.parse_args()
    file = permission.path_of(args.port)
    try:
        if args.job is None:
            return serve(args)
        if args.job == "forbid":
            permission.take_back(file)
            print("agents may only observe and stop the robot")
        else:
            until = time.strftime("%H:%M:%S", time.localtime(permission.give(file, args.minutes, Tier[args.tier])))
            print(
                f"agents have tier {args.tier} at port {args.port} until {until}; `python -m lithe.mcp forbid` ends it"
            )
    except (LitheError, OSError) as error:
        print(f"lithe.mcp: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
