# SPDX-License-Identifier: Apache-2.0
"""C++ text without a compiler: what is code in it, and where its functions are."""

import re
from collections.abc import Iterator

NOISE = re.compile(
    r'R"(?P<tag>\w*)\((?:.|\n)*?\)(?P=tag)"|"(?:\\.|[^"\\\n])*"|(?<![0-9a-fA-F])\'(?:\\.|[^\'\\\n])+\'|//[^\n]*|/\*(?:.|\n)*?\*/'
)
NOT_A_FUNCTION = re.compile(
    r"\b(namespace|struct|class|enum|union|extern|if|for|while|switch|catch|do|else|try)\b[^;{}]*$"
)


def blank(match: re.Match[str]) -> str:
    """White space as long as the match, with its line breaks."""
    return re.sub(r"[^\n]", " ", match[0])


def cpp_functions(text: str) -> Iterator[tuple[int, int]]:
    """(first line, length in lines) of every function body in C++ text, found by its braces."""
    text = re.sub(r"^[ \t]*#(?:[^\n]*\\\n)*[^\n]*", blank, NOISE.sub(blank, text), flags=re.M)
    depth_of_function = None
    depth = start = head = 0
    for at, char in enumerate(text):
        if char == "{":
            before = text[head:at]
            if depth_of_function is None and ")" in before and not NOT_A_FUNCTION.search(before.split("(")[0]):
                depth_of_function = depth
                start = head + len(before) - len(before.lstrip())
            depth += 1
        elif char == "}":
            depth -= 1
            if depth_of_function == depth:
                depth_of_function = None
                yield text.count("\n", 0, start) + 1, text.count("\n", start, at) + 1
        if char in "{};" and depth_of_function is None:
            head = at + 1


SCOPE = re.compile(r"\b(?:class|struct)\s+(?:alignas\([^)]*\)\s*)?(\w+)[^;{}()<>]*\{")


def closing_brace(text: str, opening: int) -> int:
    """Where the brace that opens there is closed."""
    depth = 0
    for match in re.finditer(r"[{}]", text[opening:]):
        depth += 1 if match[0] == "{" else -1
        if depth == 0:
            return opening + match.start()
    return len(text)


def named_functions(text: str) -> Iterator[tuple[str, str]]:
    """(name, code without comments) of every function body in C++ text; members as Class::name, overloads apart."""
    code = NOISE.sub(blank, text)
    scopes = [(match[1], match.start(), closing_brace(code, match.end() - 1)) for match in SCOPE.finditer(code)]
    lines = code.splitlines(keepends=True)
    for line, length in cpp_functions(text):
        start = sum(map(len, lines[: line - 1]))
        body = "".join(lines[line - 1 : line - 1 + length])
        around = [name for name, begin, end in scopes if begin < start < end]
        if name := re.search(r"(\w+)\s*\(", body):
            yield "::".join([*around[-1:], name[1]]), body
