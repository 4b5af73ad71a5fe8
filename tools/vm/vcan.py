# SPDX-License-Identifier: Apache-2.0
"""Runs our SocketCAN bus, and a whole robot, on real CAN interfaces: a Debian kernel with `vcan`, booted under QEMU.

    python tools/vm/vcan.py            exit 0 passed, 1 failed, 77 skipped: the reason is printed
    python tools/vm/vcan.py --fetch    first get the kernel: 70 MB into build/vcan, nothing is installed

The machine is emulated (-accel tcg): /dev/kvm may exist and hang. It shows what works, never how fast.
"""

import argparse
import lzma
import os
import platform
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CACHE = ROOT / "build/vcan"
BIN = Path(os.environ.get("LITHE_BIN_DIR", ROOT / "build/release/bin"))
PROGRAM = BIN / "hal_bus_socketcan_tests"
LITHE = ("lithe", "lithe-sim", "lithe-spine", "lithe-spine-sim", "lithe-trial", "lawd")
STEPS = Path(__file__).with_name("steps.sh")  # the words of such scripts
ROBOT_SCRIPT = Path(__file__).with_name("vcan_robot.sh")
REFUSED = {"scan-less": 1, "scan-wrong": 1, "scan-beside": 1}  # steps of it that end with another code than 0
QEMU = "qemu-system-x86_64"
MODULES = ("can-raw", "vcan")
APPLETS = ("cat", "grep", "insmod", "ip", "mkdir", "mount", "poweroff", "seq", "sh", "sleep", "touch")
TIMEOUT_S = 600  # it takes a minute; a loaded machine may take its time
SKIPPED = 77
VERDICT = re.compile(r"vcan: the program ended with (\d+)")
INIT = """#!/bin/sh
mount -t proc none /proc
mount -t sysfs none /sys
mount -t devtmpfs none /dev
mkdir /dev/shm
for module in {modules}; do insmod /modules/$module.ko || echo "vcan: no $module"; done
ip link add dev vcan0 type vcan && ip link set vcan0 up
LITHE_CAN_INTERFACE=vcan0 {program} --gtest_color=no
echo "vcan: the program ended with $?"
if [ -e /robot.sh ]; then . /robot.sh; fi
poweroff -f
"""


@dataclass(frozen=True)
class Cargo:
    """What a machine is booted for."""

    program: Path  # its verdict is the boot's
    beside: tuple[Path, ...] = ()  # more programs
    files: dict[str, bytes] = field(default_factory=dict)  # "robot.sh" runs after the program
    cores: int = 2
    options: str = ""  # for the kernel


@dataclass(frozen=True)
class Step:
    """What a script in the machine did between `vcan: begin NAME` and `vcan: end NAME CODE`."""

    code: int
    text: str


@dataclass(frozen=True)
class Kernel:
    """An unpacked kernel package."""

    image: Path
    modules: dict[str, Path]  # by name, as in `lsmod` but with the file's dashes

    def with_needed(self, names: tuple[str, ...]) -> list[str]:
        """These modules and those they need, in the order of loading."""
        ordered: list[str] = []
        for name in names:
            for needed in [*self.with_needed(needs(self.modules[name])), name]:
                if needed not in ordered:
                    ordered.append(needed)
        return ordered


def code(module: Path) -> bytes:
    """A module as the kernel loads it: newer packages carry them compressed."""
    stored = module.read_bytes()
    return lzma.decompress(stored) if module.suffix == ".xz" else stored


def needs(module: Path) -> tuple[str, ...]:
    """What a module says it depends on."""
    match = re.search(rb"\0depends=([^\0]*)\0", code(module))
    return tuple(name for name in (match[1].decode() if match else "").split(",") if name)


def version(image: Path) -> list[int]:
    """The numbers in a kernel's name, to tell the newer one."""
    return [int(number) for number in re.findall(r"\d+", image.name)]


def find_kernel(cache: Path) -> Kernel | None:
    """The newest kernel in the cache."""
    for image in sorted(cache.glob("*/boot/vmlinuz-*"), key=version, reverse=True):
        folder = image.parent.parent
        # Debian 12 has them under lib, later ones under usr/lib.
        files = [file for top in ("", "usr/") for file in folder.glob(f"{top}lib/modules/*/kernel/**/*.ko*")]
        modules = {file.name.split(".")[0]: file for file in files if file.suffix in (".ko", ".xz")}
        # A module names another one with underscores, its file may have dashes.
        modules.update({name.replace("-", "_"): file for name, file in modules.items()})
        if all(name in modules for name in MODULES):
            return Kernel(image, modules)
    return None


def robot_cargo(program: Path = PROGRAM) -> Cargo:
    """A program, and a robot beside it."""
    return Cargo(program, tuple(BIN / name for name in LITHE), robot_files())


def fetch(cache: Path) -> None:
    """Download Debian's current kernel package and unpack what is needed of it."""
    names = subprocess.run(["apt-cache", "depends", "linux-image-amd64"], capture_output=True, text=True, check=True)
    match = re.search(r"Depends: (linux-image-\S+)", names.stdout)
    if not match:
        sys.exit("vcan: apt knows no linux-image-amd64; sudo apt-get update")
    cache.mkdir(parents=True, exist_ok=True)
    print(f"vcan: downloading {match[1]}", flush=True)
    subprocess.run(["apt-get", "-qq", "download", match[1]], cwd=cache, check=True)
    for package in cache.glob("*.deb"):
        subprocess.run(["dpkg-deb", "-x", package, cache / match[1]], check=True)
        package.unlink()


def changed(text: str, changes: dict[str, str]) -> str:
    """A robot file's text with all of these changes; each finds something to change."""
    for old, new in changes.items():
        if old not in text:
            sys.exit(f"vcan: the robot file no longer says: {old}")
        text = text.replace(old, new)
    return text


def without(text: str, *names: str) -> str:
    """A robot file's text without the parts of these names."""
    parts = re.split(r"(?m)^(?=\[\[)", text)
    return "".join(part for part in parts if not any(f'\nname = "{name}"\n' in part for name in names))


def script(path: Path) -> bytes:
    """What the machine runs after the program: it can use the words of STEPS."""
    return STEPS.read_bytes() + path.read_bytes()


def robot_files() -> dict[str, bytes]:
    """Frankenstein on three CAN interfaces, patient with an emulated machine; with a part less; with a wrong id."""
    socketcan = 'name = "can{}"\nkind = "socketcan"\ninterface = "vcan{}"\nreply_wait_s = 0.009'
    buses = {f'name = "can{i}"\nkind = "loop"': socketcan.format(i, i + 1) for i in range(3)}
    patience = {
        'law = "../laws/pd.cpp"': '[spine]\nrelease = "sleep"\nlate_ticks_to_stop = 10000\n'
        "[guard]\nlost_after_misses = 100",
        "rate_hz = 1000": "rate_hz = 100",
        "watchdog_s = 0.2": "watchdog_s = 10.0",
    }
    robot = changed((ROOT / "robots/frankenstein.toml").read_text(), buses | patience)
    # Higher gains of the safe law would shake it at this rate.
    robot = re.sub(r"(?m)^safe_kp_nm_rad = \S+", "safe_kp_nm_rad = 0.04", robot)
    robot = robot.replace("safe_kd_nm_s_rad = 0.04", "safe_kd_nm_s_rad = 0.02")
    less = without(robot, "hand_drive", "hand")
    wrong = changed(robot, {'bus = "can0"\nid = 3\n': 'bus = "can0"\nid = 9\n'})
    files = {"robot.toml": robot, "less.toml": less, "wrong.toml": wrong}
    return {name: text.encode() for name, text in files.items()} | {"robot.sh": script(ROBOT_SCRIPT)}


def why_not(cache: Path = CACHE, program: Path = PROGRAM) -> str:
    """What is missing, and the command that brings it; empty when it can run."""
    if platform.machine() != "x86_64":
        return f"the emulated machine is an x86-64, this one a {platform.machine()}"
    for tool, package in ((QEMU, "qemu-system-x86"), ("busybox", "busybox-static")):
        if shutil.which(tool) is None:
            return f"no {tool}: tools/setup vcan (Debian's {package})"
    if find_kernel(cache) is None:
        return "no kernel: python tools/vm/vcan.py --fetch"
    for each in (program, *(BIN / name for name in LITHE)):
        if not each.exists():
            return f"no {each.name}: make test builds it"
    return ""


def libraries(program: Path) -> list[Path]:
    """The shared libraries that a program loads, and its loader."""
    said = subprocess.run(["ldd", program], capture_output=True, text=True, check=True).stdout
    return [Path(path) for path in re.findall(r"(/\S+) \(0x", said)]


def entry(name: str, content: bytes, mode: int) -> bytes:
    """One file of an archive that the kernel unpacks (the `newc` format of cpio)."""
    # magic, inode, mode, owner, group, links, time, size, 4 device numbers, length of the name, checksum
    fields = (0, mode, 0, 0, 1, 0, len(content), 0, 0, 0, 0, len(name) + 1, 0)
    head = b"070701" + b"".join(b"%08X" % field for field in fields) + name.encode() + b"\0"
    return b"".join(part + bytes(-len(part) % 4) for part in (head, content))


def initramfs(kernel: Kernel, cargo: Cargo) -> bytes:
    """All that the machine knows: busybox, the modules, the programs with their libraries, the files."""

    def files() -> Iterator[tuple[str, bytes, int]]:
        executable = stat.S_IFREG | 0o755
        loaded = kernel.with_needed(MODULES)
        busybox = Path(shutil.which("busybox") or "busybox")
        for applet in APPLETS:
            yield f"bin/{applet}", b"/bin/busybox", stat.S_IFLNK | 0o777
        yield "bin/busybox", busybox.read_bytes(), executable
        programs = (cargo.program, *cargo.beside)
        for program in programs:
            yield f"bin/{program.name}", program.read_bytes(), executable
        for library in sorted({library for program in programs for library in libraries(program)}):
            yield str(library)[1:], library.read_bytes(), executable
        for name, content in cargo.files.items():
            yield name, content, executable
        for module in loaded:
            yield f"modules/{module}.ko", code(kernel.modules[module]), executable
        yield "init", INIT.format(modules=" ".join(loaded), program=f"/bin/{cargo.program.name}").encode(), executable

    directories = {"dev", "proc", "run", "sys", "tmp"}
    contents = list(files())
    for name, _, _ in contents:
        directories.update(str(parent) for parent in Path(name).parents if str(parent) != ".")
    archive = b"".join(entry(name, b"", stat.S_IFDIR | 0o755) for name in sorted(directories))
    return archive + b"".join(entry(*file) for file in contents) + entry("TRAILER!!!", b"", 0)


def boot(kernel: Kernel, cargo: Cargo, cache: Path) -> tuple[int | None, str]:
    """How the program ended in the machine (None: it never did), and all that the machine said."""
    archive = cache / f"initramfs.{os.getpid()}"
    archive.write_bytes(initramfs(kernel, cargo))
    command = [QEMU, *f"-accel tcg -smp {cargo.cores} -m 1024 -nographic -no-reboot -nic none".split()]
    options = f"console=ttyS0 quiet panic=-1 {cargo.options}"
    command += ["-kernel", str(kernel.image), "-initrd", str(archive), "-append", options]
    try:
        ended = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=TIMEOUT_S, check=False)
        said = (ended.stdout + ended.stderr).decode(errors="replace")
    except subprocess.TimeoutExpired as late:
        said = (late.stdout or b"").decode(errors="replace") + f"\nvcan: not done after {TIMEOUT_S} s\n"
    finally:
        archive.unlink()
    verdict = VERDICT.search(said)
    return int(verdict[1]) if verdict else None, said


def steps(said: str) -> dict[str, Step]:
    """What the script in the machine did, by name."""
    found = re.findall(r"(?ms)^vcan: begin (\S+)$(.*?)^vcan: end \1 (\d+)$", said.replace("\r", ""))
    return {name: Step(int(code), text) for name, text, code in found}


def wrong_steps(said: str, path: Path = ROBOT_SCRIPT, refused: Mapping[str, int] = REFUSED) -> list[str]:
    """The script's steps that did not end as they must, or never did."""
    ended = steps(said)
    names = re.findall(r"(?m)^step (\S+)", path.read_text())
    return [name for name in names if name not in ended or ended[name].code != refused.get(name, 0)]


def main() -> int:
    """Get what is asked for, boot, tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fetch", action="store_true", help="download the kernel if it is not there yet")
    parser.add_argument("--program", type=Path, default=PROGRAM, help="what to run there")
    args = parser.parse_args()
    if args.fetch and find_kernel(CACHE) is None:
        fetch(CACHE)
        if find_kernel(CACHE) is None:
            print(f"vcan: no kernel with the modules {', '.join(MODULES)} in what came; see {CACHE}", file=sys.stderr)
            return 1
    reason = why_not(CACHE, args.program)
    kernel = find_kernel(CACHE)
    if reason or kernel is None:
        print(f"vcan: skipped: {reason}")
        return SKIPPED
    status, said = boot(kernel, robot_cargo(args.program), CACHE)
    print(said)
    if wrong := wrong_steps(said):
        print(f"vcan: not as it must be: {', '.join(wrong)}")
    return 0 if status == 0 and not wrong else 1


if __name__ == "__main__":
    sys.exit(main())
