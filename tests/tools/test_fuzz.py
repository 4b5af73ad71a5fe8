# SPDX-License-Identifier: Apache-2.0
"""The runner of the fuzzers tells what one found, and where it is kept."""

from pathlib import Path

import fuzz


def fuzzer(folder: Path, says: str, code: int) -> None:
    """A program that behaves like a fuzzer: writes seeds, keeps an input when it fails."""
    (folder / "bin").mkdir()
    program = folder / "bin/fuzz_codec"
    program.write_text(
        f'#!/bin/sh\n[ "$1" = --seeds ] && exit 0\nfor word; do case $word in -artifact_prefix=*) '
        f'[ {code} = 0 ] || touch "${{word#*=}}crash-1";; esac; done\necho "{says}" >&2\nexit {code}\n'
    )
    program.chmod(0o755)


def test_a_good_run_tells_how_much_was_done(tmp_path: Path) -> None:
    fuzzer(tmp_path, "#9 DONE cov: 123 ft: 456 corp: 1/2b\nstat::number_of_executed_units: 789", 0)
    assert fuzz.targets(tmp_path) == ["codec"]
    well, line = fuzz.fuzz(tmp_path, "codec", 1)
    assert well
    assert "789 runs" in line
    assert "123 edges" in line


def test_a_find_is_a_failure_with_its_reason_and_its_input(tmp_path: Path) -> None:
    fuzzer(tmp_path, "refuted: a frame is a frame\nSUMMARY: libFuzzer: deadly signal", 77)
    well, line = fuzz.fuzz(tmp_path, "codec", 1)
    assert not well
    assert "a frame is a frame" in line
    assert "found/codec/crash-1" in line


def test_what_sanitizers_say_is_a_reason() -> None:
    assert "overflow" in fuzz.why("INFO: x\na.cpp:3:4: runtime error: signed integer overflow\nmore")
    assert fuzz.why("nothing") == "it ended without a reason"
