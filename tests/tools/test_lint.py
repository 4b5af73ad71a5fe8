# SPDX-License-Identifier: Apache-2.0
"""The text rules see what they are there to see."""

from pathlib import Path

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


def test_a_word_that_the_glossary_replaces_is_found_in_names_comments_and_pages() -> None:
    for path, line, word in [
        ("supervisor/swap/a.cpp", "void begin(Transaction& swap);", "Transaction"),
        ("supervisor/swap/a.cpp", "  open_transaction();", "transaction"),
        ("docs/swap.md", "A swap is a transaction.", "transaction"),
        ("brain/lithe/robot.py", "# the bridge to agents", "bridge"),
        ("spine/load/loader.cpp", "law::Resident* freePlace();", "Place"),
        ("spine/loop/tick.cpp", "out_.beat(now_ns);", "beat"),
    ]:
        found = list(lint.check_words(path, f"\n{line}\n"))
        assert len(found) == 1 and found[0].startswith(f"{path}:2: '{word}' is not in the glossary"), (line, found)


def test_a_word_in_its_own_meaning_is_not_found() -> None:
    for path, line in [
        ("supervisor/bus/plan/traffic.cpp", "// Time of a pi3hat's SPI transaction."),
        ("supervisor/swap/swap.cpp", "request.box_ms = 150;  // in the sandbox"),
        ("spine/loop/tick.cpp", "out_.heartbeat(now_ns);"),
        ("brain/lithe/agent/prompt.py", "# the conversation of one round"),
        ("spine/load/loader.hpp", "// laws that lawd placed"),
        ("docs/adr/0018-a-swap-is-one-sequence.md", "`Transaction` was a class."),
    ]:
        assert list(lint.check_words(path, line)) == [], line


def test_a_long_line_of_markdown_is_found_but_not_in_a_table_in_code_or_without_a_space() -> None:
    long = "word " * 30
    assert list(lint.check_columns("docs/a.md", f"{long}\n")) == [
        "docs/a.md:1: 150 columns; 140 at most: break the line"
    ]
    for line in (
        f"| {long} |",
        f"    {long}",
        f"# {long}",
        f"```\n{long}\n```",
        f"[x](http://{'a' * 150})",
        long[:140],
    ):
        assert list(lint.check_columns("docs/a.md", f"{line}\n")) == [], line


def test_a_link_leads_to_a_file_and_a_heading_that_are_there(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/b.md").write_text("# B\n## The `x` of [Y](z)\n## Twice\n## Twice\n```\n## Not\n```\n")
    good = "[a](b.md) [b](b.md#the-x-of-y) [c](b.md#twice-1) [d](#here) [e](https://a.b/c#d) `[f](g)`\n## Here\n"
    assert list(lint.check_links("docs/a.md", good, tmp_path)) == []
    bad = ("[a](c.md)", "[b](b.md#the-x)", "[c](b.md#twice-2)", "[d](#there)", "[e](b.md#not)", "## " + "word " * 20)
    for line in bad:
        assert len(list(lint.check_links("docs/a.md", f"{line}\n## Here\n", tmp_path))) == 1, line
