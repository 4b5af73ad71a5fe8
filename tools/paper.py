# SPDX-License-Identifier: Apache-2.0
"""Holds docs/paper.md to the tree: every claim says where it stands and what shows it, and that exists. The same of
the numbers in docs/rt.md: each names its command, or says when it was measured by hand. And every path of the tree
that a page names exists.

python tools/paper.py            exit code 0 when all is there, 1 with a line for each thing that is not
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGE = Path("docs/paper.md")
HEAD = ["claim", "stands", "what is different", "shown by"]
STANDS = ("yes", "more", "partly", "no")
LEAST_ROWS = 50  # fewer, and claims have been dropped
NUMBERS = Path("docs/rt.md")
NUMBERS_HEAD = ["number", "command"]
BY_HAND = re.compile(r"measured once, 20\d\d-\d\d-\d\d: .")
TREE = "spine supervisor lawd trial sim bench brain tools tests docs schema models laws robots examples cmake firmware"
NAMED_PATH = re.compile(rf"(?:{TREE.replace(' ', '|')})/[\w./*-]*")
PROGRAMS = ("make", "lithe", "python", "pytest")


def command_trouble(command: str, root: Path) -> str:
    """What is missing of a command or file; empty when nothing is."""
    words = command.split()
    if words[0] == "make":
        targets = re.findall(r"^([a-z0-9-]+):", (root / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
        return "" if words[1:] and words[1] in targets else f"the Makefile has no target '{' '.join(words[1:])}'"
    if words[0] == "lithe":
        cli = "".join(path.read_text(encoding="utf-8") for path in sorted((root / "supervisor/cli").rglob("*.cpp")))
        verbs = [word for word in words[1:] if not word.startswith("-")]
        missing = [verb for verb in verbs if f'"{verb}"' not in cli]
        return f"`lithe` has no verb '{missing[0]}'" if missing or not verbs else ""
    if words[0] == "python" and words[1:2] == ["-m"]:
        module = root / words[2].replace(".", "/")
        there = module.with_suffix(".py").exists() or (module / "__main__.py").exists()
        return "" if there else f"there is no module {words[2]}"
    file = words[1] if words[0] in ("pytest", "python") and len(words) > 1 else words[0]
    return "" if (root / file).exists() else f"there is no file {file}"


def table_rows(text: str) -> list[tuple[int, list[str]]]:
    """Every row of every table, with the number of its line."""
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.startswith("|")]
    return [
        (number, [cell.strip() for cell in line.strip("|").split("|")])
        for number, line in lines
        if not set(line) <= set("|- ")
    ]


def number_troubles(text: str, root: Path) -> list[str]:
    """One line for each number whose command is missing."""
    rows = table_rows(text)
    starts = [i for i, (_, cells) in enumerate(rows) if cells == NUMBERS_HEAD]
    if not starts:
        return [f"{NUMBERS}: has no table {' | '.join(NUMBERS_HEAD)}"]
    wrong = []
    for number, cells in rows[starts[-1] + 1 :]:
        where = f"{NUMBERS}:{number}: "
        named = [each for each in re.findall(r"`([^`]+)`", cells[-1]) if each.split()[0] in PROGRAMS]
        if not named and not BY_HAND.match(cells[-1]):
            wrong.append(f"{where}name a command, or say 'measured once, YYYY-MM-DD: how'")
        wrong += [f"{where}{trouble}" for command in named if (trouble := command_trouble(command, root))]
    return wrong


def path_troubles(page: Path, text: str, root: Path) -> list[str]:
    """One line for each path in backticks that does not exist. `*` stands for any name."""
    wrong = []
    for number, line in enumerate(text.splitlines(), 1):
        for quoted in re.findall(r"`([^`]+)`", line):
            for path in re.split(r"[\s,]+", quoted):
                if NAMED_PATH.fullmatch(path) and not any(root.glob(path.rstrip("/"))):
                    wrong.append(f"{page}:{number}: there is no {path}; name what is there, or leave it out")
    return wrong


def pages(root: Path) -> list[Path]:
    """Every page that says where things are; decision records and the changelog tell of the past."""
    tops = [page for page in root.glob("*.md") if page.name != "CHANGELOG.md"]
    rooms = [page for top in TREE.split() for page in (root / top).rglob("*.md") if "adr" not in page.parts]
    return sorted(tops + rooms)


def troubles(text: str, root: Path) -> list[str]:
    """One line for each thing that is wrong with the page."""
    wrong = []
    rows = 0
    lines = text.splitlines()
    for number, cells in table_rows(text):
        if cells == HEAD:
            continue
        rows += 1
        line = lines[number - 1]
        where = f"{PAGE}:{number}: "
        if len(cells) != len(HEAD):
            wrong.append(f"{where}has {len(cells)} columns; give it {len(HEAD)}: {', '.join(HEAD)}")
            continue
        if cells[1] not in STANDS:
            wrong.append(f"{where}stands: '{cells[1]}'; say one of {', '.join(STANDS)}")
        commands = re.findall(r"`([^`]+)`", cells[3])
        if not commands:
            wrong.append(f"{where}names neither a command nor a file that shows it")
        wrong += [f"{where}{trouble}" for command in commands if (trouble := command_trouble(command, root))]
        for image in re.findall(r"\]\(([^)]+)\)", line):
            if not (root / PAGE.parent / image).exists():
                wrong.append(f"{where}there is no file docs/{image}")
    if rows < LEAST_ROWS:
        wrong.append(f"{PAGE}: {rows} claims; the paper makes {LEAST_ROWS} or more")
    return wrong


def main() -> int:
    wrong = troubles((ROOT / PAGE).read_text(encoding="utf-8"), ROOT)
    wrong += number_troubles((ROOT / NUMBERS).read_text(encoding="utf-8"), ROOT)
    for page in pages(ROOT):
        wrong += path_troubles(page.relative_to(ROOT), page.read_text(encoding="utf-8"), ROOT)
    print("\n".join(wrong), end="\n" if wrong else "")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
