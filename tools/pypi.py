# SPDX-License-Identifier: Apache-2.0
"""Other people's Python packages, unmodified, each version in a folder of its own: installed once, then kept.

`python tools/pypi.py moteus==1.0.0` prints the folder. Exit 1: it cannot be had, and why.
"""

import fcntl
import subprocess
import sys
from pathlib import Path

VERSION = f"python{sys.version_info[0]}.{sys.version_info[1]}"  # wheels fit one only
STORE = Path(__file__).resolve().parents[1] / "build" / "pypi" / VERSION


class Unavailable(Exception):
    """There is no such package, or no network; the text says which."""


def install(requirement: str) -> Path:
    """The folder to put into a Python's path; installs the package there unless it is there."""
    folder = STORE / requirement.replace("==", "-")
    STORE.mkdir(parents=True, exist_ok=True)
    with (STORE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = folder / "installed"
        if done.exists():
            return folder
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input"]
        try:
            ran = subprocess.run(
                [*pip, "--upgrade", "--no-compile", "--target", folder, requirement],
                check=False,
                capture_output=True,
                text=True,
                timeout=600,
            )
        except subprocess.TimeoutExpired as late:
            raise Unavailable(f"pip cannot install {requirement}: no answer within 10 minutes") from late
        if ran.returncode != 0:
            raise Unavailable(f"pip cannot install {requirement}: {(ran.stderr.strip().splitlines() or ['?'])[-1]}")
        done.touch()
    return folder


if __name__ == "__main__":
    try:
        print(install(sys.argv[1]))
    except Unavailable as why:
        sys.exit(str(why))
