# SPDX-License-Identifier: Apache-2.0
"""The room table refuses what the design refuses."""

import subprocess
from pathlib import Path

import paper
import pytest
import rooms

REFUSED = [
    ("spine/core/time.cpp", '#include "spine/ipc/channel.hpp"', "spine/core may not include spine/ipc"),
    ("spine/ipc/channel.hpp", '#include "spine/hal/actuators.hpp"', "spine/ipc may not include spine/hal"),
    ("spine/hal/physics/chain.cpp", '#include "spine/ipc/ring.hpp"', "spine/hal/physics may not include spine/ipc"),
    ("spine/loop/tick.cpp", '#include "spine/load/loader.hpp"', "spine/loop may not include spine/load"),
    ("spine/guard/guard.cpp", '#include "spine/law/slot.hpp"', "spine/guard may not include spine/law"),
    ("spine/step/step.cpp", '#include "spine/ipc/ring.hpp"', "spine/step may not include spine/ipc"),
    ("spine/step/step.cpp", '#include "spine/loop/clock.hpp"', "spine/step may not include spine/loop"),
    ("spine/hal/actuators.cpp", "#include <lithe/law.hpp>", "spine/hal may not include spine/law/include"),
    ("spine/load/loader.cpp", '#include "spine/robot/robot.hpp"', "spine/load may not include spine/robot"),
    ("supervisor/bus/plan/plan.cpp", '#include "spine/ipc/ring.hpp"', "supervisor/bus/plan may not include spine/ipc"),
    ("spine/hal/cia401/a.cpp", '#include "spine/hal/cia402/cia402.hpp"', "may not include spine/hal/cia402"),
    ("supervisor/swap/swap.cpp", '#include "spine/hal/core/frame.hpp"', "may not include spine/hal/core"),
    ("sim/world.cpp", '#include "spine/ipc/ring.hpp"', "sim may not include spine/ipc"),
    ("lawd/main.cpp", '#include "spine/robot/robot.hpp"', "lawd may not include spine/robot"),
    ("laws/pd.cpp", '#include "spine/core/time.hpp"', "laws may not include spine/core"),
    ("laws/pd.cpp", "#include <thread>", "a law may not include <thread>"),
    ("spine/loop/tick.cpp", '#include "spine/main.cpp"', "nothing includes main or cli"),
    ("supervisor/serve/server.cpp", '#include "supervisor/cli/cli.hpp"', "nothing includes main or cli"),
    ("spine/loop/tick.cpp", '#include "spine/loop/test/tick_rig.hpp"', "only tests may include"),
    ("spine/loop/tick.cpp", '#include "tick.hpp"', "not a path from the repo root"),
]


@pytest.mark.parametrize(("path", "line", "reason"), REFUSED)
def test_a_forbidden_include_is_refused_with_its_line(path: str, line: str, reason: str) -> None:
    problems = list(rooms.check_cpp(path, "// first line\n" + line + "\n"))
    assert len(problems) == 1
    assert problems[0].startswith(f"{path}:2: ")
    assert reason in problems[0]


def test_a_test_beside_no_unit_of_its_name_is_refused() -> None:
    """And a rig outside a folder test/. In such a folder, and in tests/ and bench/, names are free."""
    good = [
        "spine/a/x.hpp",
        "spine/a/x_test.cpp",
        "spine/a/y.cpp",
        "spine/a/y_test.cpp",
        "spine/a/test/x_more_test.cpp",
    ]
    good += ["spine/a/test/x_rig.hpp", "tests/faults/z_test.cpp", "bench/rig/spine_rig.cpp"]
    assert list(rooms.check_test_names(good)) == []
    bad = ["spine/a/x_more_test.cpp", "spine/b/x_test.cpp", "spine/a/x_rig.hpp"]
    problems = list(rooms.check_test_names([*good, *bad]))
    advice = "name the test after its unit, or move it to a folder test/"
    assert problems == [
        f"spine/a/x_more_test.cpp: there is no spine/a/x_more.cpp or .hpp: {advice}",
        f"spine/b/x_test.cpp: there is no spine/b/x.cpp or .hpp: {advice}",
        "spine/a/x_rig.hpp: what only tests use belongs in a folder test/",
    ]


def test_the_allowed_directions_pass() -> None:
    text = '#include "spine/ipc/ring.hpp"\n#include "spine/law/slot.hpp"\n#include <vector>\n'
    assert list(rooms.check_cpp("spine/loop/tick.cpp", text)) == []
    assert list(rooms.check_cpp("spine/guard/guard.cpp", "#include <lithe/law.hpp>\n")) == []
    assert list(rooms.check_cpp("laws/pd.cpp", "#include <lithe/law.hpp>\n#include <cmath>\n")) == []


def test_the_brain_may_import_nothing_but_the_standard_library_and_numpy() -> None:
    problems = list(rooms.check_python("brain/lithe/a.py", "import json\nimport numpy as np\nimport requests\n"))
    assert problems == ["brain/lithe/a.py:3: brain may not import requests; it has the standard library and numpy"]


def test_the_table_has_no_cycle() -> None:
    def reach(room: str, seen: frozenset[str]) -> None:
        assert room not in seen, f"{room} reaches itself"
        for other in rooms.ALLOWED[room]:
            reach(other, seen | {room})

    for room in rooms.ALLOWED:
        reach(room, frozenset())


def test_this_tree_keeps_the_table() -> None:
    assert rooms.check_tree(Path(rooms.__file__).parent.parent) == []


ROOT = Path(rooms.__file__).parent.parent
MAP = (ROOT / "ARCHITECTURE.md").read_text()


@pytest.mark.parametrize(
    ("there", "instead", "reason"),
    [
        ("  guard/    ", "  gard/    ", "there is no spine/gard/"),
        ("certificate/)", "certificates/)", "there is no certificates/ in supervisor/"),
        ("process.cpp      □", "processes.cpp    □", "there is no spine/processes.cpp"),
        ("firmware/          □ a sensor board\n", "", "the map lacks firmware/"),
        ("laws, buses, host; core)", "laws, buses; core)", "the map lacks supervisor/cli/host/"),
        ("; core/ (what they share)", "", "the map lacks trial/core/"),
        ("host/doctor, host/tune <- cli/host", "host/tune <- cli/host", "cli/host may include host/doctor"),
        ("ipc <- loop\n", "ipc <- loop, step\n", "spine/step may not include spine/ipc"),
        ("ipc, law, arena, contain <- load", "ipc, law, arena, contian <- load", "may not include contian"),
        ("physics <- KIND/sim", "physics <- KIND", "spine/hal/moteus may not include spine/hal/physics"),
    ],
)
def test_a_map_that_is_not_the_tree_or_not_the_table_is_found(there: str, instead: str, reason: str) -> None:
    def problems(text: str) -> list[str]:
        page = "ARCHITECTURE.md"
        rules = (
            rooms.check_map(page, text, ROOT),
            rooms.check_rooms_named(page, text),
            rooms.check_short_form(page, text),
        )
        return [each for rule in rules for each in rule]

    assert problems(MAP) == []
    assert MAP.count(there) == 1
    assert any(reason in each for each in problems(MAP.replace(there, instead))), problems(MAP.replace(there, instead))


def test_a_folder_that_the_map_of_the_readme_lacks_is_found() -> None:
    text = (ROOT / "README.md").read_text()
    assert list(rooms.check_map("README.md", text, ROOT)) == []
    assert list(rooms.check_map("README.md", text.replace(" docs/ ", " "), ROOT)) == ["README.md: the map lacks docs/"]


def test_the_files_from_text_to_tick_are_those_that_define_a_step_of_the_way() -> None:
    listed = paper.paths_in(ROOT / rooms.WAY_PAGE, rooms.WAY)
    assert list(rooms.check_way(ROOT, listed)) == []
    assert "spine/load/arena_store.cpp" in listed and "core/sequence.hpp" in listed


def test_a_list_that_lacks_a_file_of_the_way_or_has_one_beside_it_is_found(tmp_path: Path) -> None:
    (tmp_path / "supervisor/core").mkdir(parents=True)
    (tmp_path / "spine").mkdir()
    (tmp_path / "supervisor/core/a.cpp").write_text("bool A::ask(int x) {\n}\n")
    (tmp_path / "supervisor/core/a.hpp").write_text("void run(int x);\nclass A {\n};\n")
    (tmp_path / "spine/b.cpp").write_text("  A::ask(2);\nvoid run(\n    int x) LITHE_RT {\n}\n")
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    assert list(rooms.check_way(tmp_path, ["core/a.cpp", "spine/b.cpp"], "A::ask run")) == []
    assert list(rooms.check_way(tmp_path, ["core/a.cpp", "core/a.hpp"], "A::ask run B::go")) == [
        "supervisor/README.md: 'From text to tick' lacks the file that defines run: spine/b.cpp",
        "supervisor/README.md: 'From text to tick' lacks the file that defines B::go: none does",
        "supervisor/README.md: core/a.hpp defines nothing of ON_THE_WAY",
    ]
