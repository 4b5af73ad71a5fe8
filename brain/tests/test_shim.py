# SPDX-License-Identifier: Apache-2.0
"""The C shim: which one is loaded, when it is built anew, and what is said when it cannot be."""

import subprocess
import sys
from pathlib import Path

import pytest
from lithe import _wire, shim
from lithe.errors import ShmError


def test_a_shim_of_another_schema_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = tmp_path / "old.c"
    text = (Path(shim.__file__).parent / "_shm/lithe_shm.c").read_text()
    assert f"0x{_wire.LAYOUT_HASH:016x}" in text
    source.write_text(text.replace(f"0x{_wire.LAYOUT_HASH:016x}", "0x1"))
    library = tmp_path / "old.so"
    subprocess.run(["cc", "-std=c11", "-shared", "-fPIC", "-o", library, source], check=True)
    monkeypatch.setenv("LITHE_SHM_LIB", str(library))
    with pytest.raises(ShmError, match="was built from another schema"):
        shim.load_shim()
    monkeypatch.setenv("LITHE_SHM_LIB", str(tmp_path / "absent.so"))
    with pytest.raises(ShmError, match="cannot load the shared-memory shim"):
        shim.load_shim()


def test_the_shim_is_built_anew_for_another_machine_compiler_or_python(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = {shim._shim_key()}
    assert keys == {shim._shim_key()}
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    keys.add(shim._shim_key())
    monkeypatch.setattr("sysconfig.get_config_var", lambda _: "cpython-399")
    keys.add(shim._shim_key())
    monkeypatch.setattr("shutil.which", lambda _: sys.executable)
    keys.add(shim._shim_key())
    monkeypatch.setattr("shutil.which", lambda _: None)
    keys.add(shim._shim_key())
    assert len(keys) == 5


def test_the_shim_is_built_once_and_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("LITHE_SHM_LIB", raising=False)
    monkeypatch.setenv("LITHE_CACHE_DIR", str(tmp_path / "cache"))
    shim.load_shim()
    built = list((tmp_path / "cache").iterdir())
    assert len(built) == 1 and built[0].suffix == ".so"
    before = built[0].stat().st_mtime_ns
    shim.load_shim()
    assert built[0].stat().st_mtime_ns == before


def test_without_a_compiler_or_a_cache_the_reason_is_given(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("LITHE_SHM_LIB", raising=False)
    monkeypatch.setenv("LITHE_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ShmError, match=r"cannot build the shared-memory shim: .*cc[\s\S]*try: cc"):
        shim.load_shim()
    (tmp_path / "file").touch()
    monkeypatch.setenv("LITHE_CACHE_DIR", str(tmp_path / "file" / "below"))
    with pytest.raises(ShmError, match="cannot build the shared-memory shim"):
        shim.load_shim()
