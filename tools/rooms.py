# SPDX-License-Identifier: Apache-2.0
"""Who may include whom: the architecture as one table, held against every #include and import in the tree."""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

# room -> rooms it may include (itself is always allowed). The most specific room that holds a file wins.
BASE = "spine/core spine/wire"
OUTSIDE = BASE + " spine/ipc spine/law spine/robot spine/robot/read"  # what the processes beside the Spine may know
HAL = Path(__file__).parent.parent / "spine/hal"
# A kind of bus: a folder of spine/hal/bus. A kind of device: a folder of spine/hal with a folder sim/; what only it has
# in a robot file is read in its folder keys/ (docs/adr/0023). A new one needs no line here.
BUS = "spine/hal/core spine/hal/bus/loop spine/hal/bus/serial"
BUS_KINDS = sorted(
    f"spine/hal/bus/{folder.name}"
    for folder in (HAL / "bus").iterdir()
    if folder.is_dir() and folder.name not in ("loop", "serial", "test")
)
BUSES = f"{BUS} {' '.join(BUS_KINDS)}"
KINDS = sorted(f"spine/hal/{folder.parent.name}" for folder in HAL.glob("*/sim"))
KEYS = sorted(f"spine/hal/{folder.parent.name}/keys" for folder in HAL.glob("*/keys"))
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
        "spine/robot": "spine/core spine/robot/read " + " ".join(KEYS),
        "spine/plan": BASE + " spine/robot",
        "spine/guard": BASE + " spine/law/include spine/robot",
        "spine/hal/core": BASE,
        "spine/hal/bus/loop": BASE + " spine/hal/core",
        "spine/hal/bus/serial": BASE + " spine/hal/core spine/hal/bus/loop",
        **dict.fromkeys(BUS_KINDS, f"{BASE} {BUS}"),
        "spine/hal/canopen": BASE + " spine/hal/core",
        **{kind: f"{DEVICE} {kind}/keys" if f"{kind}/keys" in KEYS else DEVICE for kind in KINDS},
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
        "supervisor/link/spine": OUTSIDE + " supervisor/core",
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


def check_tree(root: Path) -> list[str]:
    """Every broken rule under root."""
    problems: list[str] = []
    for top in sorted({room.split("/")[0] for room in (*ALLOWED, *FREE)}):
        for file in sorted((root / top).rglob("*.[ch]pp")):
            problems += check_cpp(str(file.relative_to(root)), file.read_text())
    for file in sorted((root / "brain/lithe").rglob("*.py")):
        problems += check_python(str(file.relative_to(root)), file.read_text())
    return problems


if __name__ == "__main__":
    found = check_tree(Path(__file__).parent.parent)
    print("\n".join(found), end="\n" if found else "")
    sys.exit(1 if found else 0)
