# SPDX-License-Identifier: Apache-2.0
"""Our SocketCAN bus on an interface of a real kernel's, in a machine of its own. Skipped, with the reason, where none
can be booted."""

from collections.abc import Callable
from pathlib import Path

import pytest
import vcan


@pytest.fixture
def kernel() -> vcan.Kernel:
    """Something to boot, and something to run there."""
    reason = vcan.why_not()
    found = vcan.find_kernel(vcan.CACHE)
    if reason or found is None:
        pytest.skip(reason)
    return found


def test_frames_pass_on_a_real_interface(kernel: vcan.Kernel, tell: Callable[[str], None]) -> None:
    """Classic and FD, errors, down and up, gone and back: spine/hal/bus/socketcan_interface_test.cpp."""
    status, said = vcan.boot(kernel, vcan.PROGRAM, vcan.CACHE)
    assert status == 0, said
    assert "[  PASSED  ]" in said and "SKIPPED" not in said, said
    tell(f"{said.count('[       OK ]')} tests on a vcan of {kernel.image.name}")


def test_a_program_that_fails_there_fails_here(kernel: vcan.Kernel) -> None:
    """The twin: what comes out of the machine is the program's own verdict."""
    assert vcan.boot(kernel, Path("/bin/false"), vcan.CACHE)[0] == 1


def test_what_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the command that brings it."""
    monkeypatch.setattr(vcan.platform, "machine", lambda: "x86_64")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "tools/setup vcan" in vcan.why_not()
    for tool in (vcan.QEMU, "busybox"):
        (tmp_path / tool).touch(mode=0o755)
    assert "tools/vcan.py --fetch" in vcan.why_not(tmp_path)
    monkeypatch.setattr(vcan.platform, "machine", lambda: "aarch64")
    assert "aarch64" in vcan.why_not()


def test_modules_are_loaded_after_those_they_need(tmp_path: Path) -> None:
    """As their own files say."""
    for name, needed in {"vcan": b"can_dev", "can-dev": b"", "can-raw": b"can", "can": b""}.items():
        file = tmp_path / "k/lib/modules/6/kernel" / f"{name}.ko"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"ELF\0license=GPL\0depends=" + needed + b"\0")
    (tmp_path / "k/boot").mkdir()
    (tmp_path / "k/boot/vmlinuz-6").touch()
    found = vcan.find_kernel(tmp_path)
    assert found is not None
    assert found.with_needed(vcan.MODULES) == ["can", "can-raw", "can_dev", "vcan"]
