# SPDX-License-Identifier: Apache-2.0
"""The README keeps its word: the law it shows is short, compiles and runs."""

import re

from system.robot_rig import ROOT, RobotRig

LAW = re.compile(r"```cpp\n(#include <lithe/law\.hpp>\n.*?)```", re.DOTALL)


def test_the_law_of_the_readme_is_20_lines_and_moves_the_arm(rig: RobotRig) -> None:
    """As it stands there, byte for byte; then the two commands below it."""
    found = LAW.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(found) == 1, "the README shows one whole law"
    law = rig.dir / "my_pd.cpp"
    law.write_text(found[0], encoding="utf-8")
    lines = [line for line in found[0].splitlines() if line.strip()]
    assert len(lines) <= 20, "a PD law fits in 20 lines"
    assert rig.ask("law", "check", law)["law"]["name"] == "pd"
    rig.run()
    swap = rig.ask("swap", law)
    assert (swap["verdict"], swap["law"]) == ("committed", "pd")
    params = rig.ask("param", "set", "kp_nm_rad", "3.5")["params"]
    assert {each["name"]: each["value"] for each in params}["kp_nm_rad"] == 3.5
    assert rig.ask("status")["mode"] == "active"
