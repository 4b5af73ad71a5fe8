# SPDX-License-Identifier: Apache-2.0
"""Holds docs/paper.md to the tree: every claim says where it stands, and names a command that shows it. The command's
tests, verbs, options, targets and files exist; a file alone shows nothing. The same of the numbers in docs/rt.md: each
names its command, or says when it was measured by hand. Every path of the tree that a page names exists, also one that
is written without its folders, and every `lithe` command has the verb and the options that it is given. The numbers of
`stated` are counted.

python tools/paper.py            exit code 0 when all is there, 1 with a line for each thing that is not
"""

from __future__ import annotations

import json
import re
import shlex
import sys
from fnmatch import filter as fnfilter
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import lint

ROOT = Path(__file__).parent.parent
PAGE = Path("docs/paper.md")
HEAD = ["claim", "stands", "what is different", "shown by"]
STANDS = ("yes", "more", "partly", "no")
LEAST_ROWS = 108  # fewer, and claims have been dropped
FILES_THAT_SHOW = re.compile(r"LICENSE|.*\.(svg|png)")  # a claim that is nothing but a file: the licence, a drawing
NUMBERS = Path("docs/rt.md")
NUMBERS_HEAD = ["number", "command"]
BY_HAND = re.compile(r"measured once, 20\d\d-\d\d-\d\d: .")
TREE = "host spine supervisor lawd trial sim bench brain tools tests docs schema models laws robots examples cmake"
TREE += " firmware"
RELATIVE = re.compile(r"[\w*-][\w./*-]*(?:/|\.(?:cpp|hpp|py|pml|c|h))")  # `core/act.hpp`, `robot/`: the end of a path
BARE = re.compile(r"(?<![\w./-])\w[\w./-]*\.(?:cpp|hpp|py|pml|c|h)\b")
# Results, and names that stand for any.
NO_FILE = re.compile(r"(?:out|build)/.*|swaps/.*|(?:x|x_test|my|best)\.[ch]pp|x\.py")
NAMED_PATH = re.compile(rf"(?:{TREE.replace(' ', '|')})/[\w./*-]*")
WORDS = ["no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"]
# Commands that fail when a claim does not hold. The others show something to a person: they print, measure or ask.
JUDGES = re.compile(
    r"(pytest|ctest|build/release/bin/\S+) |python tools/(check|gen)\.py |make (demo|boards|bench-|test)"
)
PROGRAMS = ("make", "lithe", "python", "pytest", "ctest", "build/release/bin/")
CLI = Path("docs/reference/cli.md")  # made from the table that parses; a test compares
SIM = Path("docs/reference/sim.md")  # `lithe sim` reads its own words
MODULES = ("agent", "mcp", "evolve", "identify", "model")  # so do these, packages below brain/lithe


@cache
def cpp_tests(root: Path) -> dict[str, list[Path]]:
    """Suite.Name of each GoogleTest, as gtest names one, and the files that have it."""
    found: dict[str, list[Path]] = {}
    for top in TREE.split():
        for path in sorted((root / top).rglob("*_test.cpp")):
            for kind, suite, name in re.findall(
                r"^(TEST|TEST_F|TEST_P)\(\s*(\w+),\s*(\w+)\)", path.read_text(encoding="utf-8"), re.MULTILINE
            ):
                full = f"each/{suite}.{name}/0" if kind == "TEST_P" else f"{suite}.{name}"
                found.setdefault(full, []).append(path)
    return found


@cache
def programs(root: Path) -> list[tuple[str, str, Path]]:
    """What CMake makes test programs of: room or test, pattern of the name (a loop's variable is any word), folder."""
    return [
        (kind, re.sub(r"\$\{\w+\}", r"\\w+", name), path.parent)
        for top in TREE.split()
        for path in sorted((root / top).rglob("CMakeLists.txt"))
        for kind, name in re.findall(r"lithe_(room|test)\((\S+)", path.read_text(encoding="utf-8"))
    ]


@cache
def cli_verbs(root: Path) -> dict[str, set[str]]:
    """Each verb of `lithe` ("law check"), with its options; "" has those before a verb."""
    verbs: dict[str, set[str]] = {"": set()}
    verb = ""
    for line in (root / CLI).read_text(encoding="utf-8").splitlines():
        if match := re.match(r"### `lithe ((?:[a-z]+ ?)+)", line):
            verb = match[1].strip()
            verbs[verb] = set()
        elif line.startswith("| `-"):
            verbs[verb] |= set(re.findall(r"--?[a-z-]+", line.split("|")[1]))
    own = {"sim": [root / SIM]} | {name: list((root / "brain/lithe" / name).glob("*.py")) for name in MODULES}
    for name, files in own.items():
        said = "".join(file.read_text(encoding="utf-8") for file in files)
        verbs.setdefault(name, set()).update(re.findall(r"--[a-z-]+", said))
    return verbs


def make_trouble(words: list[str], root: Path) -> str:
    text = (root / "Makefile").read_text(encoding="utf-8")
    targets = re.findall(r"^([a-z0-9-]+):", text, re.MULTILINE)
    if not words or words[0] not in targets:
        return f"the Makefile has no target '{' '.join(words)}'"
    given = dict(word.split("=", 1) for word in words[1:] if "=" in word)
    if unknown := [name for name in given if f"$({name})" not in text and f"$(or $({name})" not in text]:
        return f"the Makefile does not read {unknown[0]}"
    if words[0].startswith("test"):
        room = given.get("ROOM")
        if room is None:
            return f"`make {words[0]}` runs everything: name the room or the test"
        if not any(kind == "room" and re.fullmatch(name, room) for kind, name, _ in programs(root)):
            return f"there is no room {room}"
    return ""


def ctest_trouble(words: list[str], root: Path) -> str:
    presets = json.loads((root / "CMakePresets.json").read_text(encoding="utf-8"))["testPresets"]
    given = dict(zip(words[::2], words[1::2], strict=False))
    if given.get("--preset") not in [each["name"] for each in presets]:
        return f"CMakePresets.json has no test preset '{given.get('--preset')}'"
    if "-R" not in given:
        return "`ctest` without -R names no test"
    for part in given["-R"].split("|"):
        if not any(re.search(part, name) for name in cpp_tests(root)):
            return f"no C++ test is called {part}"
    return ""


def gtest_trouble(words: list[str], root: Path) -> str:
    program = Path(words[0]).name
    folders = [
        folder
        for kind, name, folder in programs(root)
        if re.fullmatch(f"{name}_tests" if kind == "room" else name, program)
    ]
    if not folders:
        return f"no room makes the program {program}"
    wanted = [word.removeprefix("--gtest_filter=") for word in words[1:] if word.startswith("--gtest_filter=")]
    if not wanted:
        return f"`{program}` without --gtest_filter names no test"
    here = [
        name
        for name, paths in cpp_tests(root).items()
        if any(path.is_relative_to(f) for path in paths for f in folders)
    ]
    for pattern in wanted[0].split(":"):
        if not any(fnmatch(name, pattern) for name in here):
            return f"{program} has no test {pattern}"
    return ""


def pytest_trouble(words: list[str], root: Path) -> str:
    nodes = [word for word in words if not word.startswith("-")]
    if not nodes:
        return "`pytest` names no file"
    for node in nodes:
        file, *names = node.split("::")
        if not (root / file).is_file():
            return f"there is no file {file}"
        tests = re.findall(r"^ *def (test_\w+)\(", (root / file).read_text(encoding="utf-8"), re.MULTILINE)
        if not tests or (names and names[-1].split("[")[0] not in tests):
            return f"{file} has no test {names[-1] if names else ''}".rstrip()
    return ""


def python_trouble(words: list[str], root: Path) -> str:
    module = words[:1] == ["-m"]
    what, rest = (words[1], words[2:]) if module else (words[0], words[1:])
    path = root / what.replace(".", "/") if module else root / what
    files = sorted(path.glob("*.py")) if (path / "__main__.py").exists() else [path.with_suffix(".py")]
    if not all(file.exists() for file in files) or (not module and not path.exists()):
        return f"there is no module {what}" if module else f"there is no file {what}"
    text = "".join(file.read_text(encoding="utf-8") for file in files)
    for word in rest:
        there = (root / word).exists() if "/" in word else f'"{word}"' in text
        if not there:
            return f"{what} knows no {word}"
    return ""


def lithe_trouble(words: list[str], root: Path) -> str:
    """Verb and options; of the other words those that are paths, where they look like ones of this tree."""
    verbs = cli_verbs(root)
    words = words[: words.index("--")] if "--" in words else words
    while words and words[0] in verbs[""]:
        words = words[2 if words[0] == "--robot" else 1 :]
    name = " ".join(words[:2]) if " ".join(words[:2]) in verbs else "".join(words[:1])
    if name not in verbs or not name:
        return f"`lithe` has no verb '{name}'"
    rest = words[len(name.split()) :]
    if any(verb.startswith(f"{name} ") for verb in verbs) and not set(rest) & {"--help"}:
        return f"`lithe {name}` has no verb '{' '.join(rest[:1])}'"
    for word in rest:
        option = word.split("=")[0]
        if re.match(r"--?[a-z]", option) and option not in verbs[name] | verbs[""]:
            return f"`lithe {name}` has no option {option}"
        if NAMED_PATH.fullmatch(word) and not (root / word).exists():
            return f"there is no file {word}"
    return ""


def command_trouble(command: str, root: Path) -> str:
    """What is missing of a command or file; empty when nothing is."""
    words = shlex.split(command)
    checks = {
        "make": make_trouble, "ctest": ctest_trouble, "pytest": pytest_trouble, "python": python_trouble,
        "lithe": lithe_trouble,
    }  # fmt: skip
    if words[0] in checks:
        return checks[words[0]](words[1:], root) if words[1:] else f"`{words[0]}` alone shows nothing"
    if words[0].startswith("build/release/bin/"):
        return gtest_trouble(words, root)
    return "" if (root / words[0]).exists() else f"there is no file {words[0]}"


def table_rows(text: str) -> list[tuple[int, list[str]]]:
    """Every row of every table, with the number of its line."""
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.startswith("|")]
    return [
        (number, [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line.strip("|"))])
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
        named = [each for each in re.findall(r"`([^`]+)`", cells[-1]) if each.startswith(PROGRAMS)]
        if not named and not BY_HAND.match(cells[-1]):
            wrong.append(f"{where}name a command, or say 'measured once, YYYY-MM-DD: how'")
        wrong += [f"{where}{trouble}" for command in named if (trouble := command_trouble(command, root))]
    return wrong


@cache
def named_ends(root: Path) -> list[str]:
    """Each file and folder of the tree, with as many of its folders as one may write."""
    paths = {str(each) for path in lint.tracked(root) for each in (Path(path), *Path(path).parents)}
    return sorted({path.split("/", skipped)[-1] for path in paths for skipped in range(path.count("/") + 1)})


def path_troubles(page: Path, text: str, root: Path) -> list[str]:
    """One line for each path in backticks, and each source file without them, that does not exist. `*` and words in
    capitals stand for any name."""
    wrong = []
    code = False
    for number, line in enumerate(text.splitlines(), 1):
        code ^= line.lstrip().startswith("```")
        bare = [] if code or line.startswith("    ") else BARE.findall(re.sub(r"`[^`]*`|\]\([^)]*\)", "", line))
        for quoted in re.findall(r"`([^`]+)`", line) + bare:
            for path in re.split(r"[\s,]+", quoted):
                pattern = re.sub(r"\b[A-Z]{3,}\b", "*", path).rstrip("/")
                if NAMED_PATH.fullmatch(path):
                    there = any(root.glob(pattern))
                else:
                    may_be = RELATIVE.fullmatch(path) and not NO_FILE.fullmatch(path)
                    there = not may_be or bool(fnfilter(named_ends(root), pattern))
                if not there:
                    wrong.append(f"{page}:{number}: there is no {path}; name what is there, or leave it out")
    return wrong


def cli_troubles(page: Path, text: str, root: Path) -> list[str]:
    """One line for each `lithe` command, in backticks or in a block of code, with a verb or an option that is none."""
    wrong = []
    code = False
    groups = {verb.split()[0] for verb in cli_verbs(root) if " " in verb}  # `lithe law` alone names all of them
    for number, line in enumerate(text.splitlines(), 1):
        code ^= line.lstrip().startswith("```")
        whole = [line.split("#")[0]] if code or line.startswith("    ") else re.findall(r"`([^`]+)`", line)
        for command in re.findall(r"(?:^|[\s/])lithe ([^|;&()\n]+)", "\n".join(whole)):
            words = [word.strip('[]."') for word in command.split()]
            if len(words) > 1 or (words and words[0] not in groups):
                trouble = lithe_trouble(words, root)
                wrong += [f"{page}:{number}: {trouble}"] if trouble else []
    return wrong


def paths_in(page: Path, first: str, end: str = "|") -> list[str]:
    """The paths that the row, paragraph or list names that begins so, up to `end`."""
    text = page.read_text(encoding="utf-8").partition(first)[2]
    text = text.partition(end)[0].removeprefix(", file by file:\n\n").partition("\n\n")[0]
    return [path for path in re.findall(r"`([\w./]+\.[a-z]+)`", text) if not path.endswith(".md")]


def robot_sources(root: Path) -> list[str]:
    """The C++ that runs on a robot: without tests, and without what is generated."""
    rooms = ("spine/", "supervisor/", "lawd/", "trial/", "host/", "sim/", "laws/")
    ours = [path for path in lint.tracked(root) if path.startswith(rooms) and path.endswith(lint.CPP)]
    return [path for path in ours if not re.search(r"_test\.cpp$|/test/|^spine/wire/", path)]


def stated(root: Path) -> list[tuple[str, str, int, float]]:
    """Numbers that a page states: page, what stands around it, the number as it is counted, how far it may be off."""
    python = [path for path in lint.tracked(root) if re.search(r"(^|/)test_\w+\.py$", path)]
    tests = sum(
        len(re.findall(r"^ *def test_", (root / path).read_text(encoding="utf-8"), re.MULTILINE)) for path in python
    )
    tops = [path.rpartition("/")[0] for path in lint.tracked(root)]
    spine = (root / "spine/loop/spine.hpp").read_text(encoding="utf-8").partition("class Spine {")[2]
    largest = max(map(tops.count, set(tops) - set(lint.CORPORA)))
    members = len(re.findall(r"^  \S.* \*?\w+_(?: = .*)?;", spine, re.MULTILINE))
    to_tick = len(paths_in(root / "supervisor/README.md", "From text to tick"))
    lines = sum((root / path).read_text(encoding="utf-8").count("\n") for path in robot_sources(root))
    drive = len(paths_in(root / "ARCHITECTURE.md", "| add a device |", "; a protocol"))
    bus = len(paths_in(root / "ARCHITECTURE.md", "| add a bus |", "; a name for"))
    claims = [cells[1] for _, cells in table_rows((root / PAGE).read_text(encoding="utf-8")) if len(cells) == len(HEAD)]
    return [
        ("README.md", r"ctest, about ([\d,]+) tests", sum(map(len, cpp_tests(root).values())), 0.05),
        ("README.md", r"pytest, about ([\d,]+) functions", tests, 0.05),
        ("README.md", r"□ (\w+) small programs", len(list(root.glob("examples/*/main.py"))), 0),
        ("CONTRIBUTING.md", r"At most (\d+) lines a file", lint.MAX_FILE_LINES, 0),
        ("CONTRIBUTING.md", r"a file, (\d+) a function", lint.MAX_FUNCTION_LINES, 0),
        ("CONTRIBUTING.md", r"and (\d+) files a folder", lint.MAX_FOLDER_FILES, 0),
        ("CONTRIBUTING.md", r"accepts at most (\w+)\.", lint.MAX_EXEMPTIONS, 0),
        ("ARCHITECTURE.md", r"text to tick .*\| (\d+) \|$", to_tick, 0),
        ("ARCHITECTURE.md", r"new kind of drive.*\| (\d+) \|$", drive, 0),
        ("ARCHITECTURE.md", r"new kind of bus.*\| (\d+) \|$", bus, 0),
        ("ARCHITECTURE.md", r"largest folder .*\| (\d+) \|$", largest, 0),
        ("ARCHITECTURE.md", r"members of `Spine` .*\| (\d+) \|$", members, 0),
        ("ARCHITECTURE.md", r"lines of C\+\+ .*\| ([\d,]+) \|$", lines, 0.02),
        *((str(PAGE), rf"(\d+) {word}\b", claims.count(word), 0) for word in STANDS),
    ]  # fmt: skip


def stated_troubles(page: str, text: str, numbers: list[tuple[str, str, int, float]]) -> list[str]:
    """One line for each number of a page that is not what is counted, or that the page no longer states."""
    wrong = []
    for _, pattern, counted, slack in (each for each in numbers if each[0] == page):
        match = re.search(pattern, text, re.MULTILINE)
        if match is None:
            wrong.append(f"{page}: does not state {pattern} any more: change `stated` in tools/paper.py, too")
            continue
        said = WORDS.index(match[1]) if match[1] in WORDS else int(match[1].replace(",", ""))
        if abs(said - counted) > slack * counted:
            line = text.count("\n", 0, match.start(1)) + 1
            wrong.append(f"{page}:{line}: '{match[0].strip('| ')}', but {counted} are counted")
    return wrong


def pages(root: Path) -> list[Path]:
    """Every page that says where things are; decision records and the changelog tell of the past."""
    tops = [page for page in root.glob("*.md") if page.name != "CHANGELOG.md"]
    rooms = [page for top in TREE.split() for page in (root / top).rglob("*.md") if "adr" not in page.parts]
    return sorted(tops + rooms)


def row_trouble(command: str, stands: str, root: Path) -> str:
    """What is wrong with a command of a row; also a file where something has to be shown."""
    trouble = command_trouble(command, root)
    if not trouble and stands != "no" and not command.startswith(PROGRAMS) and not FILES_THAT_SHOW.fullmatch(command):
        return f"{command} is a file, which shows nothing: name a command"
    return trouble


def troubles(text: str, root: Path) -> list[str]:
    """One line for each thing that is wrong with the page."""
    wrong = []
    rows = 0
    for number, cells in table_rows(text):
        if cells == HEAD:
            continue
        rows += 1
        where = f"{PAGE}:{number}: "
        if len(cells) != len(HEAD):
            wrong.append(f"{where}has {len(cells)} columns; give it {len(HEAD)}: {', '.join(HEAD)}")
            continue
        if cells[1] not in STANDS:
            wrong.append(f"{where}stands: '{cells[1]}'; say one of {', '.join(STANDS)}")
        commands = re.findall(r"`([^`]+)`", cells[3])
        if not commands and cells[1] != "no":
            wrong.append(f"{where}names neither a command nor a file that shows it")
        missing = [trouble for command in commands if (trouble := row_trouble(command, cells[1], root))]
        if commands and not missing and cells[1] in ("yes", "more") and not any(map(JUDGES.match, commands)):
            missing = ["none of its commands fails when the claim does not hold: name a test"]
        wrong += [f"{where}{trouble}" for trouble in missing]
    if rows < LEAST_ROWS:
        wrong.append(f"{PAGE}: {rows} claims; the paper makes {LEAST_ROWS} or more")
    return wrong


def main() -> int:
    wrong = troubles((ROOT / PAGE).read_text(encoding="utf-8"), ROOT)
    wrong += number_troubles((ROOT / NUMBERS).read_text(encoding="utf-8"), ROOT)
    numbers = stated(ROOT)
    for path in pages(ROOT):
        page, text = path.relative_to(ROOT), path.read_text(encoding="utf-8")
        wrong += path_troubles(page, text, ROOT)
        wrong += stated_troubles(str(page), text, numbers)
        wrong += [] if page == CLI else cli_troubles(page, text, ROOT)
    print("\n".join(wrong), end="\n" if wrong else "")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
