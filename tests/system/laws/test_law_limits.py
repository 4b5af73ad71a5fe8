# SPDX-License-Identifier: Apache-2.0
"""The limits that docs/laws.md names are those of the code."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
CONSTANT = {  # name -> (file, the words of the table with its value, what the code counts in)
    "kMaxJobSourceBytes": ("lawd/service.cpp", "with text around the code | {} MiB", 1 << 20),
    "kMaxSourceBytes": ("lawd/source/admission_source.cpp", "the code in it | {} KiB", 1 << 10),
    "kMaxNested": ("lawd/source/admission_source.cpp", "brackets nested {} deep", 1),
    "kMaxTextBytes": ("lawd/object/admission_object.cpp", "machine code; constants | {} KiB", 1 << 10),
    "kMaxConstantBytes": ("lawd/object/admission_object.cpp", "KiB; {} KiB |", 1 << 10),
    "kMaxFrameBytes": ("lawd/object/admission_stack.cpp", "stack | {} KiB in one function", 1 << 10),
    "kMaxStackBytes": ("lawd/object/admission_stack.cpp", "{} KiB along the deepest calls", 1 << 10),
    "kMaxStateBytes": ("spine/law/include/lithe/law.hpp", "`State` | {} bytes", 1),
    "kMaxStateFields": ("spine/law/include/lithe/law.hpp", "bytes, {} fields", 1),
    "kMaxParams": ("spine/law/include/lithe/law.hpp", "`Params`, `Probes` | {},", 1),
    "kMaxProbes": ("spine/law/include/lithe/law.hpp", "`Params`, `Probes` | 32, {} |", 1),
    "kMaxNameChars": ("spine/law/include/lithe/law.hpp", "names | {} characters of a field", 1),
    "kMaxSensors": ("spine/law/include/lithe/law.hpp", "inputs of the Brain | 32, {}, 16 |", 1),
}


def value(text: str, name: str) -> int:
    """`name` in C++: a number, std::size_t{1} << 20, or 16u << 10."""
    match = re.search(name + r" = (?:std::size_t\{)?(\d+)[u}]*(?: << (\d+))?[,;]", text)
    assert match, name
    return int(match[1]) << int(match[2] or 0)


@pytest.mark.parametrize("name", CONSTANT)
def test_a_limit_in_the_table_is_the_one_in_the_code(name: str) -> None:
    file, words, unit = CONSTANT[name]
    limit = value((ROOT / file).read_text(), name)
    assert words.format(limit // unit) in (ROOT / "docs/laws.md").read_text()
    assert words.format(limit // unit + 1) not in (ROOT / "docs/laws.md").read_text()
