# SPDX-License-Identifier: Apache-2.0
"""Tests that cannot fail: those that assert nothing, neither by themselves nor through a helper they call.

A helper counts by its name. In C++ it is looked for in the test's own file and in the headers of this tree that it
includes, in Python among all functions of the tests' folders. Whether an assertion is reached, and whether it can
fail, is beyond this scan.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import cpp_text

CPP_TEST = re.compile(r"\b(?:TYPED_)?TEST(?:_F|_P)?\s*\(\s*(\w+)\s*,\s*(\w+)\s*\)")
CPP_ASSERTS = re.compile(r"\b(?:EXPECT_\w+|ASSERT_\w+|ADD_FAILURE\w*|FAIL|NoAllocScope|RC_ASSERT)\b")
SKIPS = re.compile(r"\s*GTEST_SKIP\(\)[^;]*;\s*\}\s*")  # and nothing else: it says itself that it shows nothing
INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.M)
CALL = re.compile(r"\b([A-Za-z_]\w*)\s*(?:<[^;{}()]*>)?\s*\(")
DEFINE = re.compile(r"^[ \t]*#[ \t]*define[ \t]+(\w+)((?:[^\n]*\\\n)*[^\n]*)", re.M)
NAME = re.compile(r"([A-Za-z_]\w*)\s*\(")
PYTHON_TEST_FOLDERS = ("tests/", "brain/tests/", "examples/", "conftest.py")
# What fails by itself when something is not as it must be.
PYTHON_ASSERTS = {"raises", "warns", "fail", "assert_allclose", "assert_array_equal"}


def bodies(text: str) -> Iterator[tuple[int, str, str]]:
    """(line, name, body) of every function and every test in C++ text; comments and strings are blank."""
    plain = cpp_text.NOISE.sub(cpp_text.blank, text)
    lines = plain.split("\n")
    for line, length in cpp_text.cpp_functions(text):
        whole = "\n".join(lines[line - 1 : line - 1 + length])
        head, _, body = whole.partition("{")
        test = CPP_TEST.search(head)
        name = NAME.search(head)
        yield line, f"{test[1]}.{test[2]}" if test else name[1] if name else "", body
    for macro in DEFINE.finditer(plain):
        yield plain.count("\n", 0, macro.start()) + 1, macro[1], macro[2]


def asserting(functions: list[tuple[str, set[str], bool]]) -> set[str]:
    """Names that assert; each function is (name, names it calls, asserts by itself)."""
    known = {name for name, _, itself in functions if itself}
    grew = True
    while grew:
        more = {name for name, calls, _ in functions if name not in known and calls & known}
        known |= more
        grew = bool(more)
    return known


class Cpp:
    """The C++ files of a tree, each read once."""

    def __init__(self, root: Path) -> None:
        """Nothing is read yet."""
        self.root = root
        self.read: dict[str, tuple[list[tuple[int, str, str]], list[str]]] = {}

    def file(self, path: str) -> tuple[list[tuple[int, str, str]], list[str]]:
        """Functions of a file, and what it includes of this tree."""
        if path not in self.read:
            text = (self.root / path).read_text()
            included = [each for each in INCLUDE.findall(text) if (self.root / each).is_file()]
            self.read[path] = list(bodies(text)), included
        return self.read[path]

    def silent(self, path: str) -> Iterator[str]:
        """Tests of one file that assert nothing."""
        own, waiting = self.file(path)
        functions, seen = list(own), {path}
        reached = list(waiting)
        while reached:
            header = reached.pop()
            if header in seen:
                continue
            seen.add(header)
            theirs, further = self.file(header)
            functions += theirs
            reached += further
        described = [(name, set(CALL.findall(body)), bool(CPP_ASSERTS.search(body))) for _, name, body in functions]
        known = asserting(described)
        for line, name, body in own:
            if "." not in name or SKIPS.fullmatch(body):
                continue
            if not (CPP_ASSERTS.search(body) or set(CALL.findall(body)) & known):
                yield f"{path}:{line}: the test {name} asserts nothing: say what must hold, or remove it"


def called(node: ast.AST) -> set[str]:
    """Last words of all that a piece of Python calls."""
    names = set()
    for each in ast.walk(node):
        if isinstance(each, ast.Call):
            target = each.func
            names |= {target.attr} if isinstance(target, ast.Attribute) else set()
            names |= {target.id} if isinstance(target, ast.Name) else set()
    return names


def python_asserts(node: ast.AST) -> bool:
    """Whether a piece of Python can fail by itself: assert, raise, check=True, pytest.raises and the like."""
    for each in ast.walk(node):
        if isinstance(each, ast.Assert | ast.Raise):
            return True
        if isinstance(each, ast.keyword) and each.arg == "check" and getattr(each.value, "value", None) is True:
            return True
    return bool(called(node) & PYTHON_ASSERTS)


def python_functions(text: str) -> list[ast.FunctionDef | ast.AsyncFunctionDef]:
    """All functions and methods of Python text, those within functions too."""
    return [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]


def silent_python(texts: dict[str, str]) -> Iterator[str]:
    """Tests in these files that assert nothing."""
    functions = [(path, node) for path, text in texts.items() for node in python_functions(text)]
    known = asserting([(node.name, called(node), python_asserts(node)) for _, node in functions])
    for path, node in functions:
        if node.name.startswith("test_") and not (python_asserts(node) or called(node) & known):
            yield f"{path}:{node.lineno}: the test {node.name} asserts nothing: say what must hold, or remove it"


def problems(root: Path, paths: list[str]) -> list[str]:
    """All silent tests among these files of a tree."""
    cpp = Cpp(root)
    found = [line for path in paths if path.endswith(".cpp") for line in cpp.silent(path)]
    python = {path: (root / path).read_text() for path in paths if path.endswith(".py")}
    return found + list(silent_python({k: v for k, v in python.items() if k.startswith(PYTHON_TEST_FOLDERS)}))
