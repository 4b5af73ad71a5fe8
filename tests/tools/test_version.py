# SPDX-License-Identifier: Apache-2.0
"""One version: of the programs, of the Python package, and after the newest release of the changelog."""

import re
import subprocess

import lithe
from system.robot_rig import BIN, ROOT, need


def test_programs_and_package_have_one_version() -> None:
    need("lithe")
    told = subprocess.run([BIN / "lithe", "--version"], check=True, capture_output=True, text=True).stdout
    assert told.startswith(f"lithe {lithe.__version__}, ")


def test_a_version_is_a_release_of_the_changelog_or_the_one_in_work() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    unreleased, released = re.findall(r"^## \[(.+?)\]", text, re.M)[:2]
    assert unreleased == "Unreleased"
    changed = text.partition("## [Unreleased]")[2].partition("\n## [")[0].strip() != ""
    version, _, dev = lithe.__version__.partition(".dev")
    assert changed == bool(dev), "what is not released has a version that ends in .dev0, a release has none"
    now, last = ([int(part) for part in each.split(".")] for each in (version, released))
    assert now > last if dev else now == last
