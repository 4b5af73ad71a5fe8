# SPDX-License-Identifier: Apache-2.0
"""`make test-arm64`: what it needs, what it unpacks, and what it says of tests that did not run."""

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import cross
import pytest

REPORT = """<testsuite tests="4" failures="1" skipped="2">
<testcase name="a" status="run"/><testcase name="b" status="fail"><failure message=""/></testcase>
<testcase name="c" status="notrun"><skipped message="SKIP_REGULAR_EXPRESSION_MATCHED"/><system-out>
[ RUN      ] Gate.Holds
/home/me/spine/contain/system_calls_test.cpp:80: Skipped
this kernel has no such gate
[  SKIPPED ] Gate.Holds (0 ms)</system-out></testcase>
<testcase name="d" status="disabled"><skipped message=""/></testcase></testsuite>
"""


def test_without_cross_compiler_and_qemu_it_is_skipped_with_the_line_to_type() -> None:
    done = subprocess.run(
        [sys.executable, "tools/cross.py"],
        cwd=cross.ROOT,
        env={"PATH": "/nowhere"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 77
    said = done.stderr.splitlines()
    assert "lacks" in said[0] and "qemu-user-static" in said[0]
    assert said[1].startswith("sudo apt-get install -y --no-install-recommends g++-aarch64-linux-gnu")


def test_the_libraries_are_those_of_the_native_build_and_no_program() -> None:
    wanted = cross.libraries()
    assert {"libfmt-dev", "libgtest-dev", "libelf-dev", "libseccomp-dev", "libc6-dev"} <= set(wanted)
    assert not {"g++", "cmake", "libzmq3-dev", "python3"} & set(wanted), "programs run here, and no bench is built"


def test_the_packages_it_names_are_in_the_list_of_packages() -> None:
    rows = [line.split()[:2] for line in cross.PACKAGES.read_text().splitlines()]
    assert {package for group, package in rows if group == "arm64"} == {"g++-aarch64-linux-gnu", "qemu-user-static"}
    assert {"g++-aarch64-linux-gnu", "qemu-user-static"} <= set(cross.NEEDED.values())


def package(folder: Path, name: str, files: dict[str, str], links: dict[str, str]) -> Path:
    root = folder / name
    (root / "DEBIAN").mkdir(parents=True)
    (root / "DEBIAN").chmod(0o755)  # dpkg-deb wants it so, whatever the umask is
    (root / "DEBIAN/control").write_text(
        f"Package: {name}\nVersion: 1\nArchitecture: arm64\nMaintainer: me\nDescription: x\n"
    )
    for path, text in files.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
    for path, to in links.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).symlink_to(to)
    subprocess.run(["dpkg-deb", "--build", root, folder / f"{name}.deb"], check=True, capture_output=True)
    return folder / f"{name}.deb"


def test_a_tree_has_one_folder_for_libraries_and_no_link_leaves_it(tmp_path: Path) -> None:
    one = package(tmp_path, "one", {"lib/libone.so.1": "one"}, {})
    two = package(tmp_path, "two", {}, {"usr/lib/libone.so": "/lib/libone.so.1"})
    tree = tmp_path / "tree"
    cross.unpack([one, two], tree)
    assert (tree / "lib").is_symlink() and (tree / "usr/lib/libone.so.1").read_text() == "one"
    assert not os.readlink(tree / "usr/lib/libone.so").startswith("/")
    assert (tree / "usr/lib/libone.so").read_text() == "one"


def test_a_package_cut_short_is_an_error_that_names_it(tmp_path: Path) -> None:
    cut = package(tmp_path, "cut", {"usr/lib/a": "x" * 100_000}, {})
    cut.write_bytes(cut.read_bytes()[:200])
    with pytest.raises(cross.Trouble, match=r"cut\.deb"):
        cross.unpack([cut], tmp_path / "tree")


def test_skipped_tests_are_counted_by_their_own_words(tmp_path: Path) -> None:
    (tmp_path / "arm64.xml").write_text(REPORT)
    assert cross.reasons(tmp_path / "arm64.xml") == Counter({"this kernel has no such gate": 1, "disabled": 1})


def test_without_the_makers_sources_the_pi3hat_is_skipped_with_the_reason(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("LITHE_PI3HAT_DIR", raising=False)
    assert cross.pi3hat(jobs=1) == cross.SKIPPED
    assert capsys.readouterr().out.startswith("arm64: pi3hat skipped: LITHE_PI3HAT_DIR names no folder")


def test_without_a_way_to_the_libraries_it_is_skipped_with_the_reason(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Words of apt are not looked for: whatever keeps the packages away, nothing was tested and nothing failed."""
    monkeypatch.setattr(cross, "HOME", tmp_path)
    monkeypatch.setattr(cross, "SYSROOT", tmp_path / "sysroot")
    monkeypatch.setattr(cross, "missing", list)
    monkeypatch.setattr(cross, "apt", lambda *_words, **_options: ["false"])
    monkeypatch.setattr(sys, "argv", ["cross.py"])
    assert cross.main() == cross.SKIPPED
    assert "be reachable" in capsys.readouterr().err


@pytest.mark.parametrize(("rooms", "code"), [(["core", "guard"], 0), (["core", "no_room"], 1)])
def test_the_tests_of_rooms_are_built_and_run(
    rooms: list[str], code: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With cmake and ctest that only note their words; of an unknown room the build fails."""
    for name in ("cmake", "ctest"):
        program = tmp_path / name
        program.write_text(f'#!/bin/sh\necho "{name} $*" >> {tmp_path}/said\ncase "$*" in *no_room*) exit 1; esac\n')
        program.chmod(0o755)
    (tmp_path / "report").write_text(REPORT)
    with (tmp_path / "ctest").open("a") as program:
        program.write(f"cp {tmp_path}/report {tmp_path}/arm64.xml\n")
    monkeypatch.setattr(cross, "REPORT", tmp_path / "arm64.xml")
    monkeypatch.setattr(cross, "get_sysroot", lambda: None)
    monkeypatch.setattr(cross, "missing", list)
    monkeypatch.setattr(cross, "starter", list)
    monkeypatch.setattr(cross, "target_environment", lambda: os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"})
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(sys, "argv", ["cross.py", "--jobs", "3", "--room", *rooms])
    assert cross.main() == code
    said = (tmp_path / "said").read_text().splitlines()
    assert said[1] == f"cmake --build --preset aarch64 -j 3 --target {rooms[0]}_tests {rooms[1]}_tests"
    assert (len(said) == 3 and said[2].endswith("-L (^|[.])(core|guard)$")) == (code == 0)
