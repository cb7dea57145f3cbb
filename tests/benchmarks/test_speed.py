"""What the speed benchmarks print, and where the README has it."""

from pathlib import Path

import pytest

from benchmarks.speed import PARTS, README, main
from benchmarks.speed.measure import Spread, alone, figure, missing
from benchmarks.speed.table import BEGIN, END, document, rewrite, table


def test_a_ratio_is_taken_turn_by_turn():
    compared = figure("a", "s", [2.0, 30.0, 4.0], "b", [1.0, 10.0, 4.0])
    assert compared.value == Spread(4.0, 2.0, 30.0)
    assert compared.ratio == Spread(2.0, 1.0, 3.0)


def test_every_line_of_a_table_has_the_columns_of_its_head():
    figures = [figure("a", "s", [1.0], "b", [2.0]), alone("b", "s", [2.0]), missing("c", "not installed")]
    head, rule, *lines = table(figures).splitlines()
    assert len(lines) == 3
    assert {line.count("|") for line in (head, rule, *lines)} == {head.count("|")}
    assert "0.5 (0.5 to 0.5)" in lines[0]
    assert "not measured" in lines[2]


def test_only_what_is_between_the_markers_is_rewritten(tmp_path: Path):
    path = tmp_path / "README.md"
    path.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    rewrite(path, "new")
    rewrite(path, "newer")
    assert path.read_text() == f"before\n{BEGIN}\nnewer\n{END}\nafter\n"


@pytest.mark.parametrize("text", ["", f"{END}{BEGIN}", f"{BEGIN}{BEGIN}{END}", f"{BEGIN}{END}{END}"])
def test_a_file_without_the_markers_is_left_alone(tmp_path: Path, text: str):
    path = tmp_path / "README.md"
    path.write_text(text)
    with pytest.raises(ValueError, match="must have"):
        rewrite(path, "new")
    assert path.read_text() == text


def test_the_readme_has_all_parts_as_the_suite_writes_them():
    text = README.read_text()
    inside = text.partition(BEGIN)[2].partition(END)[0]
    head, rule = table([]).splitlines()
    for title in PARTS.values():
        assert f"**{title}**\n\n{head}\n{rule}\n|" in inside
    for line in inside.splitlines():
        assert not line.startswith("|") or line.count("|") == head.count("|")
    assert document({}, PARTS).splitlines()[0].partition(" on ")[0] in inside


def test_a_part_of_no_such_name_is_refused(capsys: pytest.CaptureFixture[str]):
    assert main(["--only", "reading,nothing"]) == 2
    assert "nothing" in capsys.readouterr().err
