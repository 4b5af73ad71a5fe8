# SPDX-License-Identifier: Apache-2.0
"""Our moteus codec and driver write and read byte for byte what the maker's own library does."""

import collections
import json
import subprocess
from collections.abc import Callable
from typing import Any

import pytest
from system.pypi import Package
from system.robot_rig import BIN, ROOT, need

CASES = ROOT / "tests" / "moteus" / "cases.py"
COUNT = 2000
NOP = "50"


@pytest.fixture(scope="module")
def cases() -> list[dict[str, Any]]:
    """What the library says, for random commands, queries, streams and answers."""
    moteus = Package("moteus==1.0.0")
    ran = subprocess.run(
        moteus.command(CASES, str(COUNT), "20"), check=True, env=moteus.env, capture_output=True, text=True, timeout=120
    )
    return [json.loads(line) for line in ran.stdout.splitlines()]


def ask(requests: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Our side's answers."""
    need("frames_peer")
    text = "".join(
        json.dumps({key: value for key, value in each.items() if key != "expect"}) + "\n" for each in requests
    )
    ran = subprocess.run([BIN / "frames_peer"], input=text, check=True, capture_output=True, text=True, timeout=120)
    return [json.loads(line) for line in ran.stdout.splitlines()]


def padded(data: str) -> str:
    """Filled up to a length of CAN FD, as the library's transports do."""
    sizes = [*range(9), 12, 16, 20, 24, 32, 48, 64]
    return data + NOP * (next(size for size in sizes if 2 * size >= len(data)) - len(data) // 2)


def same(case: dict[str, Any], ours: dict[str, Any]) -> bool:
    """Whether ours is what the library expects."""
    expect = dict(case["expect"])
    if case.get("padded"):
        expect["hex"] = padded(expect["hex"])
    if "replies" in expect:  # one number may be written in two ways: 0x1p+0 and 0x1.0p+0
        expect["replies"] = [[number, str(float.fromhex(value))] for number, value in expect["replies"]]
        ours = ours | {"replies": [[number, str(float.fromhex(value))] for number, value in ours["replies"]]}
    return all(ours[key] == value for key, value in expect.items())


def test_every_case_is_the_same_to_the_byte(cases: list[dict[str, Any]], tell: Callable[[str], None]) -> None:
    answers = ask(cases)
    assert len(answers) == len(cases)
    wrong = [(case, ours) for case, ours in zip(cases, answers, strict=True) if not same(case, ours)]
    assert wrong == [], wrong[0]
    kinds = collections.Counter(case["do"] for case in cases)
    tell(", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items())))
    assert kinds["encode"] >= 500 and kinds["decode"] >= 100 and kinds["drive"] >= 100


def test_every_format_of_every_command_register_was_among_them(cases: list[dict[str, Any]]) -> None:
    seen = set()
    for case in cases:
        for part in case.get("parts", []):
            for i, form in enumerate(part.get("formats", [])):
                seen.add((part["kind"], part["start"] + i, form))
    for number in [*range(0x020, 0x02E), *range(0x040, 0x049)]:
        assert all(("write", number, form) in seen for form in range(4)), hex(number)
    for number in [*range(8), *range(0x00A, 0x010)]:
        assert all(("read", number, form) in seen for form in range(4)), hex(number)


def test_a_case_that_is_not_the_same_is_found(cases: list[dict[str, Any]]) -> None:
    for do in ("encode", "decode", "drive"):
        case = next(each for each in cases if each["do"] == do)
        ours = ask([case])[0]
        assert same(case, ours)
        if do == "decode":
            case = case | {"expect": case["expect"] | {"replies": [[1, "0x1p+40"]]}}
        else:
            case = case | {"expect": case["expect"] | {"hex": "00" + case["expect"]["hex"][2:-2] + "77"}}
        assert not same(case, ours)
