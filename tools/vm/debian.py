# SPDX-License-Identifier: Apache-2.0
"""Kernels and whole systems of Debian for machines that are booted in memory: unpacked, never installed.

No root and no program of the other architecture is needed, since no script of a package is run. What such scripts
would do and a board needs is done here.
"""

import os
import shutil
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import cross
from cross import Trouble
from vm import machine

__all__ = ["Trouble", "get_kernel", "get_system"]

# What LITHE's programs load; then a compiler for laws, Python for the Brain, and what scripts call.
PACKAGES = (
    "libc6", "libstdc++6", "libfmt9", "libspdlog1.10", "libelf1", "libmd0", "libseccomp2", "libeigen3-dev", "g++",
    "binutils", "python3", "python3-numpy", "bash", "coreutils", "dash", "util-linux", "grep", "sed", "procps",
    "busybox-static",
)  # fmt: skip
# Nothing there reads these.
LEFT_OUT = (
    "usr/share/doc",
    "usr/share/man",
    "usr/share/info",
    "usr/share/locale",
    "usr/share/lintian",
    "usr/share/bug",
)
FILES = {
    "etc/passwd": "root:x:0:0:root:/root:/bin/sh\nnobody:x:65534:65534:nobody:/:/bin/sh\n",
    "etc/group": "root:x:0:\nnogroup:x:65534:\n",
    "etc/hosts": "127.0.0.1 localhost\n",
}
# The shell, and the choices of update-alternatives.
LINKS = {"usr/bin/sh": "dash", "usr/bin/cc": "gcc", "usr/lib/{}/libblas.so.3": "blas/libblas.so.3"}
LINKS |= {"usr/lib/{}/liblapack.so.3": "lapack/liblapack.so.3"}
TRIPLES = {"amd64": "x86_64-linux-gnu", "arm64": "aarch64-linux-gnu"}


def download(packages: tuple[str, ...], architecture: str, home: Path) -> list[Path]:
    """The files of these packages and of those that they need."""
    home.mkdir(parents=True, exist_ok=True)
    if shutil.which("apt-get") is None:
        raise Trouble("no apt-get: this needs a Debian system")
    print(f"vm: downloading {' '.join(packages[:3])}{' ...' * (len(packages) > 3)} ({architecture})", flush=True)
    return cross.load(list(packages), home, architecture)


def get_kernel(package: str, architecture: str, cache: Path) -> None:
    """Debian's current kernel of this name, unpacked into a folder of the cache with its own name."""
    files = [file for file in download((package,), architecture, cache) if file.name.startswith("linux-image-")]
    for file in files:
        name = file.name.split("_")[0]
        if name != package:  # that one only depends on the other
            part = cache / f"{name}.part"
            shutil.rmtree(part, ignore_errors=True)
            cross.run(["dpkg-deb", "-x", str(file), str(part)], f"unpacking {file.name}")
            shutil.rmtree(cache / name, ignore_errors=True)
            part.rename(cache / name)
    shutil.rmtree(cache / "apt/archives")


def finish(tree: Path, architecture: str) -> None:
    """What the scripts of the packages would have done."""
    for name, text in FILES.items():
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        (tree / name).write_text(text)
    for name, to in LINKS.items():
        link = tree / name.format(TRIPLES[architecture])
        if (link.parent / to).exists() and not link.exists():
            link.symlink_to(to)


def entries(tree: Path) -> Iterator[tuple[str, bytes, int]]:
    """Every folder, file and link of a tree, a folder before what is in it."""
    for folder, folders, names in os.walk(tree):
        within = Path(folder).relative_to(tree)
        folders[:] = sorted(name for name in folders if str(within / name) not in LEFT_OUT)
        for name in [*folders, *sorted(names)]:
            path = tree / within / name
            mode = path.lstat().st_mode
            if stat.S_ISLNK(mode):
                yield str(within / name), os.readlink(path).encode(), mode
            elif stat.S_ISDIR(mode):
                yield str(within / name), b"", mode
            elif stat.S_ISREG(mode) and not name.endswith("san.a"):  # sanitizers for static linking
                yield str(within / name), path.read_bytes(), mode | 0o400


def get_system(architecture: str, cache: Path) -> Path:
    """The archive of a Debian system with PACKAGES; made once for a list of them."""
    archive, stamp = cache / "system.cpio", cache / "system.txt"
    wanted = "\n".join([*PACKAGES, *LEFT_OUT, *LINKS])
    if archive.exists() and stamp.exists() and stamp.read_text() == wanted:
        return archive
    tree, part = cache / "tree", cache / "system.part"
    cross.unpack(download(PACKAGES, architecture, cache), tree)
    finish(tree, architecture)
    with part.open("wb") as out:
        for each in entries(tree):
            out.write(machine.entry(*each))
        out.write(machine.END)
    part.rename(archive)
    stamp.write_text(wanted)
    shutil.rmtree(tree)
    shutil.rmtree(cache / "apt/archives")
    return archive
