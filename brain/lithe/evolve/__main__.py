# SPDX-License-Identifier: Apache-2.0
"""`python -m lithe.evolve ROBOT.toml LAW.cpp ... [--budget N] [--seed N] [--processes N | --dask [ADDRESS]] [--live]`

Searches the parameters of these laws on the simulated robot of the file; with --recorded DATA.npy on one that moves as
was recorded. OUT/journal.jsonl has every candidate,
OUT/result.json the best of each law. Exit 0: a winner was found; 1: every candidate was refused, or --live rolled it
back or did not confirm it; 2: it cannot run; 130: it was interrupted.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TextIO

from ..certificates import with_verdict
from ..errors import LitheError, Refused
from ..files import read_regular
from ..identify.__main__ import identify
from ..identify.plant import plant_of, with_values
from .evaluate import compile_laws, evaluate
from .search import Found, Journal, Map, Plan, Search

BAR = 24  # characters
ORDER = "one robot file, then laws: lithe evolve ROBOT.toml LAW.cpp ..."


@contextmanager
def evaluating(asked: argparse.Namespace) -> Iterator[Map]:
    """Evaluates in this process, in `processes` of this machine, or on a Dask cluster: that of the address in `dask`,
    or without one a cluster of so many processes here.
    """
    with ExitStack() as ends:
        if asked.dask is not None:
            try:
                from distributed import Client, LocalCluster
            except ImportError:
                raise LitheError("Dask is missing\n  next: pip install distributed, or leave --dask out") from None
            here = {"n_workers": asked.processes, "threads_per_worker": 1, "dashboard_address": None}
            client = ends.enter_context(Client(asked.dask or ends.enter_context(LocalCluster(**here))))
            yield lambda candidates: list(client.gather(client.map(evaluate, candidates, pure=False)))
        elif asked.processes > 1:
            pool = ends.enter_context(ProcessPoolExecutor(asked.processes, mp_context=get_context("spawn")))
            yield lambda candidates: list(pool.map(evaluate, candidates))
        else:
            yield lambda candidates: list(map(evaluate, candidates))


class Progress:
    """How far a search is: on a terminal one line that is written again and again, elsewhere a line for each batch."""

    def __init__(self, budget: int, stream: TextIO) -> None:
        """Nothing is written yet."""
        self._budget, self._stream, self._open = budget, stream, False

    def __call__(self, done: int, words: str) -> None:
        """So many candidates are done."""
        said = f"{done} of {self._budget}: {words}"
        if not self._stream.isatty():
            print(said, file=self._stream, flush=True)
            return
        filled = BAR * done // self._budget
        line = f"[{'#' * filled}{'.' * (BAR - filled)}] {said}"[
            : os.get_terminal_size(self._stream.fileno()).columns - 1
        ]
        print(f"\r\033[K{line}", end="", file=self._stream, flush=True)
        self._open = True

    def close(self) -> None:
        """The next words begin on a line of their own."""
        if self._open:
            print(file=self._stream, flush=True)
        self._open = False


def arguments(words: Sequence[str]) -> argparse.Namespace:
    """What is asked for."""
    parser = argparse.ArgumentParser(prog="python -m lithe.evolve", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("robot", type=Path, help="a robot file; its buses are not used")
    parser.add_argument("laws", type=Path, nargs="+", help="laws, C++")
    parser.add_argument("--budget", type=int, default=64, help="candidates in all (default 64)")
    parser.add_argument("--seed", type=int, default=1, help="the same seed finds the same winner (default 1)")
    parser.add_argument("--processes", type=int, default=1, help="evaluate in so many processes (default 1)")
    parser.add_argument("--dask", nargs="?", const="", metavar="ADDRESS",
                        help="on a Dask cluster; without an address on one here, of --processes processes")  # fmt: skip
    parser.add_argument(
        "--torque-weight", type=float, default=0.0, help="rad of error that a N m of torque is worth (default 0)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/evolve"), help="folder of the results (default out/evolve)"
    )
    parser.add_argument(
        "--recorded", type=Path, nargs="+", default=[], metavar="DATA.npy",
        help="on the robot as lithe.identify finds it in this telemetry; OUT/recorded.toml has it",
    )  # fmt: skip
    parser.add_argument(
        "--resume", action="store_true", help="go on where a search with the same words was interrupted"
    )
    parser.add_argument(
        "--live", action="store_true", help="swap the winner into the running robot and tell what was measured"
    )
    asked = parser.parse_args(words)
    if asked.budget < 1 or asked.processes < 1 or asked.seed < 1 or not 0 <= asked.torque_weight < 1e6:
        parser.error("--budget, --processes and --seed are at least 1, --torque-weight is not negative")
    return asked


def joints_of(robot: Path) -> int:
    """How many the robot file has. LitheError where it is none."""
    try:
        if joints := len(tomllib.loads(read_regular(robot))["joint"]):
            return joints
        raise ValueError("it has no joint")
    except OSError as error:
        raise LitheError(f"cannot read {robot}: {error.strerror}\n  next: give a robot file, as in robots/") from None
    except (ValueError, KeyError, TypeError):
        raise LitheError(
            f"{robot} is no robot file\n  next: {ORDER}; `lithe bus plan {robot}` names its mistakes"
        ) from None


def laws_in(files: list[Path]) -> list[tuple[str, str]]:
    """Their names and texts. LitheError: one is no law's file."""
    sources = []
    for file in files:
        if file.suffix not in (".cpp", ".cc"):
            raise LitheError(f"{file} is not taken for a law: its name does not end in .cpp\n  next: {ORDER}")
        try:
            sources.append((file.name, read_regular(file)))
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else "is no text"
            raise LitheError(f"cannot read the law {file}: {why}\n  next: give C++ files, as in laws/") from None
    return sources


def make_folder(folder: Path) -> None:
    """Of the results. LitheError: it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LitheError(f"cannot write to {folder}: {error.strerror}\n  next: another --out FOLDER") from None


def as_recorded(robot: Path, data: list[Path], out: Path) -> Path:
    """A new robot file in OUT with the plant that this telemetry tells. LitheError also where it tells too little."""
    text, file = read_regular(robot), out / "recorded.toml"
    try:
        values, said, _ = identify(robot, plant_of(text), data, None)
    except ValueError as error:
        raise LitheError(f"{error}\n  next: record a motion that tells more (lithe.identify)") from None
    make_folder(out)
    file.write_text(with_values(text, values), encoding="utf-8")
    print(said, flush=True)
    return file


def swap_in(found: Found, source: str) -> bool:
    """The winner through the whole swap of the running robot, and its usual probation. Whether it runs on."""
    import lithe

    with lithe.connect(writes_plans=False) as robot:  # a Brain may move it meanwhile
        try:
            certificate = with_verdict(robot, robot.swap(source, name=found.law, params=found.params))
        except Refused as refusal:
            print(f"live: refused ({refusal.code}): {refusal.message}")
            return False
    verdict = str(certificate["verdict"])
    print(f"live: {verdict}; predicted {found.score.error_rad:.5f} rad")
    for joint in (certificate.get("control") or {}).get("joints", []):
        old, new = ((joint[side] or {}).get("rms_error_rad") for side in ("before", "after"))
        print(f"live: joint {joint['joint']}: {new} rad, under the law before {old} rad")
    if why := certificate.get("rolled_back"):
        print(f"live: rolled back: {why['why']}")
    return verdict in ("confirmed", "unproven")


def run(asked: argparse.Namespace) -> int:
    """The search as asked."""
    sources = laws_in(asked.laws)
    if len({name for name, _ in sources}) < len(sources):
        raise LitheError("two laws have the same file name\n  next: rename one")
    joints, cache = joints_of(asked.robot), (asked.out / "cache").resolve()
    robot = as_recorded(asked.robot, asked.recorded, asked.out) if asked.recorded else asked.robot
    make_folder(cache)
    units = compile_laws(sources, joints, str(cache))
    plan = Plan(str(robot.resolve()), str(cache), asked.seed, asked.budget, asked.torque_weight)
    journal = Journal(asked.out / "journal.jsonl", plan.fingerprint(units), asked.resume)
    progress = Progress(asked.budget, sys.stdout)
    search = Search(plan, units, journal, progress)
    try:
        with evaluating(asked) as scores_of:
            winner = search.run(scores_of)
    finally:
        journal.close()
        progress.close()
    result: dict[str, Any] = {
        "winner": asdict(winner) if winner else None,
        "best": [asdict(found) for found in search.best.values()],
        "refused": search.refused,
        "candidates": search.done,
    }
    (asked.out / "result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    for why, count in sorted(search.refused.items(), key=lambda each: -each[1])[:5]:
        print(f"refused {count} times: {why.splitlines()[0]}")
    if winner is None:
        print("every candidate was refused")
        return 1
    params = " ".join(f"--param {name}={value:.6g}" for name, value in winner.params.items())
    file = next(path for path in asked.laws if path.name == winner.law)
    print(f"winner: {winner.score.value:.5f} rad: lithe swap {shlex.quote(str(file))} {params}".rstrip())
    return 0 if not asked.live or swap_in(winner, dict(sources)[winner.law]) else 1


def main(words: Sequence[str]) -> int:
    """Entry point."""
    asked = arguments(words)
    try:
        return run(asked)
    except LitheError as error:
        print(f"lithe.evolve: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("lithe.evolve: interrupted\n  next: the same words and --resume go on", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
