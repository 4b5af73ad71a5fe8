# SPDX-License-Identifier: Apache-2.0
"""One version: of the programs, of the Python package and of the newest entry in the changelog."""

import re
import subprocess

import lithe
from system.robot_rig import BIN, ROOT, need


def test_programs_package_and_changelog_have_one_version() -> None:
    need("lithe")
    told = subprocess.run([BIN / "lithe", "--version"], check=True, capture_output=True, text=True).stdout
    assert told.startswith(f"lithe {lithe.__version__}, ")
    headings = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)
    assert headings[:2] == ["Unreleased", lithe.__version__]
