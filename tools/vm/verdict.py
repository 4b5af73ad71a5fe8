# SPDX-License-Identifier: Apache-2.0
"""What a board has shown: four lines for people, all of it for programs."""

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from vm.machine import Step


class Skipped(Exception):
    """This machine cannot boot such a board: the reason, and the line to type."""


@dataclass
class Verdict:
    """Of one board."""

    board: str
    kernel: str = ""
    lines: list[str] = field(default_factory=list)  # three
    wrong: list[str] = field(default_factory=list)  # what is not as it must be, a sentence each
    facts: dict[str, Any] = field(default_factory=dict)
    skipped: str = ""  # why it was not booted
    wall_s: float = 0.0

    @property
    def word(self) -> str:
        """In one word."""
        return "failed" if self.wrong else "skipped" if self.skipped else "passed"

    def expect(self, is_so: bool, sentence: str) -> None:
        """Keep the sentence that says what is wrong, if it is."""
        if not is_so:
            self.wrong.append(sentence)

    def expect_steps(self, names: Iterable[str], where: str, said: str) -> None:
        """Keep which steps in the machine did not end as they must, and the end of what it said."""
        if missing := list(names):
            self.wrong.append(
                f"{where}: steps that failed or never ended: {', '.join(missing)}; it said:\n{said[-6000:]}"
            )

    def told(self) -> dict[str, Any]:
        """For the report."""
        reason = {"reason": self.skipped} if self.skipped else {}
        return {
            "verdict": self.word, **reason, "kernel": self.kernel, "wall_s": round(self.wall_s, 1),
            "lines": self.lines, "wrong": self.wrong, **self.facts,
        }  # fmt: skip

    def text(self) -> str:
        """Four lines; more if something is wrong."""
        head = f"board {self.board}: {self.word} in {self.wall_s:.0f} s"
        if self.skipped:
            return f"{head}: {self.skipped}"
        rest = [f"  {line}" for line in self.lines] + [f"  wrong: {each}" for each in self.wrong]
        return "\n".join([f"{head}: {self.kernel}", *rest])


def document(steps: dict[str, Step], name: str) -> dict[str, Any]:
    """The JSON document that a step has printed; empty if there is none."""
    text = steps[name].text if name in steps else ""
    start = text.find("{")
    try:
        told = json.JSONDecoder().raw_decode(text[start:])[0] if start >= 0 else {}
    except ValueError:
        return {}
    return told if isinstance(told, dict) else {}
