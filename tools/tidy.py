# SPDX-License-Identifier: Apache-2.0
"""clang-tidy over the sources, several at a time, remembering which file was clean with which text.

clang-tidy keeps silent about a check name that does not exist, so a slip of the pen would switch a group off.
Here it is an error.
"""

import argparse
import fnmatch
import hashlib
import json
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parent.parent
BUILD = ROOT / "build/clang"
TIDY = "clang-tidy-22"
WARNING = re.compile(r"-?clang-diagnostic-")  # the compiler's own warnings have no list
SKIP = re.compile(r"_test\.cpp$|^tests/|^laws/")  # tests are read by two compilers and three sanitizers
# One step of a unity build includes ten sources: what they include is read once.
UNITY = re.compile(r"/Unity/unity_\d+_cxx\.cxx$")
INCLUDED = re.compile(r'^#include "(.*)"$', flags=re.M)


def globs_of(config: str) -> list[str]:
    """The check names and groups a .clang-tidy file asks for, without the minus of those it takes away."""
    block = re.search(r"^Checks:\s*[>|]?-?\s*\n?((?:.*\n)*?)^\w", config, flags=re.M)
    text = block[1] if block else ""
    return [glob for glob in re.sub(r"[\s'\"]", "", text).replace("-*,", "", 1).split(",") if glob]


def unknown_globs(globs: list[str], known: list[str]) -> list[str]:
    """The globs that name no check at all."""
    return [glob for glob in globs if not fnmatch.filter(known, glob.removeprefix("-")) and not WARNING.match(glob)]


def known_checks() -> list[str]:
    """Every check this clang-tidy has."""
    command = [TIDY, "--list-checks", "--checks=*", "--config={}"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


def members(file: Path) -> list[Path]:
    """The sources that are read with this one: those a step of a unity build includes, or it alone."""
    return [Path(name) for name in INCLUDED.findall(file.read_text())] if UNITY.search(str(file)) else [file]


def wanted(file: Path) -> bool:
    """Whether any of its sources is ours, and no test."""
    ours = [source.relative_to(ROOT) for source in members(file) if source.is_relative_to(ROOT)]
    return any(not SKIP.search(str(source)) and source.parts[0] != "build" for source in ours)


def digest(file: Path) -> str:
    """What the verdict on a file depends on: its sources' text, every header of ours, and the configuration."""
    total = hashlib.sha256((ROOT / ".clang-tidy").read_bytes() + file.read_bytes())
    for source in members(file):
        total.update(source.read_bytes())
    for room in ("spine", "host", "supervisor", "lawd", "trial", "sim", "bench"):
        for header in sorted((ROOT / room).rglob("*.hpp")):
            total.update(header.read_bytes())
    return total.hexdigest()


def tidy(file: Path) -> tuple[Path, str]:
    """The complaints about one file, empty when it is clean."""
    mark = BUILD / "tidy" / digest(file)
    if mark.exists():
        return file, ""
    command = [TIDY, "--quiet", "-p", str(BUILD), str(file)]
    if UNITY.search(str(file)):
        command.append("--checks=-bugprone-suspicious-include")  # of a .cpp: that is what such a step is
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        mark.parent.mkdir(exist_ok=True)
        mark.touch()
        return file, ""
    return file, done.stdout or done.stderr


def reads_our_headers() -> bool:
    """A bad name in a header of ours is a complaint. (A HeaderFilterRegex that matches nothing says nothing, too.)"""
    folder = BUILD / "tidy-probe" / "spine"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "probe.hpp").write_text("inline int BadName() { return 1; }\n")
    (folder / "probe.cpp").write_text('#include "probe.hpp"\nint main() { return BadName(); }\n')
    command = [TIDY, "--quiet", f"--config-file={ROOT / '.clang-tidy'}", str(folder / "probe.cpp"), "--"]
    return "BadName" in subprocess.run(command, capture_output=True, text=True, check=False).stdout


def main() -> int:
    """Check the names, that headers are read, then the sources."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-j", type=int, default=os.cpu_count() or 1)
    jobs: int = parser.parse_args().j
    unknown = unknown_globs(globs_of((ROOT / ".clang-tidy").read_text()), known_checks())
    if unknown:
        print(f".clang-tidy: no such check: {', '.join(unknown)}; see {TIDY} --list-checks --checks='*'")
        return 1
    if not reads_our_headers():
        print(".clang-tidy: HeaderFilterRegex matches no header of ours (it knows no lookahead)")
        return 1
    commands = json.loads((BUILD / "compile_commands.json").read_text())
    files = [file for file in sorted({Path(entry["file"]) for entry in commands}) if wanted(file)]
    failed = 0
    with ThreadPoolExecutor(jobs) as pool:
        for _, complaints in pool.map(tidy, files):
            failed += bool(complaints)
            print(complaints, end="")
    sources = sum(len(members(file)) for file in files)
    print(f"{sources} sources in {len(files)} runs, {failed} with complaints")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
