# SPDX-License-Identifier: Apache-2.0
"""Finds, builds and loads the C shim (`_shm/lithe_shm.c`): compiled once on first use, kept in the cache."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

from . import _wire
from .errors import LitheError, ShmError
from .files import own_folder

_SOURCE = Path(__file__).parent / "_shm" / "lithe_shm.c"
_COMPILE = ("cc", "-std=c11", "-O2", "-shared", "-fPIC")


def _cache_dir() -> Path:
    if value := os.environ.get("LITHE_CACHE_DIR"):
        return Path(value)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "lithe"


def _shim_key() -> str:
    """What the shim's machine code depends on: a home directory may be shared by machines that differ.

    Its source and flags, the processor, the C library, the Python that loads it, and the compiler (by its file: quicker
    than asking for its version).
    """
    compiler = shutil.which(_COMPILE[0])
    stamp = ""
    if compiler is not None:
        status = os.stat(compiler)
        stamp = f"{os.path.realpath(compiler)} {status.st_size} {status.st_mtime_ns}"
    machine = f"{platform.machine()} {sys.byteorder} {platform.libc_ver()} {sysconfig.get_config_var('SOABI')}"
    parts = [_SOURCE.read_bytes(), " ".join(_COMPILE).encode(), machine.encode(), stamp.encode()]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


def _build_shim() -> Path:
    """Compiles the shim into the cache, once per source text, machine, compiler and Python."""
    try:
        target = own_folder(_cache_dir(), "LITHE_CACHE_DIR") / f"liblithe_shm-{_shim_key()}.so"
    except LitheError as error:
        raise ShmError(f"cannot build the shared-memory shim: {error}") from None
    if target.exists():
        return target
    making = target.with_suffix(f".{os.getpid()}")
    command = [*_COMPILE, "-o", str(making), str(_SOURCE)]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        detail = getattr(error, "stderr", "") or str(error)
        raise ShmError(f"cannot build the shared-memory shim: {detail}\n  try: {' '.join(command)}") from None
    os.replace(making, target)
    return target


def load_shim() -> ctypes.PyDLL:
    path = os.environ.get("LITHE_SHM_LIB") or str(_build_shim())
    try:
        lib = ctypes.PyDLL(path)
    except OSError as error:
        raise ShmError(
            f"cannot load the shared-memory shim {path}: {error}; unset LITHE_SHM_LIB to rebuild it"
        ) from None
    pointer, size, u64 = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_uint64
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "lithe_layout_hash": (u64, []),
        "lithe_load": (u64, [pointer]),
        "lithe_store": (None, [pointer, u64]),
        "lithe_copy": (None, [pointer, pointer, size]),
        "lithe_channel_read": (u64, [pointer, pointer, size]),
        "lithe_channel_write": (None, [pointer, pointer, size]),
        "lithe_ring_head": (u64, [pointer]),
        "lithe_ring_drain": (size, [pointer, size, size, pointer, pointer, size, pointer]),
        "lithe_ring_latest": (u64, [pointer, size, size, pointer]),
        "lithe_mailbox_send": (u64, [pointer, pointer, size, pointer, size]),
        "lithe_mailbox_poll": (ctypes.c_uint32, [pointer, size, u64]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    if lib.lithe_layout_hash() != _wire.LAYOUT_HASH:
        raise ShmError(f"the shim {path} was built from another schema: run `python3 tools/gen.py --write` and rebuild")
    return lib


@functools.cache
def shim() -> ctypes.PyDLL:
    """The C shim, built and loaded on first use."""
    return load_shim()
