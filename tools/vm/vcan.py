# SPDX-License-Identifier: Apache-2.0
"""Runs our SocketCAN bus, and a whole robot, on real CAN interfaces: a Debian kernel with `vcan`, booted under QEMU.

python tools/vm/vcan.py            exit 0 passed, 1 failed, 77 skipped: the reason is printed
python tools/vm/vcan.py --fetch    first get the kernel: 70 MB into build/vcan, nothing is installed
"""

import argparse
import platform
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from vm import debian, machine
from vm.machine import BIN, LITHE, ROOT, SKIPPED, Cargo, changed

CACHE = ROOT / "build/vcan"
SCRIPT = Path(__file__).with_name("vcan.sh")
PROGRAM = BIN / "hal_bus_socketcan_tests"
REFUSED = {"scan-less": 1, "scan-wrong": 1, "scan-beside": 1}  # steps that end with another code than 0
MODULES = ("can-raw", "vcan")


def find_kernel(cache: Path = CACHE) -> machine.Kernel | None:
    """The newest kernel in the cache that has CAN."""
    return machine.find_kernel(cache, MODULES)


def without(text: str, *names: str) -> str:
    """A robot file's text without the parts of these names."""
    parts = re.split(r"(?m)^(?=\[\[)", text)
    return "".join(part for part in parts if not any(f'\nname = "{name}"\n' in part for name in names))


def robot_files() -> dict[str, bytes]:
    """Frankenstein on three CAN interfaces, patient with an emulated machine; with a part less; with a wrong id."""
    socketcan = 'name = "can{}"\nkind = "socketcan"\ninterface = "vcan{}"\nreply_wait_s = 0.009'
    buses = {f'name = "can{i}"\nkind = "loop"': socketcan.format(i, i + 1) for i in range(3)}
    patience = {
        'law = "../laws/pd.cpp"': '[spine]\nrelease = "sleep"\nlate_ticks_to_stop = 10000\n'
        "[guard]\nlost_after_misses = 100",
        "rate_hz = 1000": "rate_hz = 250",
        "watchdog_s = 0.2": "watchdog_s = 10.0",
    }
    robot = changed((ROOT / "robots/frankenstein.toml").read_text(), buses | patience)
    # At this rate the safe law would shake lighter joints. Slower ones are refused: these drives are too strong for it.
    robot = robot.replace("safe_kd_nm_s_rad = 0.04", "safe_kd_nm_s_rad = 0.1")
    for light in ("inertia_kg_m2 = 6.0e-4", "inertia_kg_m2 = 2.55e-3"):
        robot = robot.replace(light, "inertia_kg_m2 = 1.0e-2")
    for light in ("7.5e-4\ninertia_min_kg_m2 = 4.8e-4", "3.2e-3\ninertia_min_kg_m2 = 2.0e-3"):
        robot = robot.replace(f"inertia_max_kg_m2 = {light}", "inertia_max_kg_m2 = 1.3e-2\ninertia_min_kg_m2 = 8.0e-3")
    less = without(robot, "hand_drive", "hand")
    wrong = changed(robot, {'bus = "can0"\nid = 3\n': 'bus = "can0"\nid = 9\n'})
    files = {"robot.toml": robot, "less.toml": less, "wrong.toml": wrong}
    return {name: text.encode() for name, text in files.items()}


def cargo() -> Cargo:
    """The tests of the bus, and a robot."""
    return Cargo(SCRIPT, (PROGRAM, *(BIN / name for name in LITHE)), robot_files(), MODULES)


def why_not(cache: Path = CACHE, program: Path = PROGRAM) -> str:
    """What is missing, and the command that brings it; empty when it can run."""
    if platform.machine() != "x86_64":
        return f"the emulated machine is an x86-64, this one a {platform.machine()}"
    if lacking := machine.missing_tools():
        return f"no {', '.join(lacking)}: tools/setup vcan"
    if find_kernel(cache) is None:
        return "no kernel: python tools/vm/vcan.py --fetch"
    for each in (program, *(BIN / name for name in LITHE)):
        if not each.exists():
            return f"no {each.name}: make test builds it"
    return ""


def main() -> int:
    """Get what is asked for, boot, tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fetch", action="store_true", help="download the kernel if it is not there yet")
    args = parser.parse_args()
    if args.fetch and find_kernel() is None:
        try:
            debian.get_kernel("linux-image-amd64", "amd64", CACHE)
        except debian.Trouble as trouble:
            print(f"vcan: {trouble}", file=sys.stderr)
            return 1
        if find_kernel() is None:
            print(f"vcan: no kernel with the modules {', '.join(MODULES)} in what came; see {CACHE}", file=sys.stderr)
            return 1
    reason = why_not()
    kernel = find_kernel()
    if reason or kernel is None:
        print(f"vcan: skipped: {reason}")
        return SKIPPED
    said = machine.boot(kernel, cargo(), CACHE)
    print(said)
    if wrong := machine.wrong_steps(said, SCRIPT, REFUSED):
        print(f"vcan: not as it must be: {', '.join(wrong)}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
