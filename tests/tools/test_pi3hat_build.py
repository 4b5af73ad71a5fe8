# SPDX-License-Identifier: Apache-2.0
"""A build with a pi3hat compiles the maker's library from where somebody has put it."""

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OURS = "spine/hal/CMakeFiles/lithe_hal_bus_pi3hat.dir/bus/pi3hat/port/upstream.cpp.o"


def configure(build: Path, place: Path) -> subprocess.CompletedProcess[str]:
    options = ["-DLITHE_TESTS=OFF", "-DLITHE_PI3HAT=ON", f"-DLITHE_PI3HAT_DIR={place}"]
    command = ["cmake", "-S", str(ROOT), "-B", str(build), "-G", "Ninja", *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def test_the_makers_sources_as_they_are_unpacked_are_built_along(tmp_path: Path) -> None:
    """Laid out as the maker's release, with a board of ours in it; nothing of it was built before."""
    configured = configure(tmp_path / "build", ROOT / "tests/pi3hat/maker")
    assert configured.returncode == 0, configured.stderr
    command = ["ninja", "-C", str(tmp_path / "build"), "lithe_pi3hat_maker", OURS]
    built = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert built.returncode == 0, built.stdout
    library = next((tmp_path / "build").rglob("liblithe_pi3hat_maker.so"))
    symbols = subprocess.run(["nm", "-CD", str(library)], capture_output=True, text=True, check=True).stdout
    assert "mjbots::pi3hat::Pi3Hat::Cycle" in symbols


def test_a_place_without_them_is_refused_with_how_to_get_them(tmp_path: Path) -> None:
    """The message names what was looked for and where."""
    configured = configure(tmp_path / "build", tmp_path)
    assert configured.returncode != 0
    said = " ".join(configured.stderr.split())
    for phrase in ("lib/cpp/mjbots/pi3hat/pi3hat.cc", str(tmp_path), "git clone", "-DLITHE_PI3HAT_DIR="):
        assert phrase in said, said
