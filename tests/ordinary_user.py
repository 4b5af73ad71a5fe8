# SPDX-License-Identifier: Apache-2.0
"""A program as an ordinary user starts it: without any privilege, and with a home of its own."""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from system.house import BIN, ROOT

NOBODY = 65534


def nobody(capability: str = "") -> tuple[str, ...]:
    """What to put before a command that root wants done by an ordinary user, who keeps one capability at most."""
    capabilities = f"-all,+{capability}" if capability else "-all"
    return (
        "setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", "--no-new-privs",
        *(f"--{which}={capabilities}" for which in ("inh-caps", "ambient-caps", "bounding-set")),
    )  # fmt: skip


@pytest.fixture
def home() -> Iterator[Path]:
    """A folder of the user's own: pytest's directories are closed to others."""
    folder = Path(tempfile.mkdtemp(prefix="lithe-"))
    folder.chmod(0o755)
    if os.geteuid() == 0:
        os.chown(folder, NOBODY, NOBODY)
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


def as_ordinary_user() -> tuple[str, ...]:
    """What to put before a command; nothing when we are one already.

    Where the tree or Python lies in a place that only root may enter, the user gets the right to read, which neither
    clocks nor schedulers nor memory locks ask for.
    """
    if os.geteuid() != 0:
        return ()
    needed = (os.path.realpath(sys.executable), BIN / "lithe", ROOT / "brain/lithe/__init__.py")
    for way in (nobody(), nobody("dac_read_search")):
        if subprocess.run([*way, "head", "-qc1", *needed], check=False, capture_output=True).returncode == 0:
            return way
    pytest.skip(f"root here may not become an ordinary user who reads {', '.join(map(str, needed))}")
