# SPDX-License-Identifier: Apache-2.0
"""An emulated machine that runs one script of the tests."""

from pathlib import Path

import pytest
from system.robot_rig import BIN
from vm import machine, vcan


def booted(script: Path, files: dict[str, bytes], wrong: dict[str, int], options: str = "") -> dict[str, machine.Step]:
    """What the script did on a machine of four cores with LITHE's programs and these files, by step.

    `wrong`: exit codes of the steps that must fail. Skips, with the reason, where no machine can be booted.
    """
    reason = vcan.why_not(program=BIN / "bench_cores")
    kernel = vcan.find_kernel()
    if reason or kernel is None:
        pytest.skip(reason)
    programs = tuple(BIN / name for name in ("bench_cores", *machine.LITHE))
    said = machine.boot(kernel, machine.Cargo(script, programs, files, cores=4, options=options), vcan.CACHE)
    assert machine.wrong_steps(said, script, wrong) == [], said
    return machine.steps(said)
