# SPDX-License-Identifier: Apache-2.0
"""Checks that text from outside is safe to show in a terminal, a log or a certificate."""

from __future__ import annotations

from typing import Any

MOST_SHOWN = 100


def unprintable_in(value: Any, name: str = "") -> str | None:
    """The first key or text in a request that is not printable, written out harmlessly; None when all are.

    Printable is what str.isprintable() says: no control characters, line ends, escapes, nothing invisible or that turns
    the direction of writing. The supervisor asks the same of its own socket (spine/core/text.hpp). The `source` of a
    law is not asked: it has rules of its own.
    """
    if not name.isprintable():
        return repr(name[:MOST_SHOWN])
    if isinstance(value, str) and name != "source" and not value.isprintable():
        return repr(value[:MOST_SHOWN])
    if isinstance(value, dict):
        items = list(value.items())
    elif isinstance(value, list):
        items = [("", item) for item in value]
    else:
        return None
    return next((found for key, item in items if (found := unprintable_in(item, key)) is not None), None)
