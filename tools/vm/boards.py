# SPDX-License-Identifier: Apache-2.0
"""Boots emulated boards and shows that LITHE works there: `make boards` (docs/host.md).

    python tools/vm/boards.py              all of them; --board x|r|a: one of them, and can be repeated
    python tools/vm/boards.py --board a --only robot,swaps    of r and a, some of the steps

x: Debian's kernel for PCs with the boot line of `lithe tune`; r: Debian's PREEMPT_RT kernel; a: Debian for 64-bit ARM
on four emulated Cortex-A72. What works is shown, never how fast. Exit code: 0 passed, 1 failed, 77 skipped.
"""

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from vm import board_systems, board_x
from vm.machine import BIN, ROOT, SKIPPED
from vm.verdict import Skipped, Verdict

CACHE = ROOT / "build/boards"
REPORT = Path(os.environ.get("LITHE_OUT_DIR") or ROOT / "out") / "boards.json"
BOARDS: dict[str, Callable[[Verdict, Path, str], None]] = {
    "x": board_x.run,
    "r": board_systems.run_r,
    "a": board_systems.run_a,
}


def why_not() -> str:
    """Why no board can be booted on this machine; empty when one may be."""
    if platform.machine() != "x86_64":
        return f"the boards are emulated on an x86-64, this is a {platform.machine()}"
    return ""


def one(name: str, cache: Path, only: str) -> Verdict:
    """Boot one board; whatever happens, there is a verdict."""
    verdict = Verdict(name)
    started = time.monotonic()
    cache.mkdir(parents=True, exist_ok=True)
    try:
        if reason := why_not():
            raise Skipped(reason)
        BOARDS[name](verdict, cache, only)
    except Skipped as skipped:
        verdict.skipped = str(skipped)
    except Exception as error:  # the other boards are shown all the same
        verdict.wrong.append(f"{type(error).__name__}: {error}")
    verdict.wall_s = time.monotonic() - started
    return verdict


def exit_code(verdicts: list[Verdict]) -> int:
    """The worst of them; skipped only if nothing ran."""
    if any(verdict.wrong for verdict in verdicts):
        return 1
    return SKIPPED if all(verdict.skipped for verdict in verdicts) else 0


def main() -> int:
    """Boot what is asked for, tell, and write the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", action="append", choices=sorted(BOARDS), help="this one; can be repeated")
    parser.add_argument("--only", default="", metavar="STEP,...", help="of r and a: these steps")
    args = parser.parse_args()
    verdicts = []
    for name in args.board or BOARDS:
        verdicts.append(one(name, CACHE / name, args.only))
        print(verdicts[-1].text(), flush=True)
    told: dict[str, Any] = {verdict.board: verdict.told() for verdict in verdicts}
    REPORT.parent.mkdir(parents=True, exist_ok=True)
    REPORT.write_text(json.dumps({"programs": str(BIN), "boards": told}, indent=2) + "\n")
    return exit_code(verdicts)


if __name__ == "__main__":
    sys.exit(main())
