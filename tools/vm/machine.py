# SPDX-License-Identifier: Apache-2.0
"""Boots a Debian kernel in QEMU with programs of ours, runs a script there, and tells how each of its steps ended.

The machine is emulated (-accel tcg): /dev/kvm may exist and hang. It shows what works, never how fast.
"""

import contextlib
import lzma
import os
import re
import shutil
import stat
import subprocess
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(os.environ.get("LITHE_BIN_DIR", ROOT / "build/release/bin"))
LITHE = ("lithe", "lithe-sim", "lithe-spine", "lithe-spine-sim", "lithe-trial", "lawd")
STEPS = Path(__file__).with_name("steps.sh")  # the words of such scripts
SKIPPED = 77
APPLETS = (
    "cat", "cp", "dirname", "echo", "find", "grep", "insmod", "ip", "ln", "ls", "md5sum", "mkdir", "mount", "poweroff",
    "rm", "sed", "seq", "sh", "sleep", "sort", "stat", "taskset", "touch", "tr", "uname", "wc", "xargs",
)  # fmt: skip
# Where things are in the machine: a Debian system may be in front of ours, and its /bin and /lib are links.
HOME, TOOLS = "lithe", "lab"
INIT = f"""#!/{TOOLS}/sh
export PATH=/{HOME}/bin:/usr/sbin:/usr/bin:/sbin:/bin:/{TOOLS} HOME=/tmp
mount -t proc none /proc
mount -t sysfs none /sys
mount -t devtmpfs none /dev
mkdir -p /dev/shm
ln -s /proc/self/fd /dev/fd
mount -t tmpfs none /dev/shm
echo "vm: up" # on the line on which the firmware has left off
ip link set lo up
for module in {{modules}}; do insmod /{TOOLS}/$module.ko || echo "vm: no $module"; done
# At first the kernel still measures the counter of the processor: two readers would see two clock sources.
clock=/sys/devices/system/clocksource/clocksource0/current_clocksource
for try in $(seq 50); do grep -q early $clock || break; sleep 0.1; done
. /{TOOLS}/steps.sh
. /{TOOLS}/script.sh
poweroff -f
"""


@dataclass(frozen=True)
class Architecture:
    """What differs between machines."""

    debian: str  # its name there
    qemu: str
    package: str  # that has this program
    words: str  # which machine it shall emulate
    console: str


# In an `iretq` of a program, QEMU 7.2 reads the stack with the kernel's rights, which SMAP forbids. LITHE has such an
# instruction.
AMD64 = Architecture("amd64", "qemu-system-x86_64", "qemu-system-x86", "-cpu max,smap=off", "ttyS0")
ARM64 = Architecture("arm64", "qemu-system-aarch64", "qemu-system-arm", "-M virt -cpu cortex-a72", "ttyAMA0")


@dataclass(frozen=True)
class Cargo:
    """What a machine is booted for."""

    script: Path  # what runs there; it has the words of STEPS
    programs: tuple[Path, ...] = ()  # in its PATH
    files: Mapping[str, bytes] = field(default_factory=dict)  # by their place, without the first /
    modules: tuple[str, ...] = ()
    system: Path | None = None  # the archive of a whole Debian system; without it there is busybox only
    architecture: Architecture = AMD64
    cores: int = 2
    spine_core: int | None = None  # emulated on a core of this computer that no other of its cores uses, if it has two
    memory_mib: int = 1024
    options: str = ""  # for the kernel
    timeout_s: int = 600  # it takes a minute; a loaded machine may take its time


@dataclass(frozen=True)
class Step:
    """What a script in the machine did between `vm: begin NAME` and `vm: end NAME CODE`."""

    code: int
    text: str


@dataclass(frozen=True)
class Kernel:
    """An unpacked kernel package."""

    image: Path
    modules: dict[str, Path]  # by name, as in `lsmod` but with the file's dashes

    @property
    def release(self) -> str:
        """Its name, as `uname -r` tells it."""
        return self.image.name.removeprefix("vmlinuz-")

    @property
    def config(self) -> Path:
        """How it was built."""
        return self.image.with_name(f"config-{self.release}")

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


def find_kernel(cache: Path, modules: tuple[str, ...] = ()) -> Kernel | None:
    """The newest kernel in a folder that has these modules."""
    for image in sorted(cache.glob("*/boot/vmlinuz-*"), key=version, reverse=True):
        folder = image.parent.parent
        # Debian 12 has them under lib, later ones under usr/lib.
        files = [file for top in ("", "usr/") for file in folder.glob(f"{top}lib/modules/*/kernel/**/*.ko*")]
        found = {file.name.split(".")[0]: file for file in files if file.suffix in (".ko", ".xz")}
        # A module names another one with underscores, its file may have dashes.
        found.update({name.replace("-", "_"): file for name, file in found.items()})
        if all(name in found for name in modules):
            return Kernel(image, found)
    return None


def missing_tools(architecture: Architecture = AMD64) -> list[str]:
    """The Debian packages without which nothing can be booted."""
    wanted = {architecture.qemu: architecture.package, "busybox": "busybox-static"}
    return [package for tool, package in wanted.items() if shutil.which(tool) is None]


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


END = entry("TRAILER!!!", b"", 0)  # of such an archive; the kernel then looks for another one


def contents(kernel: Kernel, cargo: Cargo) -> Iterator[tuple[str, bytes, int]]:
    """All files of ours: busybox, the modules, the programs, where no system has them their libraries, the files."""
    executable = stat.S_IFREG | 0o755
    loaded = kernel.with_needed(cargo.modules)
    if cargo.system is None:
        yield f"{TOOLS}/busybox", Path(shutil.which("busybox") or "busybox").read_bytes(), executable
        for library in sorted({library for program in cargo.programs for library in libraries(program)}):
            yield str(library)[1:], library.read_bytes(), executable
        yield "bin/sh", f"/{TOOLS}/busybox".encode(), stat.S_IFLNK | 0o777  # for system()
    busybox = f"/{TOOLS}/busybox" if cargo.system is None else "/bin/busybox"
    for applet in APPLETS:
        yield f"{TOOLS}/{applet}", busybox.encode(), stat.S_IFLNK | 0o777
    for program in cargo.programs:
        yield f"{HOME}/bin/{program.name}", program.read_bytes(), executable
    for name, content in cargo.files.items():
        yield name, content, executable
    for module in loaded:
        yield f"{TOOLS}/{module}.ko", code(kernel.modules[module]), executable
    yield f"{TOOLS}/steps.sh", STEPS.read_bytes(), executable
    yield f"{TOOLS}/script.sh", cargo.script.read_bytes(), executable
    yield "init", INIT.format(modules=" ".join(loaded)).encode(), executable


def write_archive(kernel: Kernel, cargo: Cargo, out: BinaryIO) -> None:
    """All that the machine knows."""
    if cargo.system is not None:
        with cargo.system.open("rb") as system:
            shutil.copyfileobj(system, out, 1 << 20)
    files = list(contents(kernel, cargo))
    directories = {"dev", "proc", "root", "run", "sys", "tmp"}
    for name, _, _ in files:
        directories.update(str(parent) for parent in Path(name).parents if str(parent) != ".")
    for name in sorted(directories):
        out.write(entry(name, b"", stat.S_IFDIR | 0o755))
    for file in files:
        out.write(entry(*file))
    out.write(END)


def keep_apart(emulator: int, count: int, spine_core: int) -> None:
    """Emulate one of the machine's `count` cores on the last core of this computer, and the others on the others.

    Without it, the machine's cores take this computer's cores from each other for 10 ms at a time. The machine counts
    this as its own processor time: a law that computes for 3 us has then used up its budget.
    """
    cores = sorted(os.sched_getaffinity(0))
    end = time.monotonic() + 10.0
    while len(cores) > 1 and time.monotonic() < end:
        with contextlib.suppress(OSError):  # a thread that has just ended
            threads = {path.read_text().strip(): path.parent for path in Path(f"/proc/{emulator}/task").glob("*/comm")}
            machines = [threads.get(f"CPU {core}/TCG") for core in range(count)]
            if None not in machines:  # the thread with the emulated timers goes where it can run
                for core, thread in enumerate(filter(None, machines)):
                    os.sched_setaffinity(int(thread.name), cores[-1:] if core == spine_core else cores[:-1])
                return
        time.sleep(0.1)


def boot(kernel: Kernel, cargo: Cargo, cache: Path) -> str:
    """All that the machine said until it was off. While it runs, that is in `cache`, too."""
    archive, console = (cache / f"{name}.{os.getpid()}" for name in ("archive", "console"))
    machine = cargo.architecture
    command = [machine.qemu, *f"{machine.words} -accel tcg,thread=multi -smp {cargo.cores}".split()]
    command += f"-m {cargo.memory_mib} -nographic -no-reboot -nic none -name lithe,debug-threads=on".split()
    # An emulated counter jitters with the host's load. Without tsc=reliable the kernel gives it up for a slow clock, on
    # some hosts and not on others (on ARM the word means nothing).
    options = f"console={machine.console} quiet panic=-1 tsc=reliable {cargo.options}"
    command += ["-kernel", str(kernel.image), "-initrd", str(archive), "-append", options]
    late = ""
    try:
        with archive.open("wb") as out:
            write_archive(kernel, cargo, out)
        with console.open("wb") as out:
            emulator = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=out)
        with emulator:
            try:
                if cargo.spine_core is not None:
                    keep_apart(emulator.pid, cargo.cores, cargo.spine_core)
                emulator.wait(cargo.timeout_s)
            except BaseException:
                emulator.kill()
                raise
    except subprocess.TimeoutExpired:
        late = f"\nvm: not done after {cargo.timeout_s} s\n"
    finally:
        said = console.read_bytes().decode(errors="replace") if console.exists() else ""
        archive.unlink(missing_ok=True)
        console.unlink(missing_ok=True)
    return said.replace("\r", "") + late


def steps(said: str) -> dict[str, Step]:
    """What the script in the machine did, by name."""
    found = re.findall(r"(?ms)^vm: begin (\S+)$(.*?)^vm: end \1 (\d+)$", said.replace("\r", ""))
    return {name: Step(int(code), text) for name, text, code in found}


def wrong_steps(said: str, path: Path, refused: Mapping[str, int] | None = None) -> list[str]:
    """The script's steps that did not end as they must (with 0, if `refused` has no other code), or never did."""
    ended = steps(said)
    names = re.findall(r"(?m)^step (\S+)", path.read_text())
    return [name for name in names if name not in ended or ended[name].code != (refused or {}).get(name, 0)]


def changed(text: str, changes: Mapping[str, str]) -> str:
    """A robot file's text with all of these changes; each finds something to change."""
    for old, new in changes.items():
        if old not in text:
            raise SystemExit(f"vm: the robot file no longer says: {old}")
        text = text.replace(old, new)
    return text
