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
from ..files import read_regular
from ..robot import connect
from ..vocabulary import Tier
from . import Gateway
from .token import lower, new_token, write_token

SWITCH_S = 0.001  # how long Python may let another thread wait


def print_lower(token_file: Path, tier: Tier) -> int:
    """On stdout, for a client that may do less."""
    try:
        print(lower(read_regular(token_file).strip(), tier))
    except (OSError, ValueError) as error:
        print(f"lithe.gateway: cannot read {token_file}: {error}\n  next: start a gateway first")
        return 1
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lithe.gateway", description=__doc__)
    parser.add_argument("--robot", help="name; the only one running if left out")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    parser.add_argument("--port", type=int, default=7423)
    parser.add_argument("--token-file", type=Path, default=run_dir() / "gateway.token")
    parser.add_argument(
        "--tier",
        choices=[each.name for each in Tier],
        default=Tier.move.name,
        help="what its token permits, with all before it (default: move)",
    )
    parser.add_argument(
        "--lower",
        choices=[each.name for each in Tier][:-1],
        metavar="TIER",
        help="start nothing: print a token of this tier, made from that in the token file of a running gateway",
    )
    args = parser.parse_args()
    # A shell starts background jobs with SIGINT ignored; here SIGINT must end the gateway.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.setswitchinterval(SWITCH_S)
    if args.lower:
        return print_lower(args.token_file, Tier[args.lower])
    try:
        robot = connect(args.robot)
        gateway = Gateway(robot, host=args.host, port=args.port, token=new_token(), tier=Tier[args.tier])
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
