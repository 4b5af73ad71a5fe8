# SPDX-License-Identifier: Apache-2.0
"""Options of the command line that `lithe.agent` and the demo's agent share, and what is made of them."""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable
from pathlib import Path

from ..errors import LitheError
from ..files import read_regular
from .model import Model
from .prompt import MOST_GOAL_CHARS
from .reference import CHIRP_S, KINDS, MOST_GROWTH, MOST_WINDOW_S, Asked
from .score import SCORES
from .transcript import Transcript


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is no whole number from 1 on")
    return int(text)


def _number(text: str, wrong: Callable[[float], str]) -> float:
    """`wrong(value)`: why it is no good, "" when it is. NaN stands for what is no number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if why := wrong(value):
        raise argparse.ArgumentTypeError(why)
    return value


def seconds(text: str) -> float:
    return _number(text, lambda value: "" if 0 < value <= 3600 else f"'{text}' is no time from 0 to 3600 s")


def share(text: str) -> float:
    return _number(text, lambda value: "" if 0 < value <= 1 else f"{value} is not between 0 and 1")


def growth(text: str) -> float:
    wrong = f"'{text}' is no number from 1 (no growth) to {MOST_GROWTH:g}"
    return _number(text, lambda value: "" if 1 <= value <= MOST_GROWTH else wrong)


def _window(text: str) -> float:
    if (value := seconds(text)) > MOST_WINDOW_S:
        raise argparse.ArgumentTypeError(f"'{text}' is more than {MOST_WINDOW_S:g} s")
    return value


def _numbers(text: str) -> list[float]:
    try:
        values = [float(one) for one in text.split(",")]
    except ValueError:
        values = []
    if not values or not all(map(math.isfinite, values)):
        raise argparse.ArgumentTypeError(f"'{text}' is no number, and no numbers with commas between them")
    return values


def _goal(text: str) -> str:
    if not 0 < len(text) <= MOST_GOAL_CHARS:
        raise argparse.ArgumentTypeError(f"it has {len(text)} characters; 1 to {MOST_GOAL_CHARS} reach the model")
    return text


def motion_options(parser: argparse.ArgumentParser) -> None:
    """What is wanted, the motion on which it is measured, and by what."""
    parser.add_argument("--goal", type=_goal, default="track 0.5 Hz with the least error", help="for the model, whole")
    parser.add_argument(
        "--reference", default="sine", metavar="KIND",
        help=f"the motion that is measured: {', '.join(KINDS)}, or a JSON file with the arguments of set_reference "
             "(steps, waypoints ...)",
    )  # fmt: skip
    parser.add_argument(
        "--frequency-hz", type=_numbers, metavar="F[,F...]",
        help="a sine's (default: the goal's number before Hz, else 0.5), a multisine's, a chirp's first and last",
    )  # fmt: skip
    for name in ("amplitude", "centre"):
        parser.add_argument(f"--{name}-rad", type=_numbers, metavar="A[,A...]", help="of all joints, or of each")
    parser.add_argument("--duration-s", type=seconds, default=CHIRP_S, metavar="S", help="of a chirp")
    parser.add_argument("--window", type=_window, default=4.0, metavar="S", help="of one measurement, at least")
    parser.add_argument("--amplitude", type=share, default=0.5, help="share of the largest motion to begin with")
    parser.add_argument("--growth", type=growth, default=1.5, help="of the amplitude after a better law, at most 2")
    parser.add_argument(
        "--score", choices=tuple(SCORES), default="rms",
        help="what is to be least: rms or largest error, or torque with errors no larger than at the start",
    )  # fmt: skip


def motion_of(args: argparse.Namespace) -> Asked:
    """What the command line says of the motion."""
    return Asked(args.reference, args.frequency_hz, args.amplitude_rad, args.centre_rad, args.duration_s)


def model_options(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """The options of a model's server; also of the demo."""
    parser.add_argument(
        "--url", required=required, help="http://127.0.0.1:11434 (Ollama), http://HOST:PORT/v1 (OpenAI)"
    )
    parser.add_argument("--model", required=required, help="its name, for example qwen2.5-coder:7b")
    parser.add_argument("--api", choices=("auto", "openai", "ollama"), default="auto")
    parser.add_argument("--key-file", type=Path, help="holds the key of the model's server; it is never recorded")
    parser.add_argument("--model-timeout", type=seconds, default=180.0, metavar="S", help="of one answer")
    parser.add_argument("--context-tokens", type=_count, default=16384, help="num_ctx of Ollama")
    parser.add_argument("--answer-tokens", type=_count, default=4096)
    parser.add_argument("--rounds", type=_count, default=10, help="questions to the model")
    parser.add_argument("--swaps", type=_count, default=25, help="budget of swaps")
    parser.add_argument(
        "--failures", type=_count, default=5, help="generations in a row that are no better: then it ends"
    )


def model_of(args: argparse.Namespace, say: Callable[..., None]) -> Model:
    """LitheError: the key cannot be read, or the URL is none."""
    key = ""
    if args.key_file is not None:
        try:
            key = read_regular(args.key_file).strip()
        except (OSError, ValueError) as error:
            raise LitheError(f"cannot read the key ({error})\n  next: --key-file FILE with the key alone") from None
        if not key.isascii() or not key.isprintable():
            raise LitheError(f"{args.key_file} holds no key\n  next: one line of ASCII")
    return Model(
        args.url, args.model, api=args.api, key=key, timeout_s=args.model_timeout, context_tokens=args.context_tokens,
        answer_tokens=args.answer_tokens, say=say,
    )  # fmt: skip


def new_transcript(out: Path) -> Transcript:
    """In a folder of its own below `out`, named by the time."""
    os.umask(os.umask(0o027) | 0o027)
    name = time.strftime("%Y%m%d-%H%M%S")
    for number in range(1, 100):
        try:
            return Transcript(out / (name if number == 1 else f"{name}-{number}"))
        except FileExistsError:
            continue
        except OSError as error:
            raise LitheError(f"cannot write to {out}: {error.strerror}\n  next: --out DIR") from None
    raise LitheError(f"{out} is full of runs of this second\n  next: --out DIR")
