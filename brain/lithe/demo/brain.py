# SPDX-License-Identifier: Apache-2.0
"""The demo's Brain process: streams a reference to the Spine and opens the gateway to the agent."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import lithe
from lithe.gateway import Gateway, write_token


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lithe.demo.brain")
    parser.add_argument("--token-file", type=Path, required=True)
    parser.add_argument(
        "--reference", default='{"kind": "rest"}', help="JSON, as the gateway's verb `set_reference` takes it"
    )
    args = parser.parse_args()
    robot = lithe.connect()
    gateway = Gateway(robot, token=write_token(args.token_file))
    gateway.references.set({**json.loads(args.reference), "stay": True})
    gateway.start()
    print(json.dumps({"port": gateway.port}), flush=True)
    while True:
        time.sleep(3600)


if __name__ == "__main__":
    raise SystemExit(main())
