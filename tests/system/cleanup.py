# SPDX-License-Identifier: Apache-2.0
"""Clears a RobotRig away when its owner closes it, or dies: cleanup.py PREFIX DIRECTORY, until its input ends.

A Spine outlives its parent on purpose; so nothing less finds all that a killed test run has left.
"""

import contextlib
import os
import shutil
import signal
import sys
import time
from pathlib import Path


def processes_of(prefix: str) -> list[int]:
    """Pids of the processes that were started for the RobotRig, and of theirs."""
    sign = f"LITHE_SHM_PREFIX={prefix}\0".encode()
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # gone meanwhile, or somebody else's
            if sign in (place / "environ").read_bytes() + b"\0":
                found.append(int(place.name))
    return found


def clear(prefix: str, directory: Path) -> None:
    """Ends every process and removes every file; a process may start another until the last has gone."""
    while pids := processes_of(prefix):
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.01)
    for each in Path("/dev/shm").glob(f"{prefix}.*"):
        each.unlink(missing_ok=True)
    shutil.rmtree(directory, ignore_errors=True)


if __name__ == "__main__":
    for signal_number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(signal_number, signal.SIG_IGN)  # those mean the test run; its end is what counts here
    sys.stdin.buffer.read()
    clear(sys.argv[1], Path(sys.argv[2]))
