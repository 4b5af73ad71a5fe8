# SPDX-License-Identifier: Apache-2.0
"""`lithe tune` on a mounted image: its files are planned, written and given back. No test here tunes this machine."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
from system.robot_rig import BIN, need


def tune(code: int, *words: object) -> dict[str, Any]:
    """One JSON document, and the exit code it came with."""
    need("lithe")
    done = subprocess.run(
        [BIN / "lithe", "--json", "tune", *map(str, words)], capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stdout + done.stderr
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """A root with the folders that the system of a Raspberry Pi has."""
    for folder in ("etc/sysctl.d", "etc/security/limits.d", "var/lib", "boot/firmware"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "boot/firmware/cmdline.txt").write_text("console=tty1 root=PARTUUID=1-02 rootwait\n")
    return tmp_path


def content(root: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {str(each.relative_to(root)): each.read_bytes() for each in root.rglob("*") if each.is_file()}


def test_an_image_gets_its_files_and_gives_them_back_to_the_byte(image: Path) -> None:
    (image / "etc/sysctl.d/90-lithe.conf").write_bytes(b"by hand \xff\n")
    before = content(image)
    planned = tune(0, "plan", "--root", image)
    assert content(image) == before
    paths = {each["path"] for each in planned["changes"]}
    assert paths == {
        "/etc/sysctl.d/90-lithe.conf",
        "/etc/security/limits.d/lithe.conf",
        "/boot/firmware/cmdline.txt",
    }
    assert all(each["kind"] == "file" for each in planned["changes"])
    assert {each["outcome"] for each in tune(0, "apply", "--root", image)["steps"]} == {"done"}
    assert tune(0, "apply", "--root", image)["steps"] == []
    assert b"memlock unlimited" in (image / "etc/security/limits.d/lithe.conf").read_bytes()
    tune(0, "revert", "--root", image)
    assert content(image) == before
    assert tune(0, "revert", "--root", image)["steps"] == []


def test_what_somebody_else_edited_stays_and_exits_with_1(image: Path) -> None:
    tune(0, "apply", "--root", image)
    edited = image / "etc/sysctl.d/90-lithe.conf"
    edited.write_text("mine\n")
    steps = tune(1, "revert", "--root", image)["steps"]
    foreign = [each for each in steps if each["outcome"] == "foreign"]
    assert [each["path"] for each in foreign] == ["/etc/sysctl.d/90-lithe.conf"]
    assert edited.read_text() == "mine\n"
    tune(0, "revert", "--root", image, "--force")
    assert edited.read_text() == "mine\n"
    assert not (image / "var/lib/lithe").exists()


def test_what_cannot_begin_exits_with_2_and_tells_the_same_command(image: Path) -> None:
    """Without its words it would be about this machine."""
    (image / "var/lib/lithe").write_text("a file, so no journal can be made there")
    before = content(image)
    for verb, words in (("apply", ["--cores", "1"]), ("revert", [])):
        error = tune(2, verb, "--root", image, *words)["error"]
        assert error["code"] == "no_tune" and error["next"].endswith(" ".join(["--root", str(image), *words])), error
    assert content(image) == before


def test_force_forgives_what_others_changed_and_not_what_was_refused(image: Path) -> None:
    tune(0, "apply", "--root", image)
    (image / "etc/sysctl.d/90-lithe.conf").write_text("mine\n")
    folder, elsewhere = image / "etc/security/limits.d", image.parent / "elsewhere"
    folder.rename(elsewhere)
    folder.symlink_to(elsewhere)  # it leads out of the image
    steps = tune(1, "revert", "--root", image, "--force")["steps"]
    assert {each["path"]: each["outcome"] for each in steps}["/etc/security/limits.d/lithe.conf"] == "refused"
    assert (elsewhere / "lithe.conf").exists()


def test_the_cores_of_an_image_are_at_least_those_that_are_named(image: Path) -> None:
    """Its machine may have more than four."""
    plan = tune(0, "plan", "--root", image, "--cores", "4,5")
    assert plan["cores"] == "4-5"
    assert any("isolcpus=4-5 " in each["after"] for each in plan["changes"]), plan


def test_wrong_words_exit_with_2(image: Path) -> None:
    for words in (
        ["plan", "--root", image / "none"],
        ["plan", "--root", image, "--cores", "0-99"],
        ["plan", "--cores"],
    ):
        assert tune(2, *words)["error"]["code"] == "usage"
