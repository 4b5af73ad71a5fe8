# SPDX-License-Identifier: Apache-2.0
"""Who may include whom: the architecture as one table, held against every #include and import in the tree, and against
the maps of it in ARCHITECTURE.md and README.md."""

import ast
import re
import sys
from collections.abc import Iterator
from itertools import pairwise, product
from pathlib import Path

import lint
import paper

# Functions and classes on the way of a law from its text to the tick: the page lists the files that define them.
WAY_PAGE = "supervisor/README.md"
WAY = "From text to tick"
ON_THE_WAY = """
    Server::read_from Verbs::handle Swaps::submit Swaps::swap_law Sequence::Until::await_suspend
    SwapState::mark_committed ServiceLink::ask LawdLink::compile SpineLink::take_slot TrialLink::attempt
    Service::compile Service::place Zygote::attempt run_trial SpineLink::stage Swaps::hear Loader::stage
    ArenaStore::load Rehearsal::prepare Slot Spine::tick ControlStep::run Laws::swap
"""

# room -> rooms it may include (itself is always allowed). The most specific room that holds a file wins.
BASE = "spine/core spine/wire"
OUTSIDE = BASE + " spine/ipc spine/law spine/robot spine/robot/read"  # what the processes beside the Spine may know
HAL = Path(__file__).parent.parent / "spine/hal"
# A kind of bus: a folder of spine/hal/bus. A kind of device: a folder of spine/hal with a folder sim/. What only one
# kind has in a robot file is read in its folder keys/ (docs/adr/0023). A new one needs no line here.
BUS = "spine/hal/core spine/hal/bus/loop spine/hal/bus/serial"
BUS_KINDS = sorted(
    f"spine/hal/bus/{folder.name}"
    for folder in (HAL / "bus").iterdir()
    if folder.is_dir() and folder.name not in ("loop", "serial", "test")
)
BUSES = f"{BUS} {' '.join(BUS_KINDS)}"
KINDS = sorted(f"spine/hal/{folder.parent.name}" for folder in HAL.glob("*/sim"))
KEYS = sorted(f"spine/hal/{folder.relative_to(HAL)}" for to in ("*/keys", "bus/*/keys") for folder in HAL.glob(to))
DEVICES = "spine/hal/canopen " + " ".join(KINDS)
SIMULATED = "spine/hal/physics " + " ".join(f"{kind}/sim" for kind in KINDS)
DEVICE = BASE + " spine/robot spine/hal/core spine/hal/bus/serial spine/hal/canopen"
LAWD = BASE + " spine/ipc spine/law spine/arena"
TRIAL = LAWD + " spine/load spine/robot spine/hal spine/hal/sim spine/step"
BUS_TOOLS = f"{BASE} spine/robot spine/hal {BUSES} {DEVICES}"
LINKED = OUTSIDE + " supervisor/core supervisor/link/spine supervisor/link/services"
SWAPPING = LINKED + " supervisor/events supervisor/swap/certificate"
BUSES_SHOWN = " supervisor/bus/plan supervisor/bus/scan supervisor/bus/monitor"
HOST = " host/read host/doctor host/tune"
CLI = OUTSIDE + " supervisor/core supervisor/link/spine supervisor/link/client" + BUSES_SHOWN
ALLOWED = {
    room: frozenset(allowed.split())
    for room, allowed in {
        "spine/core": "",
        "spine/wire": "spine/core",
        "spine/ipc": BASE,
        "spine/law/include": "",  # the contract of a law; whoever may include spine/law may include it
        "spine/law": BASE + " spine/law/include",
        "spine/robot/read": "spine/core",
        **dict.fromkeys(KEYS, "spine/core spine/robot/read"),
        "spine/robot": "spine/core spine/mechanics spine/robot/read " + " ".join(KEYS),
        "spine/plan": BASE + " spine/robot",
        "spine/mechanics": "spine/core",
        "spine/guard": BASE + " spine/law/include spine/mechanics spine/robot",
        "spine/hal/core": BASE,
        "spine/hal/bus/loop": BASE + " spine/hal/core",
        "spine/hal/bus/serial": BASE + " spine/hal/core spine/hal/bus/loop",
        "spine/hal/canopen": BASE + " spine/hal/core",
        **{
            kind: f"{allowed} {kind}/keys" if f"{kind}/keys" in KEYS else allowed
            for kinds, allowed in ((BUS_KINDS, f"{BASE} {BUS} spine/robot"), (KINDS, DEVICE))
            for kind in kinds
        },
        **{f"{kind}/sim": f"{DEVICE} spine/hal/bus/loop spine/hal/physics {kind}" for kind in KINDS},
        "spine/hal/physics": BASE + " spine/robot spine/hal/core spine/hal/bus/loop",
        "spine/hal": f"{BASE} spine/robot {BUSES} {DEVICES}",
        "spine/hal/sim": f"{BASE} spine/robot spine/hal spine/hal/core {BUSES} {SIMULATED}",
        "spine/contain": BASE,
        "spine/arena": "spine/core",
        "spine/load": BASE + " spine/ipc spine/law spine/arena spine/contain",
        "spine/step": BASE + " spine/law spine/plan spine/guard spine/robot spine/hal spine/contain",
        "spine/loop": BASE + " spine/ipc spine/law spine/robot spine/hal spine/contain spine/step",
        "spine": BASE
        + " spine/ipc spine/law spine/robot spine/hal spine/hal/core spine/hal/sim spine/contain spine/arena"
        + " spine/loop spine/load",
        "host": "",
        "host/read": "spine/core",
        "host/doctor": "spine/core host/read",
        "host/tune": "spine/core spine/robot spine/robot/read host/read",  # board profiles are read as robot files are
        "lawd/run": LAWD,
        "lawd/core": LAWD,
        "lawd/compile": LAWD + " lawd/core lawd/run",
        "lawd/source": LAWD + " lawd/core",
        "lawd/object": LAWD + " lawd/core lawd/run lawd/compile lawd/source",
        "lawd": LAWD + " lawd/core lawd/run lawd/compile lawd/source lawd/object",
        "trial/core": TRIAL,
        "trial/sandbox": BASE,
        "trial/simulation": TRIAL + " trial/core",
        "trial/sections": TRIAL + " trial/core trial/simulation",
        "trial": TRIAL + " trial/core trial/sandbox trial/simulation trial/sections",
        "sim": f"{BASE} spine/robot spine/hal/sim spine/hal/physics {BUSES}",
        "laws": "spine/law",
        "supervisor/bus": BUS_TOOLS,
        "supervisor/bus/plan": BUS_TOOLS,
        "supervisor/bus/scan": BUS_TOOLS + " supervisor/bus supervisor/bus/plan",
        "supervisor/bus/monitor": BUS_TOOLS + " supervisor/bus supervisor/bus/plan supervisor/bus/scan",
        "supervisor/core": OUTSIDE,
        "supervisor/link/spine": OUTSIDE + " spine/arena supervisor/core",
        "supervisor/link/services": OUTSIDE + " supervisor/core",
        "supervisor/link/client": OUTSIDE + " supervisor/core supervisor/link/spine",
        "supervisor/events": OUTSIDE + " supervisor/core supervisor/link/spine",
        "supervisor/incident": OUTSIDE + " supervisor/core supervisor/link/spine supervisor/events",
        "supervisor/swap/certificate": OUTSIDE + " supervisor/core",
        "supervisor/swap": LINKED + " spine/arena supervisor/events supervisor/swap/certificate",
        "supervisor/serve": SWAPPING
        + " supervisor/link/client supervisor/incident supervisor/swap supervisor/bus host/read",
        "supervisor/run": SWAPPING
        + " supervisor/incident supervisor/swap supervisor/serve supervisor/bus/plan host/read host/tune",
        "supervisor/cli/core": CLI,
        "supervisor/cli/robot": CLI + " supervisor/events supervisor/incident supervisor/cli/core",
        "supervisor/cli/laws": CLI + " supervisor/link/services supervisor/swap/certificate supervisor/cli/core",
        "supervisor/cli/buses": CLI + " supervisor/cli/core",
        "supervisor/cli/host": CLI + HOST + " supervisor/cli/core",
        "supervisor/cli/parse": CLI + " supervisor/run supervisor/cli/core",
        "supervisor/cli": CLI + " supervisor/cli/core supervisor/cli/parse",
        "firmware": "",
    }.items()
}
# Tests and benchmarks may include any room: rooms of their own, and the folders `test/`, which only tests may include.
FREE = ("tests", "bench")
LAW_STANDARD = {"cmath", "array", "algorithm", "span", "numbers", "type_traits", "cstddef", "cstdint", "limits"}
LAW_HEADERS = frozenset({"lithe/law.hpp", *LAW_STANDARD})
BRAIN_MODULES = frozenset({"numpy", "matplotlib", "lithe"})  # beside the standard library
ENTRY = re.compile(r"^( *)((?:[\w.]+/? +)+)[■◧□] (.*)")  # of a map: names, when it runs, what it is
INCLUDE = re.compile(r'^\s*#\s*include\s*(?:"([^"]+)"|<([^>]+)>)')


def is_rig(path: str) -> bool:
    """Whether this is in a folder `test/`: what several tests share, and tests of more than one file."""
    return "/test/" in path


def room_of(path: str) -> str | None:
    """The most specific room that holds this path (from the repo root), or None when it is in no room."""
    rooms = [room for room in (*ALLOWED, *FREE) if path.startswith(room + "/")]
    return max(rooms, key=len, default=None)


def included(line: str) -> str | None:
    """The path from the repo root that a line includes, or None when it includes nothing of ours."""
    match = INCLUDE.match(line)
    if not match:
        return None
    quoted, angled = match.groups()
    if (quoted or angled).startswith("lithe/"):
        return "spine/law/include/" + (quoted or angled)  # what a law sees as <lithe/...>
    return str(quoted) if quoted else None


def check_cpp(path: str, text: str) -> Iterator[str]:
    """What is wrong with the includes of one C++ file."""
    room = room_of(path)
    for number, line in enumerate(text.splitlines(), 1):
        where = f"{path}:{number}: "
        match = INCLUDE.match(line)
        angled = match[2] if match else None
        foreign = angled is not None and angled not in LAW_HEADERS and not angled.startswith("Eigen/")
        if room == "laws" and foreign and not path.endswith("_test.cpp"):
            yield where + f"a law may not include <{angled}>; it has {', '.join(sorted(LAW_HEADERS))}, Eigen"
        target = included(line)
        if target is None or room is None:
            continue
        inner = target.endswith("main.cpp") or target.startswith("supervisor/cli/")
        if inner and not room.startswith("supervisor/cli"):
            yield where + f"nothing includes main or cli, but {room} includes {target}"
            continue
        other = room_of(target)
        free = is_rig(path) or room in FREE
        if other is None:
            yield where + f'"{target}" is not a path from the repo root into a room'
        elif is_rig(target):
            if not free and not path.endswith("_test.cpp"):
                yield where + f"only tests may include {target}"
        elif not free and other != room and ALLOWED[room].isdisjoint({other, other.removesuffix("/include")}):
            yield where + f"{room} may not include {other} ({target})"


def check_python(path: str, text: str) -> Iterator[str]:
    """The Brain runs on the standard library and numpy; what else it imports must be optional, inside a function."""
    for node in ast.parse(text, path).body:
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [node.module or ""]
        for name in names:
            top = name.split(".")[0]
            if top not in BRAIN_MODULES and top not in sys.stdlib_module_names:
                yield f"{path}:{node.lineno}: brain may not import {top}; it has the standard library and numpy"


def map_entries(text: str) -> Iterator[tuple[int, str, str]]:
    """Each folder or file of a page's map: number of its line, path from the root, and what is said of it."""
    found: list[tuple[int, str, str]] = []
    above: dict[int, str] = {}  # by indentation
    open_entries = 0
    for number, line in enumerate(text.splitlines(), 1):
        if match := ENTRY.match(line):
            indent = len(match[1])
            folder = above.get(max((each for each in above if each < indent), default=-1), "")
            paths = [folder + name for name in match[2].split()]
            above = {each: path for each, path in above.items() if each < indent} | {indent: paths[-1]}
            found += [(number, path, match[3]) for path in paths]
            open_entries = len(paths)
        elif open_entries and line.startswith("  ") and line.strip():  # goes on with what is said of the last ones
            found[-open_entries:] = [(at, path, f"{said} {line}") for at, path, said in found[-open_entries:]]
        else:
            open_entries = 0
    yield from found


def check_map(page: str, text: str, root: Path) -> Iterator[str]:
    """What a page's map names and the tree lacks, and folders at the top that it does not name."""
    entries = list(map_entries(text))
    for number, path, said in entries:
        if not (root / path).exists():
            yield f"{page}:{number}: there is no {path}"
        for name in re.findall(r"(?<![\w/`])([\w/]+)/(?![\w*])", said):
            if "/" not in path or not (any((root / path).glob(f"**/{name}")) or (root / name).exists()):
                yield f"{page}:{number}: there is no {name}/ in {path}"
    tops = {path.split("/")[0] for path in lint.tracked(root) if "/" in path and path[0] != "."}
    for top in sorted(tops - {path.split("/")[0] for _, path, _ in entries}):
        yield f"{page}: the map lacks {top}/"


def check_rooms_named(page: str, text: str) -> Iterator[str]:
    """Rooms that the map does not name. Kinds of buses are folders of bus/, all alike."""
    entries = [(0, "", ""), *map_entries(text)]
    for room in sorted(ALLOWED.keys() - set(BUS_KINDS) - {"spine/law/include"}):
        inner = max((len(path), number, path, said) for number, path, said in entries if f"{room}/".startswith(path))
        if f"{room}/" != inner[2] and not re.search(rf"\b{room.split('/')[-1]}\b", inner[3]):
            yield f"{page}:{inner[1]}: the map lacks {room}/"


def map_edges(text: str) -> Iterator[tuple[int, str, str]]:
    """What the short form says: number of the line, a room, and one that includes it. Names are below `base:` at the
    beginning of a line, else below spine/; KIND stands for each kind of device, BUS for each kind of bus."""
    base = ""
    for number, line in enumerate(text.splitlines(), 1):
        if " <- " not in line or "`" in line:
            continue
        if head := re.match(r"(?:(\w+):)?\S*", line):
            base = head[1] or ("" if head[0] else base)
        for chain in re.split(r" {2,}", line.removeprefix(f"{base}:").strip()):
            for lower, upper in pairwise(step.split(", ") for step in chain.split(" <- ")):
                for pair in product(lower, upper):
                    for kind in KINDS if "KIND" in "".join(pair) else BUS_KINDS:
                        names = [re.sub("KIND|BUS", kind.rsplit("/", 1)[1], name) for name in pair]
                        places = [[f"{base}/{name}", f"spine/{base}/{name}", f"spine/{name}", name] for name in names]
                        rooms = [next((place for place in each if place in ALLOWED), each[-1]) for each in places]
                        yield number, rooms[0], rooms[1]


def check_short_form(page: str, text: str) -> Iterator[str]:
    """The short form says nothing that the table forbids, and what the table allows follows from it."""
    below: dict[str, set[str]] = {room: set() for room in ALLOWED}
    for number, lower, upper in dict.fromkeys(map_edges(text)):
        if lower not in ALLOWED.get(upper, ()) and lower.removesuffix("/include") not in ALLOWED.get(upper, ()):
            yield f"{page}:{number}: {upper} may not include {lower}, says tools/rooms.py"
        else:
            below[upper].add(lower)

    def reached(room: str) -> set[str]:
        return below[room].union(*(reached(each) for each in below[room]))

    for room, allowed in ALLOWED.items():
        if missing := allowed - reached(room):
            yield f"{page}: the short form does not tell that {room} may include {', '.join(sorted(missing))}"


def check_way(root: Path, listed: list[str], names: str = ON_THE_WAY) -> Iterator[str]:
    """The list of files from text to tick has each file that defines a name of ON_THE_WAY, and no other."""
    text = {path: (root / path).read_text() for path in paper.robot_sources(root)}
    known: set[str] = set()
    for name in names.split():
        defined = re.compile(rf"^(?:\S[^;\n]*\b{name}\([^;{{]*|class {name} )\{{", re.MULTILINE)
        files = [path for path in text if defined.search(text[path])]
        there = {each for each in listed for path in files if path in (each, f"supervisor/{each}")}
        if not there:
            yield f"{WAY_PAGE}: '{WAY}' lacks the file that defines {name}: {', '.join(files) or 'none does'}"
        known |= there
    yield from (f"{WAY_PAGE}: {path} defines nothing of ON_THE_WAY" for path in listed if path not in known)


def check_test_names(paths: list[str]) -> Iterator[str]:
    """Tests beside the sources that are not named after a unit there, and rigs that are not in a folder test/."""
    for path in paths:
        if path.startswith(FREE) or is_rig(path):
            continue
        unit = path.removesuffix("_test.cpp")
        if unit != path and not {f"{unit}.cpp", f"{unit}.hpp"} & set(paths):
            yield f"{path}: there is no {unit}.cpp or .hpp: name the test after its unit, or move it to a folder test/"
        if path.endswith(("_rig.cpp", "_rig.hpp")):
            yield f"{path}: what only tests use belongs in a folder test/"


def check_tree(root: Path) -> list[str]:
    """Every broken rule under root."""
    problems: list[str] = []
    for top in sorted({room.split("/")[0] for room in (*ALLOWED, *FREE)}):
        for file in sorted((root / top).rglob("*.[ch]pp")):
            problems += check_cpp(str(file.relative_to(root)), file.read_text())
    for file in sorted((root / "brain/lithe").rglob("*.py")):
        problems += check_python(str(file.relative_to(root)), file.read_text())
    for page in ("README.md", "ARCHITECTURE.md"):
        problems += check_map(page, (root / page).read_text(), root)
    problems += check_rooms_named(page, (root / page).read_text())
    problems += check_short_form(page, (root / page).read_text())
    problems += check_test_names(lint.tracked(root))
    problems += check_way(root, paper.paths_in(root / WAY_PAGE, WAY))
    return problems


if __name__ == "__main__":
    found = check_tree(Path(__file__).parent.parent)
    print("\n".join(found), end="\n" if found else "")
    sys.exit(1 if found else 0)
