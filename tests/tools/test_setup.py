# SPDX-License-Identifier: Apache-2.0
"""tools/setup on machines that lack something, played with stand-ins for dpkg-query, apt-get, sudo and id."""

import fcntl
import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HIDE_PYTHON = "python3 python3.11 python3.12 python3.13"


def executable(path: Path, text: str) -> None:
    path.write_text("#!/bin/sh\n" + text)
    path.chmod(0o755)


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """A tree with only the set-up in it, and a bin/ whose commands stand before the system's."""
    (tmp_path / "tools").mkdir()
    (tmp_path / "brain").mkdir()
    (tmp_path / "bin").mkdir()
    (tmp_path / "brain/pyproject.toml").write_text("[project]\nname = 'lithe'\n")
    for name in ("setup", "packages.txt", "requirements.txt"):
        shutil.copy(ROOT / "tools" / name, tmp_path / "tools" / name)
    installed = [
        line.split()[1] for line in (ROOT / "tools/packages.txt").read_text().splitlines() if line[:1] not in "#"
    ]
    (tmp_path / "installed").write_text("".join(f"ii  {name}\n" for name in installed))
    executable(tmp_path / "bin/dpkg-query", f"cat {tmp_path}/installed\n")
    executable(tmp_path / "bin/id", "echo 1000\n")
    executable(tmp_path / "bin/sudo", "exit 1\n")
    executable(tmp_path / "bin/apt-get", f'echo "$@" >> {tmp_path}/apt.log\n')
    return tmp_path


def forget(machine: Path, package: str) -> None:
    text = (machine / "installed").read_text()
    (machine / "installed").write_text(text.replace(f"ii  {package}\n", f"rc  {package}\n"))


def setup(machine: Path, *groups: str) -> subprocess.CompletedProcess[str]:
    environment = {"PATH": f"{machine}/bin:/usr/bin:/bin", "HOME": str(machine)}
    command = [str(machine / "tools/setup"), *groups]
    return subprocess.run(
        command, capture_output=True, text=True, env=environment, check=False, stdin=subprocess.DEVNULL
    )


def test_two_at_once_do_not_make_one_venv(machine: Path) -> None:
    """Both would clear it and fill it: the second waits for the first."""
    pretend_venv(machine)
    environment = {"PATH": f"{machine}/bin:/usr/bin:/bin", "HOME": str(machine)}
    with (machine / "tools/setup").open() as script:
        fcntl.flock(script, fcntl.LOCK_EX)
        second = subprocess.Popen([str(machine / "tools/setup")], env=environment, stdin=subprocess.DEVNULL)
        with pytest.raises(subprocess.TimeoutExpired):
            second.wait(timeout=1.0)
    assert second.wait(timeout=60) == 0, "and then it has nothing to do"


def pretend_venv(machine: Path) -> None:
    """A .venv that is up to date, so that only packages matter."""
    (machine / ".venv/bin").mkdir(parents=True)
    executable(machine / ".venv/bin/python", "exit 0\n")
    texts = b"".join(
        (machine / name).read_bytes() for name in ("tools/setup", "tools/requirements.txt", "brain/pyproject.toml")
    )
    digest = subprocess.run(["sha256sum"], input=texts, capture_output=True, check=True).stdout.decode()
    (machine / ".venv/setup.stamp").write_text(f"{digest}{os.path.realpath(machine)}\n")


def test_nothing_missing_says_nothing(machine: Path) -> None:
    pretend_venv(machine)
    done = setup(machine, "build", "check", "bench")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_without_rights_what_is_wrong_then_exactly_one_line_to_type_and_exit_1(machine: Path) -> None:
    forget(machine, "ninja-build")
    forget(machine, "libgtest-dev")
    done = setup(machine)
    assert done.returncode == 1
    assert (done.stdout + done.stderr).splitlines() == [
        "setup: Debian packages are missing; install them (or ask who may), then repeat your command:",
        "sudo apt-get update && sudo apt-get install -y --no-install-recommends libgtest-dev ninja-build",
    ]
    assert not (machine / "apt.log").exists()


def test_when_apt_cannot_install_the_last_line_says_what_to_do(machine: Path) -> None:
    executable(machine / "bin/id", "echo 0\n")
    executable(machine / "bin/apt-get", "exit 100\n")
    forget(machine, "cmake")
    done = setup(machine)
    assert done.returncode == 1 and not (machine / ".venv").exists()
    assert "apt-get could not install cmake" in done.stderr.splitlines()[-1] and "connect" in done.stderr


def test_without_a_package_index_the_last_line_says_what_to_do_and_the_next_try_begins_anew(machine: Path) -> None:
    executable(
        machine / "bin/python3",
        f'case "$*" in *sys.executable*) echo {machine}/bin/python3 ;; *"-m venv"*) mkdir -p .venv/bin &&\n'
        f"cp {machine}/bin/no_index .venv/bin/python ;; esac\n",
    )
    executable(machine / "bin/no_index", "echo No matching distribution >&2; exit 1\n")
    for _ in range(2):
        done = setup(machine)
        assert done.returncode == 1
        assert "pip could not fill .venv" in done.stderr.splitlines()[-1] and "connect" in done.stderr
        assert not (machine / ".venv/setup.stamp").exists()


@pytest.mark.skipif(os.getuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_is_named_before_anything_is_installed(machine: Path) -> None:
    forget(machine, "cmake")
    machine.chmod(0o555)
    done = setup(machine)
    machine.chmod(0o755)
    assert done.returncode == 1
    assert f"{machine} cannot be written" in done.stderr and "clone" in done.stderr


def test_a_missing_package_of_another_group_does_not_matter(machine: Path) -> None:
    pretend_venv(machine)
    forget(machine, "clang-22")
    assert setup(machine, "build").returncode == 0
    assert setup(machine, "build", "check").returncode == 1


def test_with_password_less_sudo_apt_installs_what_is_missing(machine: Path) -> None:
    pretend_venv(machine)
    executable(machine / "bin/sudo", '[ "$1" = -n ] && shift; exec "$@"\n')
    forget(machine, "cmake")
    assert setup(machine).returncode == 0
    assert "install -y --no-install-recommends cmake" in (machine / "apt.log").read_text()


def test_a_first_python_without_venv_is_passed_over(machine: Path) -> None:
    for name in HIDE_PYTHON.split():
        executable(machine / "bin" / name, "exit 1\n")
    script = (machine / "tools/setup").read_text().split("if ! command -v dpkg-query")[0]
    command = ["bash", "-c", script + "usable_python", str(machine / "tools/setup")]
    environment = {"PATH": f"{machine}/bin:/usr/bin:/bin"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode in (0, 1)
    found = done.stdout.strip()
    assert found.startswith("/usr/bin/python3") if done.returncode == 0 else "python3-venv" in done.stderr


def test_every_package_line_has_a_group_a_name_and_a_reason() -> None:
    for line in (ROOT / "tools/packages.txt").read_text().splitlines():
        if not line.startswith("#"):
            group, _, reason = line.split(maxsplit=2)
            assert group in {"build", "test", "check", "bench", "vcan", "arm64", "boards", "debian13"}
            assert len(reason) > len("short")


def test_a_word_that_is_no_group_is_refused_before_anything_happens(machine: Path) -> None:
    done = setup(machine, "build", "--help")
    assert done.returncode == 2
    assert "no group '--help'" in done.stderr and "bench boards build check debian13 test vcan" in done.stderr
    assert not (machine / "apt.log").exists() and not (machine / ".venv").exists()


def test_a_link_to_another_venv_is_not_emptied(machine: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "kept").write_text("theirs")
    (machine / ".venv").symlink_to(other)
    done = setup(machine)
    assert done.returncode == 1 and "remove the link" in done.stderr
    assert (other / "kept").read_text() == "theirs"
