# SPDX-License-Identifier: Apache-2.0
"""Programs that measure on request."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any, Self

from lithe.demo.processes import DIE_WITH_US
from lithe.programs import ROOT

from bench import report
from bench.tables import Figures


class Asked:
    """A program that prints a line of JSON when it is ready, `told`, and then one for each line it is given."""

    def __init__(self, name: str, words: list[str], env: dict[str, str] | None = None, session: bool = False) -> None:
        """Starts it. `session`: in one of its own, so that its nice value counts against other programs."""
        self.name = name
        self.process = subprocess.Popen(
            [*DIE_WITH_US, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env, cwd=ROOT,
            start_new_session=session,
        )  # fmt: skip
        self.told = self._answer()

    def _answer(self) -> Any:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            self.close()
            raise report.Unmeasured(f"{self.name} ended with {self.process.returncode}")
        return json.loads(line)

    def ask(self, request: str = "") -> Any:
        """The answer to one line."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{request}\n")
        self.process.stdin.flush()
        return self._answer()

    def close(self) -> None:
        """Ends it: its standard input ends."""
        try:
            self.process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def bench_of_its_own(name: str, words: list[str], usage: str, figures: Callable[[bool], Figures]) -> int:
    """`python -m bench.NAME [--short]` measures and shows; with `--figures`, for bench.report, it prints one line."""
    if set(words) - {"--short", "--figures"}:
        print(usage, file=sys.stderr)
        return 2
    short = "--short" in words or bool(os.environ.get("LITHE_BENCH_SHORT"))
    if "--figures" not in words:
        if short:
            os.environ["LITHE_BENCH_SHORT"] = "1"
        return report.main([name])
    try:
        print(json.dumps({f"{name}_short": short} | figures(short)))
    except report.Unmeasured as why:
        print(f"bench: {why}", file=sys.stderr)
        return 1
    return 0
