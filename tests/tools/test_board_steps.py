# SPDX-License-Identifier: Apache-2.0
"""The steps that a board takes: which, and with what."""

import os
import sys
from typing import Any

import pytest
from vm import board_systems, on_board


def test_a_step_that_a_board_has_not_is_refused() -> None:
    assert board_systems.chosen(("swaps", "demo"), "demo") == ("demo",)
    with pytest.raises(ValueError, match="--only swap: no such step; there are swaps, demo"):
        board_systems.chosen(("swaps", "demo"), "swap")


def test_each_step_has_all_cores_also_after_a_brain(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def brain() -> dict[str, Any]:
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        return {}

    monkeypatch.setattr(on_board, "STEPS", {"brain": brain, "next": lambda: {"cores": len(os.sched_getaffinity(0))}})
    monkeypatch.setattr(sys, "argv", ["on_board.py", "brain", "next"])
    cores = os.sched_getaffinity(0)
    on_board.main()
    os.sched_setaffinity(0, cores)
    assert f'"cores": {len(cores)}' in capsys.readouterr().out
