# SPDX-License-Identifier: Apache-2.0
"""Runs a program where the kernel lacks a call, as in some containers and with older kernels.

`without_call.py memfd PROGRAM ...` has no memfd_create; with `dispatch` there is no syscall user dispatch.
"""

import ctypes
import os
import platform
import struct
import sys
from typing import ClassVar

MEMFD_CREATE = {"x86_64": 319, "aarch64": 279}
PRCTL, PR_SET_SYSCALL_USER_DISPATCH = {"x86_64": 157, "aarch64": 167}, 59
FIRST_ARGUMENT = 16  # struct seccomp_data
PR_SET_SECCOMP, PR_SET_NO_NEW_PRIVS = 22, 38
SECCOMP_MODE_FILTER, SECCOMP_RET_ERRNO, SECCOMP_RET_ALLOW = 2, 0x00050000, 0x7FFF0000
LOAD_WORD, JUMP_IF_EQUAL, RETURN = 0x20, 0x15, 0x06
ENOSYS = 38


class Program(ctypes.Structure):
    """struct sock_fprog."""

    _fields_: ClassVar = [("length", ctypes.c_ushort), ("filter", ctypes.c_char_p)]


REFUSED = {
    "memfd": [(JUMP_IF_EQUAL, 0, 1, MEMFD_CREATE[platform.machine()])],
    "dispatch": [
        (JUMP_IF_EQUAL, 0, 3, PRCTL[platform.machine()]),
        (LOAD_WORD, 0, 0, FIRST_ARGUMENT),
        (JUMP_IF_EQUAL, 0, 1, PR_SET_SYSCALL_USER_DISPATCH),
    ],
}


def forbid(what: str) -> None:
    """From here on this call does not exist, for this process and its children."""
    steps = [
        (LOAD_WORD, 0, 0, 0),
        *REFUSED[what],
        (RETURN, 0, 0, SECCOMP_RET_ERRNO | ENOSYS),
        (RETURN, 0, 0, SECCOMP_RET_ALLOW),
    ]
    program = Program(len(steps), b"".join(struct.pack("=HBBI", *step) for step in steps))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) or libc.prctl(
        PR_SET_SECCOMP, SECCOMP_MODE_FILTER, ctypes.byref(program)
    ):
        sys.exit(f"no seccomp filters here: {os.strerror(ctypes.get_errno())}")


if __name__ == "__main__":
    forbid(sys.argv[1])
    os.execv(sys.argv[2], sys.argv[2:])
