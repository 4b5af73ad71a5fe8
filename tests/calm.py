# SPDX-License-Identifier: Apache-2.0
"""Robots for tests: patient enough for a machine that is busy with other tests."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import lithe
from inconclusive import inconclusive
from lithe.demo import verdict
from system.robot_rig import ROOT, RobotRig

ARM = {
    'release = "spin"': 'release = "sleep"',
    "late_ticks_to_stop = 20 ": "late_ticks_to_stop = 10000 ",
    "watchdog_s = 0.2 ": "watchdog_s = 10.0 ",
    "stale_after_s = 0.25 ": "stale_after_s = 2.0 ",
    'law = "../laws/pd.cpp"': f'law = "{ROOT}/laws/pd.cpp"',
}


# Of the robots that do not say what they leave as it is. They take the name by which a RobotRig finds its robot.
OTHERS = {
    "watchdog_s = 0.2 ": "watchdog_s = 10.0 ",
    'law = "../laws/pd.cpp"': f'law = "{ROOT}/laws/pd.cpp"\n\n'
    '[spine]\nrelease = "sleep"\nlate_ticks_to_stop = 10000\n\n[brain]\nstale_after_s = 2.0\n',
}
SPINS = {'release = "sleep"': 'release = "spin"'}  # a test's own change, for a robot with nothing beside it


def changed(text: str, changes: dict[str, str], what: str) -> str:
    """A robot file's text with all of these changes; each finds something to change."""
    for old, new in changes.items():
        assert old in text, f"{what} no longer says: {old}"
        text = text.replace(old, new)
    return text


def calm_text(changes: dict[str, str] | None = None, robot: str = "arm", ideal: bool = True) -> str:
    """A robot file with what a busy machine would trip over made patient, and with a test's own changes.

    The arm is exactly its model unless `ideal` is False; other robots are as their files say.
    """
    text = (ROOT / f"robots/{robot}.toml").read_text(encoding="utf-8")
    if robot == "arm" and ideal:
        text = changed(text, {"ideal = false ": "ideal = true "}, "robots/arm.toml")
    patience = ARM if robot == "arm" else {**OTHERS, f'name = "{robot}"': 'name = "arm"'}
    return changed(text, {**patience, **(changes or {})}, f"robots/{robot}.toml")


def falls_short(summary: dict[str, Any]) -> list[str]:
    """What a demo on this patient robot fell short of, timing apart: no test sets a maximum time.

    Where the kernel's counts say that the machine took more than one release in a hundred, tracking proves nothing:
    then a run that fell short is inconclusive and says why.
    """
    assert "stopped" not in summary, summary
    wrong = verdict.experiment(summary)
    if wrong and verdict.disturbed(summary):
        inconclusive("; ".join(summary["inconclusive"]))
    return wrong


@contextmanager
def calm_robot(*words: str, changes: dict[str, str] | None = None, ideal: bool = True) -> Iterator[RobotRig]:
    """The running, armed robot; this process sees it as `lithe.connect()` would. `words` are for `lithe run`."""
    before = dict(os.environ)
    with RobotRig() as rig:
        rig.config = rig.dir / "arm.toml"
        rig.config.write_text(calm_text(changes, ideal=ideal), encoding="utf-8")
        os.environ.update({key: value for key, value in rig.env.items() if key.startswith("LITHE_")})
        try:
            rig.run(*words)
            rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
            yield rig
        finally:
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
