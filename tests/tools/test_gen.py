# SPDX-License-Identifier: Apache-2.0
"""The generator refuses what would give two sides two layouts, and says where and how to mend it."""

import subprocess
import sys
from pathlib import Path

import gen
import pytest
from lithe.shm import schema_difference
from wiregen import schema

# Line 12 is `fields = """` of Sample; a case puts its lines from line 13 on.
TEXT = '''\
abi_major = 1
[const]
NJ = 3
[message.SegmentHeader]
text = "First."
fields = """
uint64 magic
"""

[message.Sample]
text = "Second."
fields = """
{fields}
"""

[segment.spine]
writer = "spine"
items = """
{items}
"""
'''
GOOD_FIELDS = "uint64 tick\nfloat64[NJ] position_rad  # [rad] measured"
GOOD_ITEMS = "ring Sample samples 16"

# field lines, the line that is wrong, what is said, what is proposed
BAD_FIELDS = [
    ("float32 x_m  # [m]", 13, "unknown type 'float32'", "use one of uint8,"),
    ("uint64 tick\nfloat64 angle_deg  # [rad]", 14, "does not end in '_rad'", "name it so, or mend the unit"),
    ("float64 speed_rad_s  # [rad]", 13, "does not end in '_rad'", "name it so"),
    ("float64 mass  # [lb]", 13, "unknown unit [lb]", "use one of rad,"),
    ("float64 gain  # how much", 13, "a float64 without a unit", "[1] for a pure number"),
    ("int64 t_ns", 13, "ends in '_ns' but says no unit", "write `# [ns] ...`"),
    ("float64 ratio_rad  # [1]", 13, "ends in '_rad' but says no unit", "or rename it"),
    ("uint32 mode\nuint64 tick", 14, "4 hidden bytes of padding before it (offset 4)", "put `uint8[4] pad4` on"),
    ("uint64 tick\nuint32 mode", 10, "is 12 bytes, not a multiple of 8", "put `uint8[4] pad12` at its end"),
    ("uint64 tick\nuint64 other\nuint64 tick", 15, "Sample.tick is there twice", "rename one of them"),
    ("uint64[NQ] bin", 13, "unknown size 'NQ'", "use a number or one of NJ"),
    ("uint64[0] bin", 13, "an array of no elements", "give it at least one"),
    ("uint64", 13, "not a field of Sample", "write `type name  # [unit] text`"),
    ("", 10, "message Sample has no fields", "give it some, or remove it"),
    # the same line stands in SegmentHeader too
    ("uint64 magic\nuint64 magic", 14, "Sample.magic is there twice", "rename one of them"),
]
BAD_ITEMS = [
    ("ring Sample samples 12", 19, "depth 12 is not a power of two", "write e.g. `ring Sample samples 16`"),
    ("ring Sample samples", 19, "depth 0 is not a power of two", "16`"),
    ("ring Sample samples 1", 19, "depth 1 is not a power of two", "16`"),
    ("word estop\nchannel Smaple latest", 20, "unknown message 'Smaple'", "use one of SegmentHeader, Sample"),
    ("queue Sample samples 16", 19, "not an item of segment spine", "kind one of channel, ring,"),
    ("channel Sample latest[NQ]", 19, "unknown size 'NQ'", "use a number or one of NJ"),
    ("word estop\nword estop", 20, "spine/estop is there twice", "rename one of them"),
]


def write(folder: Path, fields: str = GOOD_FIELDS, items: str = GOOD_ITEMS) -> Path:
    path = folder / "wire.toml"
    path.write_text(TEXT.format(fields=fields, items=items))
    return path


def refusal(path: Path) -> tuple[int, str]:
    """The line and the text of the error that reading `path` gives."""
    with pytest.raises(schema.SchemaError) as caught:
        schema.load(path)
    text = str(caught.value)
    assert text.startswith(f"{path}:"), text
    return int(text.removeprefix(f"{path}:").split(":")[0]), text


@pytest.mark.parametrize(("fields", "line", "what", "fix"), BAD_FIELDS)
def test_a_bad_field_is_refused_with_its_line_and_the_fix(
    tmp_path: Path, fields: str, line: int, what: str, fix: str
) -> None:
    at, text = refusal(write(tmp_path, fields=fields))
    assert at == line, text
    assert what in text
    assert fix in text.split("fix:")[1]


@pytest.mark.parametrize(("items", "line", "what", "fix"), BAD_ITEMS)
def test_a_bad_item_is_refused_with_its_line_and_the_fix(
    tmp_path: Path, items: str, line: int, what: str, fix: str
) -> None:
    at, text = refusal(write(tmp_path, items=items))
    # GOOD_FIELDS has two lines: `items` opens on line 19.
    assert at == line + 1, text
    assert what in text
    assert fix in text.split("fix:")[1]


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("[const]", "[consts]", "unknown section 'consts'"),
        ('writer = "spine"', "", "segment spine has no writer"),
        ("[message.SegmentHeader]", "[message.Header]", "message SegmentHeader is missing"),
        ("[const]", "[const", "not valid TOML"),
        ("[const]", "[enum.Mode]\na = 1\nb = 1\n[const]", "two names of Mode have the same value"),
    ],
)
def test_a_bad_table_is_refused(tmp_path: Path, old: str, new: str, what: str) -> None:
    path = write(tmp_path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(schema.SchemaError, match=what):
        schema.load(path)


def test_a_good_schema_gives_offsets_without_holes(tmp_path: Path) -> None:
    loaded = schema.load(write(tmp_path))
    sample = loaded.messages["Sample"]
    assert [(f.name, f.offset, f.size) for f in sample.fields] == [("tick", 0, 8), ("position_rad", 8, 24)]
    assert sample.size == 32
    assert loaded.segments["spine"].items[0].offset == schema.LINE


def test_check_names_each_stale_file_and_write_mends_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--root", str(tmp_path)]
    assert gen.main(["--check", *arguments]) == 1, "nothing is there yet"
    assert gen.main(["--write", *arguments]) == 0
    assert gen.main(["--check", *arguments]) == 0
    edited = tmp_path / "spine/wire/wire.hpp"
    edited.write_text(edited.read_text().replace("kNj = 32", "kNj = 31"))
    (tmp_path / "schema/msg/Plan.msg").unlink()
    capsys.readouterr()
    assert gen.main(["--check", *arguments]) == 1
    said = capsys.readouterr().err
    assert "spine/wire/wire.hpp is stale: run `python3 tools/gen.py --write`" in said
    assert "schema/msg/Plan.msg is stale" in said
    assert said.count("stale") == 2
    assert gen.main(["--write", *arguments]) == 0
    assert gen.main(["--check", *arguments]) == 0


def test_check_notices_a_file_of_a_message_that_is_gone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--root", str(tmp_path)]
    assert gen.main(["--write", *arguments]) == 0
    gone = tmp_path / "schema/msg/Gone.msg"
    gone.write_text("uint64 tick\n")
    assert gen.main(["--check", *arguments]) == 1
    assert "schema/msg/Gone.msg is stale" in capsys.readouterr().err
    assert gen.main(["--write", *arguments]) == 0
    assert not gone.exists()


def test_a_bad_schema_stops_the_generator_with_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, fields="float32 x_m  # [m]")
    assert gen.main(["--write", "--schema", str(path), "--root", str(tmp_path / "out")]) == 1
    assert f"gen.py: {path}:13: unknown type 'float32'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def canonical(folder: Path, fields: str, items: str = GOOD_ITEMS) -> str:
    return schema.load(write(folder, fields, items)).canonical()


def test_a_message_that_grew_at_its_end_is_still_understood(tmp_path: Path) -> None:
    # 32 and then 40 bytes: both fit a slot of the same size, so no item moves.
    old, new = canonical(tmp_path, GOOD_FIELDS), canonical(tmp_path, GOOD_FIELDS + "\nuint64 late")
    assert schema_difference(ours=old, theirs=new) == ""
    assert schema_difference(ours=new, theirs=old) == "  here  Sample.late:uint64[1]:32:8:-\n  there (absent)"


@pytest.mark.parametrize(
    ("fields", "items", "expected"),
    [
        ("float64[NJ] position_rad  # [rad]\nuint64 tick", GOOD_ITEMS, "Sample.tick:uint64[1]:24:8:-"),
        ("int64 tick\nfloat64[NJ] position_rad  # [rad]", GOOD_ITEMS, "Sample.tick:int64[1]:0:8:-"),
        ("uint64 tick\nfloat64[NJ] speed_rad_s  # [rad/s]", GOOD_ITEMS, "(absent)"),
        (GOOD_FIELDS, "ring Sample samples 32", "spine/samples:ring:Sample:32x1:128"),
        (GOOD_FIELDS, "word estop\nring Sample samples 16", "spine/samples:ring:Sample:16x1:256"),
    ],
)
def test_any_other_change_is_told_apart(tmp_path: Path, fields: str, items: str, expected: str) -> None:
    difference = schema_difference(canonical(tmp_path, GOOD_FIELDS), canonical(tmp_path, fields, items))
    assert f"there {expected}" in difference


def test_a_message_that_outgrew_its_slot_moves_the_items_behind_it(tmp_path: Path) -> None:
    items = "ring Sample samples 16\nword estop"
    old = canonical(tmp_path, GOOD_FIELDS, items)
    new = canonical(tmp_path, GOOD_FIELDS + "\nuint64[8] more", items)
    assert "here  spine/estop" in schema_difference(old, new)


def test_the_generated_files_of_this_tree_are_fresh() -> None:
    assert gen.main(["--check"]) == 0, "python3 tools/gen.py --write"


def test_the_generator_runs_as_a_program_of_the_plain_interpreter() -> None:
    done = subprocess.run([sys.executable, gen.__file__, "--check"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_c_side_without_the_numbers_is_refused() -> None:
    with pytest.raises(schema.SchemaError, match="0 lines #define LITHE_LINE; it must have one"):
        gen.with_layout("int x;\n", schema.load(gen.ROOT / "schema/wire.toml"))
