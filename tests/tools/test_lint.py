# SPDX-License-Identifier: Apache-2.0
"""The text rules see what they are there to see."""

import cpp_text
import lint


def body(lines: int) -> str:
    return "".join(f"  x({i});\n" for i in range(lines))


def test_a_file_over_the_limit_is_refused_and_one_at_the_limit_is_not() -> None:
    assert list(lint.check_lengths("spine/a.hpp", "\n" * 400)) == []
    assert "401 lines" in next(lint.check_lengths("spine/a.hpp", "\n" * 401))


def test_a_generated_file_may_be_long() -> None:
    assert list(lint.check_lengths("spine/wire/wire.hpp", "\n" * 1000)) == []


def test_a_cpp_function_over_the_limit_is_refused_where_it_starts() -> None:
    text = (
        "namespace a {\nstruct B {\n  int c = 1;\n};\n\nint f(int x) noexcept {\n  if (x) {\n"
        + body(58)
        + "  }\n}\n}  // namespace\n"
    )
    assert list(lint.check_lengths("spine/a.cpp", text)) == [
        "spine/a.cpp:6: a function of 62 lines; 60 at most: name its steps"
    ]


def test_many_short_functions_and_braces_in_strings_are_no_long_function() -> None:
    text = "".join(f"void f{i}() {{\n  s(\"}}{{\", '{{');  // {{\n}}\n" for i in range(60))
    assert len(list(cpp_text.cpp_functions(text))) == 60
    assert list(lint.check_lengths("spine/a.cpp", text)) == []


def test_a_constructor_and_a_trailing_return_type_are_functions() -> None:
    text = "A::A(int x) : x_(x) {\n}\nauto f(int) const -> int {\n}\nTEST(Room, Sentence) {\n}\n"
    assert [line for line, _ in cpp_text.cpp_functions(text)] == [1, 3, 5]


def test_a_python_function_over_the_limit_is_refused() -> None:
    text = "def f():\n" + "    x = 1\n" * 60
    assert "a function of 61 lines" in next(lint.check_lengths("tools/a.py", text))


def test_a_folder_over_the_limit_is_refused_and_one_at_the_limit_or_a_corpus_is_not() -> None:
    full = [f"spine/a/{number}.cpp" for number in range(20)]
    assert list(lint.check_folders([*full, "spine/a/test/rig.hpp", "Makefile"])) == []
    assert list(lint.check_folders([*full, "spine/a/README.md"])) == [
        "spine/a: 21 files; 20 at most: give what belongs together a folder"
    ]
    for corpus in lint.CORPORA:
        assert (lint.ROOT / corpus).is_dir(), f"{corpus} is gone: it needs no exception"
        assert list(lint.check_folders([f"{corpus}/{number}" for number in range(21)])) == []


def test_a_file_without_the_licence_line_is_refused() -> None:
    assert list(lint.check_licence("spine/a.cpp", "#include <a>\n"))
    assert list(lint.check_licence("spine/a.cpp", "// SPDX-License-Identifier: Apache-2.0\n")) == []
    assert list(lint.check_licence("robots/arm.toml", "[robot]\n"))


def test_unfinished_work_is_refused() -> None:
    assert list(lint.check_unfinished("spine/a.cpp", "int a;  // TODO: b\n"))
    assert list(lint.check_unfinished("spine/a.cpp", "int hacksaw_todo;\n")) == []


def test_every_exemption_is_listed_with_its_reason() -> None:
    text = 'int a;\nLITHE_RT_EXEMPT("one bounded send", { send(); });\n'
    assert list(lint.exemptions("spine/hal/bus/can.cpp", text)) == ["spine/hal/bus/can.cpp:2: one bounded send"]


def style(text: str, path: str = "spine/a.cpp") -> list[str]:
    return [problem.split(": ", 1)[1] for problem in lint.check_style(path, text)]


def test_a_line_over_120_columns_is_refused_in_a_comment_and_in_code() -> None:
    assert style(f"// {'é' * 117}\n") == []
    assert style(f"// {'x' * 118}\n") == ["121 columns; 120 at most"]
    assert style(f'  call("{"x" * 110}");\n') == ["121 columns; 120 at most"]
    assert style(f"// {'x' * 118}\n", "spine/wire/wire.hpp") == [], "generated"


def test_a_contract_begins_a_line() -> None:
    assert style("// Reads it.\n// Contract: RT\n// a  Contracts: x\n") == []
    assert style("// Reads it. Contract: RT\n") == ["'Contract:' begins a line of its own"]
