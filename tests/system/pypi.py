# SPDX-License-Identifier: Apache-2.0
"""Other people's packages for a test; without a network it is skipped, and says so."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pypi
import pytest

ROOT = Path(__file__).resolve().parents[2]
Had = TypeVar("Had")


def had(install: Callable[[str], Had], requirement: str) -> Had:
    """What `install` returns."""
    try:
        return install(requirement)
    except pypi.Unavailable as why:
        pytest.skip(str(why))


class Package:
    """One version of one package, as pip installs it, and Python processes that see it."""

    def __init__(self, requirement: str) -> None:
        """Installs it unless it is there."""
        self.folder = had(pypi.install, requirement)

    def command(self, *words: str | Path) -> list[str | Path]:
        """A Python command; run it with `env`."""
        return [sys.executable, *words]

    @property
    def env(self) -> dict[str, str]:
        """Where that Python finds the package before all others."""
        return os.environ | {"PYTHONPATH": str(self.folder)}
