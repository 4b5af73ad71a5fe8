# SPDX-License-Identifier: Apache-2.0
"""Opens a running robot to agents over TCP."""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import time
from pathlib import Path

from ..control import run_dir
from ..errors import LitheError
from ..robot import connect
from . import Gateway
from .token import new_token, write_token

SWITCH_S = 0.001  # how long Python may let another thread wait


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lithe.gateway", description=__doc__)
    parser.add_argument("--robot", help="name; the only one running if left out")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    parser.add_argument("--port", type=int, default=7423)
    parser.add_argument("--token-file", type=Path, default=run_dir() / "gateway.token")
    args = parser.parse_args()
    # A shell starts background jobs with SIGINT ignored; here SIGINT must end the gateway.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.setswitchinterval(SWITCH_S)
    try:
        robot = connect(args.robot)
        gateway = Gateway(robot, host=args.host, port=args.port, token=new_token())
        write_token(
            args.token_file, gateway.token
        )  # not before it listens: another gateway's clients may need the old one
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
