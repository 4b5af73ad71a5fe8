# SPDX-License-Identifier: Apache-2.0
"""A test that cannot fail is found, in C++ and in Python; one that asserts through a helper is not taken for one."""

from pathlib import Path

import lint
import pytest
import silent_tests

HELPER = "#pragma once\ninline void expect_quiet(int x) {\n  EXPECT_EQ(x, 0);\n}\n"
SILENT_CPP = {
    "nothing": "TEST(Pi3hat, ATickAllocatesNothing) {\n  int calls = 0;\n  ++calls;\n}\n",
    "in a comment": "TEST(A, B) {\n  tick();  // EXPECT_EQ(x, 0)\n}\n",
    "in a string": 'TEST(A, B) {\n  say("EXPECT_TRUE(x)");\n}\n',
    "a helper of that name elsewhere": "TEST_F(A, B) {\n  expect_loud(1);\n}\n",
    "a helper that asserts nothing": "void look(int) {\n}\nTEST_P(A, B) {\n  look(1);\n}\n",
}
GOOD_CPP = {
    "itself": "TEST(A, B) {\n  EXPECT_EQ(1, 1);\n}\n",
    "a scope that fails": "TEST(A, B) {\n  const NoAllocScope scope;\n  tick();\n}\n",
    "a helper of a header": '#include "x/bench.hpp"\nTEST(A, B) {\n  expect_quiet(1);\n}\n',
    "a helper's helper": "void a(int x) {\n  ASSERT_TRUE(x);\n}\nvoid b() {\n  a(1);\n}\nTEST(A, B) {\n  b();\n}\n",
    "a macro": "#define NEED(x) \\\n  if (!(x)) FAIL()\nTEST(A, B) {\n  NEED(1);\n}\n",
    "a skip that says why": 'TEST(A, B) {\n  GTEST_SKIP() << "no MuJoCo here";\n}\n',
    "no test": "void f() {\n}\n",
}
SILENT_PYTHON = {
    "nothing": "def test_a():\n    print(1)\n",
    "in a word": "def test_a():\n    'assert this'\n",
    "a helper that asserts nothing": "def helper():\n    return 1\ndef test_a():\n    helper()\n",
    "a process nobody looks at": "def test_a():\n    subprocess.run(['false'], check=False)\n",
}
GOOD_PYTHON = {
    "itself": "def test_a():\n    assert 1\n",
    "raises": "def test_a():\n    with pytest.raises(ValueError):\n        int('x')\n",
    "a helper": "def helper():\n    assert 1\ndef test_a():\n    helper()\n",
    "a process that must end well": "def test_a():\n    subprocess.run(['true'], check=True)\n",
}


def found(root: Path, path: str, text: str) -> list[str]:
    (root / "x").mkdir()
    (root / "x/bench.hpp").write_text(HELPER)
    (root / path).parent.mkdir(exist_ok=True)
    (root / path).write_text(text)
    return silent_tests.problems(root, ["x/bench.hpp", path])


@pytest.mark.parametrize("text", SILENT_CPP.values(), ids=SILENT_CPP)
def test_a_silent_cpp_test_is_refused_where_it_stands(tmp_path: Path, text: str) -> None:
    (line,) = found(tmp_path, "x/a_test.cpp", text)
    assert line.startswith(f"x/a_test.cpp:{text[: text.index('TEST')].count(chr(10)) + 1}: the test ")
    assert "asserts nothing" in line


@pytest.mark.parametrize("text", GOOD_CPP.values(), ids=GOOD_CPP)
def test_a_cpp_test_that_asserts_is_none(tmp_path: Path, text: str) -> None:
    assert found(tmp_path, "x/a_test.cpp", text) == []


@pytest.mark.parametrize("text", SILENT_PYTHON.values(), ids=SILENT_PYTHON)
def test_a_silent_python_test_is_refused(tmp_path: Path, text: str) -> None:
    (line,) = found(tmp_path, "tests/test_a.py", text)
    assert line.endswith("the test test_a asserts nothing: say what must hold, or remove it")


@pytest.mark.parametrize("text", GOOD_PYTHON.values(), ids=GOOD_PYTHON)
def test_a_python_test_that_asserts_is_none(tmp_path: Path, text: str) -> None:
    assert found(tmp_path, "tests/test_a.py", text) == []


def test_every_test_of_this_tree_is_seen() -> None:
    """A scan that does not see a test says nothing about it."""
    root = Path(lint.__file__).parent.parent
    seen = macros = 0
    for path in lint.tracked(root):
        if path.endswith("_test.cpp"):
            text = (root / path).read_text()
            seen += sum("." in name for _, name, _ in silent_tests.bodies(text))
            macros += sum(line.startswith(("TEST(", "TEST_F(", "TEST_P(", "TYPED_TEST(")) for line in text.splitlines())
    assert seen == macros > 1000
