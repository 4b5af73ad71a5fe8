# SPDX-License-Identifier: Apache-2.0
"""Other people's Python packages, unmodified, each version in a folder of its own: installed once, then kept."""

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
STORE = ROOT / "build" / "pypi" / f"python{sys.version_info[0]}.{sys.version_info[1]}"  # wheels fit one only


class Package:
    """One version of one package, as pip installs it, and Python processes that see it."""

    def __init__(self, requirement: str) -> None:
        """Installs it unless it is there; without a network the test is skipped, and says so."""
        self.folder = STORE / requirement.replace("==", "-")
        STORE.mkdir(parents=True, exist_ok=True)
        with (STORE / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            done = self.folder / "installed"
            if done.exists():
                return
            pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input"]
            try:
                ran = subprocess.run(
                    [*pip, "--upgrade", "--target", self.folder, requirement],
                    check=False,
                    capture_output=True,
                    text=True,
                    timeout=600,
                )
            except subprocess.TimeoutExpired:
                pytest.skip(f"pip cannot install {requirement}: no answer within 10 minutes")
            if ran.returncode != 0:
                pytest.skip(f"pip cannot install {requirement}: {(ran.stderr.strip().splitlines() or ['?'])[-1]}")
            done.touch()

    def command(self, *words: str | Path) -> list[str | Path]:
        """A Python command; run it with `env`."""
        return [sys.executable, *words]

    @property
    def env(self) -> dict[str, str]:
        """Where that Python finds the package before all others."""
        return os.environ | {"PYTHONPATH": str(self.folder)}
