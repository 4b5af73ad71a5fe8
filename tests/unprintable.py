# SPDX-License-Identifier: Apache-2.0
"""What a terminal, a log or a reader may take otherwise than it stands there; as bytes: spine/core/text_test.cpp."""

CHARACTERS = [
    "\x1b[2J", "a\nb", "a\tb", "a\rb", "a\0b", "\x7f", "\x9b31m",  # terminals obey these
    "\u202etxt.cpp", "\u2066x", "\u061c", "\u200e",  # the direction of writing
    "\u200b", "\u2028", "\ufeffa", "\u00ad", "\U000e0041",  # invisible
]  # fmt: skip
NO_UTF8 = [b"\xff", b"\x80", b"ab\xc3", b"\xe2\x82z", b"\xc0\xaf", b"\xc1\xbf", b"\xe0\x80\x80", b"\xed\xa0\x80"]
GOOD = ["pd.cpp", "Schulter_ä.cpp", "肘.cpp", "a b.cpp"]


def is_shown_as_it_is(text: str) -> bool:
    """Line by line; written independently of what it judges."""
    return all(line.isprintable() for line in text.replace("\t", " ").split("\n"))
