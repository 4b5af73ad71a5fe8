# SPDX-License-Identifier: Apache-2.0
"""Robots for tests: patient enough for a machine that is busy with other tests."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import lithe
from system.house import ROOT, House

ARM = {
    'release = "spin"': 'release = "sleep"',
    "late_ticks_to_stop = 20 ": "late_ticks_to_stop = 10000 ",
    "watchdog_s = 0.2 ": "watchdog_s = 10.0 ",
    "stale_after_s = 0.25 ": "stale_after_s = 2.0 ",
    'law = "../laws/pd.cpp"': f'law = "{ROOT}/laws/pd.cpp"',
}


# Of the robots that do not say what they leave as it is. They take the name by which a House finds its robot.
OTHERS = {
    "watchdog_s = 0.2 ": "watchdog_s = 10.0 ",
    'law = "../laws/pd.cpp"': f'law = "{ROOT}/laws/pd.cpp"\n\n[spine]\nlate_ticks_to_stop = 10000\n\n'
    "[brain]\nstale_after_s = 2.0\n",
}


def changed(text: str, changes: dict[str, str], what: str) -> str:
    """A robot file's text with all of these changes; each finds something to change."""
    for old, new in changes.items():
        assert old in text, f"{what} no longer says: {old}"
        text = text.replace(old, new)
    return text


def calm_text(changes: dict[str, str] | None = None, robot: str = "arm") -> str:
    """A robot file with what a busy machine would trip over made patient, and with a test's own changes."""
    text = (ROOT / f"robots/{robot}.toml").read_text(encoding="utf-8")
    patience = ARM if robot == "arm" else {**OTHERS, f'name = "{robot}"': 'name = "arm"'}
    return changed(text, {**patience, **(changes or {})}, f"robots/{robot}.toml")


def falls_short(summary: dict[str, Any]) -> list[str]:
    """What a demo on this patient robot fell short of.

    A machine that takes away more than one tick in a hundred, hundreds of milliseconds at a time, leaves the arm to
    itself for so long that nobody tracks anything; then only tracking is excused.
    """
    spoilt = summary["lost_ticks"] > 0.01 * summary["ticks"]
    sentences: list[str] = summary["falls_short"]
    return [sentence for sentence in sentences if not (spoilt and sentence.startswith("RMSE"))]


@contextmanager
def calm_robot(*words: str, changes: dict[str, str] | None = None) -> Iterator[House]:
    """The running, armed robot; this process sees it as `lithe.connect()` would. `words` are for `lithe run`."""
    house = House()
    house.config = house.dir / "arm.toml"
    house.config.write_text(calm_text(changes), encoding="utf-8")
    before = dict(os.environ)
    os.environ.update({key: value for key, value in house.env.items() if key.startswith("LITHE_")})
    try:
        house.run(*words)
        house.wait_for(lambda: house.ask("status")["mode"] == "active")
        yield house
    finally:
        house.close()
        os.environ.clear()
        os.environ.update(before)


@contextmanager
def connected() -> Iterator[lithe.Robot]:
    """`lithe.connect()` for a test: it gets its cores back, and numpy was there before lithe."""
    cores = os.sched_getaffinity(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        robot = lithe.connect()
    try:
        yield robot
    finally:
        robot.close()
        os.sched_setaffinity(0, cores)
