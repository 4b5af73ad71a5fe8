# SPDX-License-Identifier: Apache-2.0
"""Builds LITHE for 64-bit ARM and runs its C++ tests under QEMU: `make test-arm64` (docs/arm64.md).

python tools/cross.py                all tests, and the pi3hat room with the maker's library if LITHE_PI3HAT_DIR has it
    --room guard core: the tests of these rooms; --pi3hat: only the pi3hat room; --sysroot: only get the libraries
Exit code: 0 when all pass, 1 when not, 77 and the reason when this machine has no cross compiler, no QEMU or no
way to the libraries.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import run_tests

ROOT = Path(__file__).parent.parent
PACKAGES = ROOT / "tools/packages.txt"
HOME = ROOT / "build/arm64"  # what is got once: the libraries, and apt's own files about them
SYSROOT = HOME / "sysroot"
REPORT = ROOT / "build/said/arm64.xml"
TRIPLE = "aarch64-linux-gnu"
EMULATOR = "qemu-aarch64-static"
NEEDED = {
    f"{TRIPLE}-g++": "g++-aarch64-linux-gnu",
    EMULATOR: "qemu-user-static",
    "apt-get": "apt",
    "dpkg-deb": "dpkg",
    "unshare": "util-linux",
}
SKIPPED = 77
# What lawd runs, by the names by which it asks for them.
TARGET_TOOLS = ("g++", "objdump", "addr2line", "ld")
SKIP = re.compile(r"\.cpp:\d+: Skipped\n(.*)")
# How the kernel knows a program for 64-bit ARM: the first bytes of the file, and which of their bits count.
MAGIC = r"\x7fELF\x02\x01\x01" + r"\x00" * 9 + r"\x02\x00\xb7\x00"
MASK = r"\xff" * 7 + r"\x00" + r"\xff" * 8 + r"\xfe\xff\xff\xff"


class Trouble(Exception):
    """What failed, where, and what to do next."""


class NoWay(Trouble):
    """The mirrors cannot be reached, or have no such packages."""


def missing() -> list[str]:
    """Packages without which nothing can be built or run."""
    return [package for program, package in NEEDED.items() if shutil.which(program) is None]


def libraries() -> list[str]:
    """Return what LITHE is built and tested with, as tools/packages.txt names it, and the C and C++ libraries."""
    rows = [line.split()[:2] for line in PACKAGES.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    named = {package for group, package in rows if group in ("build", "test") and package.endswith("-dev")}
    return sorted(named | {"libc6-dev", "libstdc++6"})


def run(command: list[str], what: str) -> None:
    """Run a command whose words matter only when it fails."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise Trouble(f"{what} failed ({' '.join(command[:5])} ...):\n{done.stdout[-8000:]}{done.stderr[-8000:]}")


def apt(*words: str, home: Path = HOME, architecture: str = "arm64") -> list[str]:
    """Return apt's command for a system of our own: this machine's mirrors and keys, no root needed."""
    options = {
        "APT::Architecture": architecture,
        "APT::Architectures": architecture,
        "APT::Sandbox::User": "root",  # that user reads no folder of ours; what is loaded is still checked by its keys
        "Dir::State": str(home / "apt"),
        "Dir::State::status": str(home / "apt/status"),
        "Dir::Cache": str(home / "apt"),
        "Debug::NoLocking": "1",
    }
    given = [word for name, value in options.items() for word in ("-o", f"{name}={value}")]
    return ["apt-get", "-qq", *given, *words]


def load(packages: list[str], home: Path = HOME, architecture: str = "arm64") -> list[Path]:
    """Download packages and all that they depend on, into a folder that the caller removes; their files."""
    for folder in ("lists/partial", "archives/partial"):
        (home / "apt" / folder).mkdir(parents=True, exist_ok=True)
    (home / "apt/status").touch()
    command = apt("update", home=home, architecture=architecture)
    updated = subprocess.run(command, capture_output=True, text=True, check=False)  # another list may be down
    words = ("--no-install-recommends", "--download-only", "-y", "install", *packages)
    command = apt(*words, home=home, architecture=architecture)
    loaded = subprocess.run(command, capture_output=True, text=True, check=False)
    if loaded.returncode != 0:
        raise NoWay(
            f"apt-get has no {architecture} packages for us:\n{updated.stderr[-4000:]}{loaded.stderr[-4000:]}"
            f"These mirrors must serve {architecture} (Debian's do), and be reachable; then repeat your command"
        )
    return sorted((home / "apt/archives").glob("*.deb"))


def relative_links(tree: Path) -> None:
    """Let links that begin at the root of the system point into the tree."""
    for link in tree.rglob("*"):
        if link.is_symlink() and (to := os.readlink(link)).startswith("/"):
            link.unlink()
            link.symlink_to(os.path.relpath(tree / to[1:], link.parent))


def unpack(files: list[Path], tree: Path) -> None:
    """Unpack packages into an empty tree in which /lib and /usr/lib are the same folder, as on a Debian system."""
    shutil.rmtree(tree, ignore_errors=True)
    for name in ("bin", "sbin", "lib"):
        (tree / "usr" / name).mkdir(parents=True)
        (tree / name).symlink_to(f"usr/{name}")
    for file in files:
        command = 'dpkg-deb --fsys-tarfile "$0" | tar -x --keep-directory-symlink -C "$1"'
        run(["bash", "-o", "pipefail", "-c", command, str(file), str(tree)], f"unpacking {file}")
    relative_links(tree)


def get_sysroot() -> None:
    """The libraries of an arm64 Debian below build/arm64/sysroot; got once for a list of packages."""
    stamp, wanted = HOME / "sysroot.txt", "\n".join(libraries())
    if SYSROOT.is_dir() and stamp.exists() and stamp.read_text(encoding="utf-8") == wanted:
        return
    print("arm64: getting the libraries", flush=True)
    started = time.monotonic()
    files = load(wanted.split("\n"))
    unpack(files, HOME / "sysroot.part")
    shutil.rmtree(SYSROOT, ignore_errors=True)
    (HOME / "sysroot.part").rename(SYSROOT)
    stamp.write_text(wanted, encoding="utf-8")
    shutil.rmtree(HOME / "apt/archives")
    print(f"arm64: {len(files)} packages in {time.monotonic() - started:.0f} s", flush=True)


def target_environment() -> dict[str, str]:
    """Return an environment in which lawd's g++, objdump and ld are those for ARM, and QEMU finds the libraries."""
    tools = HOME / "bin"
    shutil.rmtree(tools, ignore_errors=True)
    tools.mkdir(parents=True)
    for name in TARGET_TOOLS:
        (tools / name).symlink_to(shutil.which(f"{TRIPLE}-{name}") or name)
    return {**os.environ, "PATH": f"{tools}:{os.environ['PATH']}", "QEMU_LD_PREFIX": str(SYSROOT)}


def can_start(command: list[str]) -> bool:
    """True when this command, of which the last words are a program for ARM, ends well."""
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def starter() -> list[str]:
    """Return the words before a command whose processes shall be able to start programs for ARM.

    None where the kernel hands them to QEMU anyway (binfmt_misc). Else a user namespace in which it does, which needs
    Linux 6.7 and no root. Where neither is possible, tests that start programs of ours skip themselves and say so.
    """
    program = [str(SYSROOT / "lib/ld-linux-aarch64.so.1"), "--version"]
    if can_start(program):
        return []
    register = "/proc/sys/fs/binfmt_misc"
    enter = f'mount -t binfmt_misc none {register} && printf %s "$0" > {register}/register && exec "$@"'
    line = f":lithe:M::{MAGIC}:{MASK}:{shutil.which(EMULATOR)}:F"
    words = ["unshare", "--user", "--map-current-user", "--keep-caps", "--mount", "sh", "-c", enter, line]
    return words if can_start(words + program) else []


def reasons(report: Path) -> Counter[str]:
    """Return why tests skipped themselves, and how many each."""
    said = Counter[str]()
    for case in ElementTree.parse(report).getroot().iter("testcase"):
        if case.find("skipped") is not None:
            found = SKIP.search(case.findtext("system-out") or "")
            said[found[1] if found else case.get("status") or "no reason given"] += 1
    return said


def test(rooms: list[str], jobs: int) -> int:
    """Build and run the tests of these rooms, or of all; print what they came to. ctest's exit code."""
    environment = target_environment()
    run(["cmake", "--preset", "aarch64", "--log-level=WARNING"], "cmake")
    target = ["--target", *(f"{room}_tests" for room in rooms)] if rooms else []
    started = time.monotonic()
    run(["cmake", "--build", "--preset", "aarch64", "-j", str(jobs), *target], "the build")
    print(f"arm64: built in {time.monotonic() - started:.0f} s", flush=True)
    REPORT.parent.mkdir(parents=True, exist_ok=True)
    REPORT.unlink(missing_ok=True)
    label = ["-LE", "^mutant$", *(["-L", f"(^|[.])({'|'.join(map(re.escape, rooms))})$"] if rooms else [])]
    command = ["ctest", "--preset", "aarch64", "-j", str(jobs), "--progress", "--output-junit", str(REPORT), *label]
    started = time.monotonic()
    done = subprocess.run([*starter(), *command], cwd=ROOT, env=environment, check=False)
    if not REPORT.exists():
        raise Trouble("ctest wrote no report; what it printed is above")
    for reason, count in reasons(REPORT).most_common():
        print(f"arm64: {count:4} skipped: {reason}")
    print(f"test: {run_tests.counted(REPORT)} in {time.monotonic() - started:.0f} s", flush=True)
    return min(done.returncode, 1)


def pi3hat(jobs: int) -> int:
    """Build the maker's pi3hat library and our room that calls it, from what LITHE_PI3HAT_DIR names (ADR 13)."""
    place, build = os.environ.get("LITHE_PI3HAT_DIR"), HOME / "pi3hat"
    if not place:
        print("arm64: pi3hat skipped: LITHE_PI3HAT_DIR names no folder with the maker's sources (docs/hardware.md)")
        return SKIPPED
    options = ["-DCMAKE_BUILD_TYPE=Release", "-DLITHE_TESTS=OFF", "-DLITHE_PI3HAT=ON"]
    options.append(f"-DLITHE_PI3HAT_DIR={Path(place).resolve()}")
    toolchain = ["-G", "Ninja", "--toolchain", str(ROOT / "cmake/aarch64.cmake"), "--log-level=WARNING"]
    run(["cmake", "-S", str(ROOT), "-B", str(build), *toolchain, *options], "cmake with a pi3hat")
    targets = ("lithe_pi3hat_maker", "lithe_hal_bus_pi3hat")
    run(["cmake", "--build", str(build), "-j", str(jobs), "--target", *targets], "the build with a pi3hat")

    def symbols(target: str, kinds: str) -> set[str]:
        """The maker's symbols of these kinds in a library."""
        path = next(path for path in build.rglob(f"lib{target}.*") if path.suffix in (".a", ".so"))
        command = [f"{TRIPLE}-nm", *(["-D"] if path.suffix == ".so" else []), str(path)]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        return set(re.findall(rf" [{kinds}] (_ZNK?6mjbots\S+)", said))

    called, made = symbols(targets[1], "U"), symbols(targets[0], "TW")
    if not called or called - made:
        raise Trouble(
            f"our room calls {sorted(called)}, and the maker's library lacks {sorted(called - made)}: {build}"
        )
    print(
        f"arm64: pi3hat built with the maker's library of {place}, which has all {len(called)} functions that we call"
    )
    return 0


def main() -> int:
    """Get what is missing, then build and test."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--room", nargs="+", default=[], help="only the tests of these rooms")
    parser.add_argument("--sysroot", action="store_true", help="get the libraries, and build nothing")
    parser.add_argument(
        "--pi3hat", action="store_true", help="build the pi3hat room with the maker's library, no tests"
    )
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    args = parser.parse_args()
    if lacking := missing():
        print(f"arm64: skipped, this machine lacks: {' '.join(lacking)}", file=sys.stderr)
        print(f"sudo apt-get install -y --no-install-recommends {' '.join(lacking)}", file=sys.stderr)
        return SKIPPED
    try:
        get_sysroot()
        if args.sysroot:
            return 0
        if args.pi3hat:
            return pi3hat(args.jobs)
        code = test(args.room, args.jobs)
        if not args.room:
            pi3hat(args.jobs)
        return code
    except Trouble as trouble:
        print(f"arm64: {trouble}", file=sys.stderr)
        return SKIPPED if isinstance(trouble, NoWay) else 1


if __name__ == "__main__":
    sys.exit(main())
