# SPDX-License-Identifier: Apache-2.0
"""Improves the law of a running robot with a language model: `python -m lithe.agent --url URL --model NAME`.

Exit codes: 0 the best law is better than the one at the start, 4 it is not, 3 the robot stopped, was lost, or does not
run the best law, 1 error.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from ..control import run_dir
from ..errors import LitheError
from ..files import read_regular
from ..programs import ROOT
from ..remote import Remote
from . import report
from .link import Link
from .options import model_of, model_options, motion_of, motion_options, new_transcript, seconds
from .reference import Streamer, reference_of
from .rounds import Limits, Result, Rounds
from .transcript import Transcript

NEITHER, LOST = 4, 3
SHOWN = (
    "generation", "verdict", "proposed", "refused", "stopped", "way_back", "demoted", "model_error",
    "disconnected", "grown", "end", "trouble",
)  # fmt: skip


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m lithe.agent", description=__doc__)
    model_options(parser)
    motion_options(parser)
    parser.add_argument("--connect", default="127.0.0.1:7423", metavar="HOST:PORT", help="the robot's gateway")
    parser.add_argument("--token-file", type=Path, default=run_dir() / "gateway.token")
    parser.add_argument(
        "--reconnect", type=seconds, default=30.0, metavar="S", help="how long a broken connection is tried again"
    )
    parser.add_argument(
        "--law", type=Path, help="the source of the law that runs now (default: as the robot recorded it)"
    )
    parser.add_argument("--out", type=Path, default=Path(os.environ.get("LITHE_OUT_DIR", ROOT / "out")) / "agent")
    return parser


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise LitheError(f"'{text}' is no HOST:PORT\n  next: for example --connect 127.0.0.1:7423")
    return host.strip("[]"), int(port)


def run(args: argparse.Namespace, transcript: Transcript) -> Result:
    """One run against a gateway; its report is written."""

    def say(kind: str, /, **what: Any) -> None:
        transcript.add(kind, **what)
        if kind in SHOWN:
            words = {key: value for key, value in what.items() if key not in ("detail", "diagnostics")}
            print(f"{kind}: {repr(words)[:300]}", flush=True)

    source = ""
    if args.law is not None:
        try:
            source = read_regular(args.law)
        except (OSError, ValueError) as error:
            raise LitheError(f"cannot read the law {args.law} ({error})\n  next: --law FILE.cpp") from None
    model = model_of(args, say)
    limits = Limits(args.rounds, args.swaps, args.failures, args.window, args.amplitude, args.growth, args.score)
    with Remote(*_address(args.connect), args.token_file) as remote:
        link = Link(remote, say, args.reconnect)
        reference = reference_of(link.joints, args.goal, motion_of(args))
        print(f"reference: {reference.words}", flush=True)
        link.take()
        say("begin", goal=args.goal, model=args.model, url=args.url, joints=link.joints, limits=vars(limits),
            reference=reference.terms)  # fmt: skip
        rounds = Rounds(link, Streamer(link, reference), model, args.goal, limits, say, transcript.keep, source)
        result = rounds.run()
    path = report.write(result, transcript.folder, args.goal, args.model, link.names)
    print(f"report: {path}", flush=True)
    return result


def main() -> int:
    args = _parser().parse_args()
    try:
        transcript = new_transcript(args.out)
        try:
            result = run(args, transcript)
        finally:
            transcript.close()
    except (LitheError, OSError) as error:
        print(f"lithe agent: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    if result.stopped or not result.tries:
        print(f"lithe agent: {result.why}", file=sys.stderr)
        return LOST
    return 0 if result.best else NEITHER


if __name__ == "__main__":
    raise SystemExit(main())
