# SPDX-License-Identifier: Apache-2.0
"""Rules about the text of the tree: lengths, licence lines, words, unfinished work, and the list of RT exemptions."""

import ast
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import silent_tests
from cpp_text import cpp_functions

ROOT = Path(__file__).parent.parent
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
MAX_FOLDER_FILES = 20
MAX_COLUMNS = 120
# A corpus: each file is one of many of a kind, complete in itself, and found by its name.
CORPORA = {
    "tests/laws_hostile": "a law in each that must be refused or contained",
    "tests/fuzz": "a fuzzer in each",
    "docs/adr": "a decision in each, numbered and never removed",
}
MAX_EXEMPTIONS = 5
GENERATED = re.compile(r"^spine/wire/|^brain/lithe/_wire\.py$|^docs/reference/|/golden/|\.msg$")
CPP = (".cpp", ".hpp", ".c", ".h")
SPDX = "SPDX-License-Identifier: Apache-2.0"
NEEDS_SPDX = re.compile(r"(\.(cpp|hpp|c|h|py|sh|toml|cmake|yml)|CMakeLists\.txt|Makefile|tools/setup|\.ci/run)$")
MAX_MARKDOWN_COLUMNS = 140
MAX_HEADING_COLUMNS = 90  # a longer one has swallowed the paragraph below it
MADE_PAGES = re.compile(r"^docs/reference/(cli|python|wire)\.md$|^docs/mistakes\.md$")
EXEMPTION = re.compile(r'LITHE_RT_EXEMPT\(\s*"([^"]+)"')

# Words of the glossary's last column (CONTRIBUTING.md): what to say instead, in which files, and what is right there
# all the same. A word counts in names, too: `free_place` and `FreePlace` have "place".
FORBIDDEN = (
    ("transactions?", "swap", "", "SPI transaction|IEEE Transactions|transactional"),
    ("rides?", "simulated run", "", ""),
    ("mishaps?|befalls?|meddles?", "fault, or fault injection", "", ""),
    ("bridges?", "gateway, or migration", "", ""),
    ("conversations?", "exchange", "^spine/", ""),
    ("beats?", "heartbeat", r"^(spine|supervisor)/(?!.*test)", ""),
    ("troubles?", "fault, error or problem", r"^(spine|supervisor|trial|host|lawd)/(?!.*test)", '"trouble"'),
    ("demands?", "setpoint", r"^spine/hal/cia402/[^/]*$", ""),
    ("box", "answer that is still to come", "^supervisor/(core|swap)/", r'box_ms|--box|"box'),
    ("places?", "slot, resident or index", r"^spine/(load/(?!.*test)|law/slot)", ""),
    ("morning|evening", "start-up, shutdown", "^supervisor/", ""),
)
KEEP_THEIR_WORDS = re.compile(
    r"^(CHANGELOG|CONTRIBUTING)\.md$|^docs/(adr|transcripts)/|^tools/lint\.py$|/test_lint\.py$"
)


def python_functions(text: str) -> Iterator[tuple[int, int]]:
    """(first line, length in lines) of every function in Python text."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.lineno, (node.end_lineno or node.lineno) - node.lineno + 1


def check_lengths(path: str, text: str) -> Iterator[str]:
    """Files and functions that no longer fit in a head."""
    if GENERATED.search(path):
        return
    lines = text.count("\n")
    if lines > MAX_FILE_LINES:
        yield f"{path}:1: {lines} lines; {MAX_FILE_LINES} at most: split it by what its parts are about"
    functions = python_functions(text) if path.endswith(".py") else cpp_functions(text)
    for line, length in functions:
        if length > MAX_FUNCTION_LINES:
            yield f"{path}:{line}: a function of {length} lines; {MAX_FUNCTION_LINES} at most: name its steps"


def check_licence(path: str, text: str) -> Iterator[str]:
    """Files without the licence line among their first three."""
    if NEEDS_SPDX.search(path) and SPDX not in "\n".join(text.splitlines()[:3]):
        yield f"{path}:1: add the line '{SPDX}' as a comment"


def check_style(path: str, text: str) -> Iterator[str]:
    """C++ lines that the formatter leaves as they are: long comments and texts, contracts that nobody finds."""
    if GENERATED.search(path):
        return
    for number, line in enumerate(text.splitlines(), 1):
        if len(line) > MAX_COLUMNS:
            yield f"{path}:{number}: {len(line)} columns; {MAX_COLUMNS} at most"
        if re.search(r"//.*[^/ ] +Contract:", line):
            yield f"{path}:{number}: 'Contract:' begins a line of its own"


def check_words(path: str, text: str) -> Iterator[str]:
    """Words that the glossary replaces, in names, comments and pages. Old decisions keep theirs."""
    if GENERATED.search(path) or KEEP_THEIR_WORDS.search(path):
        return
    rules = [rule for rule in FORBIDDEN if re.search(rule[2], path) and re.search(rule[0], text, re.IGNORECASE)]
    for number, line in enumerate(text.splitlines(), 1):
        for words, instead, _, right in rules:
            said = re.sub(right, "", line) if right else line
            said = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|_", " ", said)
            if match := re.search(rf"\b({words})\b", said, re.IGNORECASE):
                yield f"{path}:{number}: '{match[0]}' is not in the glossary (CONTRIBUTING.md): say {instead}"


def check_columns(path: str, text: str) -> Iterator[str]:
    """Lines of Markdown that an editor would wrap, but for tables, code, and what no space divides."""
    if MADE_PAGES.search(path):
        return
    code = False
    for number, line in enumerate(text.splitlines(), 1):
        code ^= line.lstrip().startswith("```")
        can_break = " " in re.sub(r"`[^`]*`|\]\([^)]*\)", "", line.strip())
        if len(line) > MAX_MARKDOWN_COLUMNS and can_break and not code and not re.match(r" *\||#| {4,}\S", line):
            yield f"{path}:{number}: {len(line)} columns; {MAX_MARKDOWN_COLUMNS} at most: break the line"


def prose(text: str) -> Iterator[tuple[int, str]]:
    """The lines of a page that are not code, with their numbers."""
    code = False
    for number, line in enumerate(text.splitlines(), 1):
        code ^= line.lstrip().startswith("```")
        if not code:
            yield number, line


def anchors(text: str) -> set[str]:
    """What a link may name of a page: its headings, as they are shown on the web."""
    found: Counter[str] = Counter()
    for _, line in prose(text):
        if match := re.match(r"#{1,6} (.*)", line):
            words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", match[1]).lower()
            found[re.sub(r"[^\w\- ]", "", words).replace(" ", "-")] += 1
    return {name + (f"-{number}" if number else "") for name, count in found.items() for number in range(count)}


def check_links(path: str, text: str, root: Path) -> Iterator[str]:
    """Links to a file or a heading that is not there, and headings that are a paragraph."""
    for number, line in prose(text):
        if line.startswith("#") and len(line) > MAX_HEADING_COLUMNS:
            yield f"{path}:{number}: a heading of {len(line)} columns; {MAX_HEADING_COLUMNS} at most"
        for link in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`]*`", "", line)):
            name, _, heading = link.partition("#")
            page = (root / path).parent / name
            if re.match(r"[a-z]+:", link):
                continue
            if not page.exists():
                yield f"{path}:{number}: there is no file {name}"
                continue
            there = text if not name else page.read_text(encoding="utf-8") if page.suffix == ".md" else ""
            if heading and there and heading not in anchors(there):
                yield f"{path}:{number}: {name or path} has no heading #{heading}"


def check_unfinished(path: str, text: str) -> Iterator[str]:
    """Marks of unfinished work: those belong into an issue."""
    if path.startswith(("tools/lint.py", "tests/tools/")):
        return
    for number, line in enumerate(text.splitlines(), 1):
        if re.search(r"\b(TODO|FIXME|XXX|HACK)\b", line):
            yield f"{path}:{number}: unfinished work in the source; finish it or open an issue"


def check_folders(paths: list[str]) -> Iterator[str]:
    """Folders in which nobody finds anything: too many files that are not in a folder of their own."""
    for folder, files in sorted(Counter(path.rpartition("/")[0] for path in paths).items()):
        if files > MAX_FOLDER_FILES and folder not in CORPORA:
            yield f"{folder}: {files} files; {MAX_FOLDER_FILES} at most: give what belongs together a folder"


def exemptions(path: str, text: str) -> Iterator[str]:
    """The reasons given for stepping out of the real-time contract."""
    if path.endswith(("core/rt.hpp", "_test.cpp", "_rig.hpp")):
        return
    for match in EXEMPTION.finditer(text):
        yield f"{path}:{text.count(chr(10), 0, match.start()) + 1}: {match[1]}"


def tracked(root: Path) -> list[str]:
    """The text files that git knows, or would know after `git add`."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout.splitlines()
    return sorted(path for path in listed if (root / path).is_file())


def main(root: Path) -> int:
    """Check the tree; print each problem on a line of its own."""
    problems: list[str] = []
    excuses: list[str] = []
    paths = tracked(root)
    for path in paths:
        if path.endswith((*CPP, ".py", ".md")):
            problems += check_words(path, (root / path).read_text())
        if path.endswith(".md"):
            problems += check_columns(path, (root / path).read_text())
            problems += check_links(path, (root / path).read_text(), root)
        if not path.endswith((*CPP, ".py")) and not NEEDS_SPDX.search(path):
            continue
        text = (root / path).read_text()
        problems += [*check_licence(path, text), *check_unfinished(path, text)]
        if path.endswith((*CPP, ".py")):
            problems += check_lengths(path, text)
        if path.endswith(CPP):
            problems += check_style(path, text)
            excuses += exemptions(path, text)
    problems += check_folders(paths)
    problems += silent_tests.problems(root, paths)
    if len(excuses) > MAX_EXEMPTIONS:
        problems.append(f"{len(excuses)} RT exemptions; {MAX_EXEMPTIONS} at most: make the call real-time, or move it")
    for excuse in excuses:
        print("RT exemption", excuse)
    for problem in problems:
        print(problem)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(ROOT))
