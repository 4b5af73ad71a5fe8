# SPDX-License-Identifier: Apache-2.0
"""Who may include whom: the architecture as one table, held against every #include and import in the tree."""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

# room -> rooms it may include (itself is always allowed). The most specific room that holds a file wins.
SPINE = (
    "spine/core spine/wire spine/ipc spine/law spine/plan spine/guard spine/robot spine/hal spine/contain spine/arena "
    "spine/loop spine/load"
)
OUTSIDE = "spine/core spine/wire spine/ipc spine/law spine/robot"  # what the processes beside the Spine may know
ALLOWED = {
    room: frozenset(allowed.split())
    for room, allowed in {
        "spine/core": "",
        "spine/wire": "spine/core",
        "spine/ipc": "spine/core spine/wire",
        "spine/law": "spine/core spine/wire",
        "spine/robot": "spine/core",
        "spine/plan": "spine/core spine/wire spine/robot",
        "spine/guard": "spine/core spine/wire spine/robot",
        "spine/hal/bus": "spine/core spine/wire",
        "spine/hal/device": "spine/core spine/wire spine/hal spine/hal/bus",
        "spine/hal/sim": "spine/core spine/wire spine/robot spine/hal spine/hal/bus spine/hal/device",
        "spine/hal": "spine/core spine/wire spine/robot spine/hal/bus spine/hal/device spine/hal/sim",
        "spine/contain": "spine/core spine/wire",
        "spine/arena": "spine/core",
        "spine/load": "spine/core spine/wire spine/ipc spine/law spine/arena spine/contain",
        "spine/loop": "spine/core spine/wire spine/ipc spine/law spine/plan spine/guard spine/robot spine/hal "
        "spine/contain",
        "spine": SPINE,
        "lawd": "spine/core spine/wire spine/ipc spine/law spine/arena",
        "trial": "spine/core spine/wire spine/ipc spine/law spine/arena spine/load spine/robot spine/plan spine/guard "
        "spine/hal spine/hal/sim",
        "sim": "spine/core spine/robot spine/hal spine/hal/bus spine/hal/sim",
        "laws": "spine/law",
        "supervisor/bus": "spine/core spine/wire spine/robot spine/hal/bus spine/hal/device",
        "supervisor/field": "spine/core spine/wire spine/robot spine/hal spine/hal/bus spine/hal/device spine/hal/sim "
        "supervisor/bus",
        "supervisor/control": OUTSIDE + " spine/arena supervisor/swap supervisor/bus supervisor/host supervisor/record",
        "supervisor/swap": OUTSIDE,
        "supervisor/host": OUTSIDE,
        "supervisor/record": OUTSIDE,
        "supervisor/cli": OUTSIDE
        + " supervisor/control supervisor/swap supervisor/bus supervisor/field supervisor/host supervisor/record",
        "supervisor": OUTSIDE
        + " supervisor/cli supervisor/control supervisor/swap supervisor/bus supervisor/host supervisor/record",
        "tests": SPINE
        + " spine/hal/bus spine/hal/device spine/hal/sim lawd trial laws sim supervisor/control supervisor/swap"
        + " firmware",
        "firmware": "",
        "bench": SPINE + " spine/hal/bus spine/hal/device spine/hal/sim",
    }.items()
}
LAW_STANDARD = {"cmath", "array", "algorithm", "span", "numbers", "type_traits", "cstddef", "cstdint", "limits"}
LAW_HEADERS = frozenset({"lithe/law.hpp", *LAW_STANDARD})
BRAIN_MODULES = frozenset({"numpy", "matplotlib", "lithe"})  # beside the standard library
INCLUDE = re.compile(r'^\s*#\s*include\s*(?:"([^"]+)"|<([^>]+)>)')


def room_of(path: str) -> str | None:
    """The most specific room that holds this path (from the repo root), or None when it is in no room."""
    rooms = [room for room in ALLOWED if path.startswith(room + "/")]
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
        if target.endswith("main.cpp") or target.startswith("supervisor/cli/"):
            if room != "supervisor/cli" and not (room == "supervisor" and path.endswith("main.cpp")):
                yield where + f"nothing includes main or cli, but {room} includes {target}"
            continue
        other = room_of(target)
        if other is None:
            yield where + f'"{target}" is not a path from the repo root into a room'
        elif other != room and other not in ALLOWED[room]:
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


def check_tree(root: Path) -> list[str]:
    """Every broken rule under root."""
    problems: list[str] = []
    for top in sorted({room.split("/")[0] for room in ALLOWED}):
        for file in sorted((root / top).rglob("*.[ch]pp")):
            problems += check_cpp(str(file.relative_to(root)), file.read_text())
    for file in sorted((root / "brain/lithe").rglob("*.py")):
        problems += check_python(str(file.relative_to(root)), file.read_text())
    return problems


if __name__ == "__main__":
    found = check_tree(Path(__file__).parent.parent)
    print("\n".join(found), end="\n" if found else "")
    sys.exit(1 if found else 0)
