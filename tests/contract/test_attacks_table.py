"""The table of attacks: its data and the page say the same, no attack is missing, none succeeded."""

from __future__ import annotations

import json
from pathlib import Path

from tests.hostile.attacks import ATTACKS, ROOT, files
from tests.hostile.table import DATA, PAGE, rows_of, with_section

RESULT = """\
<testsuites><testsuite name="abc1234" timestamp="2026-01-02T03:04:05"><testcase classname="tests.hostile.test_flood" name="a" />
<testcase classname="tests.hostile.test_flood" name="b"><failure>late</failure></testcase>
<testcase classname="tests.hostile.test_flood" name="c"><skipped>no cyclictest</skipped></testcase>
<testcase classname="tests.hostile.test_boundaries" name="d"><properties><property name="read" value="3" />
<property name="refused" value="97" /></properties></testcase>
<testcase classname="tests.hostile.test_many_sessions" name="e"><properties><property name="tried" value="67" />
<property name="failed" value="2" /></properties><failure>two</failure></testcase></testsuite></testsuites>
"""


def test_the_page_has_the_table_of_its_data() -> None:
    page = PAGE.read_text()
    assert with_section(page, json.loads(DATA.read_text())) == page, "python -m tests.hostile.table page"


def test_no_attack_succeeded() -> None:
    rows = json.loads(DATA.read_text())["attacks"]
    page = PAGE.read_text()
    assert all(f"\n| {attack} | " in page for attack in ATTACKS)
    assert [attack for attack, row in rows.items() if row["failed"] or not row["tried"]] == []


def test_every_attack_has_files_that_are_there_and_no_file_two() -> None:
    named = [file for each in ATTACKS.values() for file in each]
    assert len(named) == len({*named}) and all((ROOT / file).is_file() for file in files())


def test_tries_failures_and_what_was_left_out_are_counted(tmp_path: Path) -> None:
    (tmp_path / "r.xml").write_text(RESULT)
    rows = rows_of([tmp_path / "r.xml"])
    counted = {attack: (row["tried"], row["failed"], row["left_out"]) for attack, row in rows.items()}
    boundaries = "bytes at all boundaries: files, frames, options"
    assert counted == {"floods of the link": (2, 1, 1), boundaries: (100, 0, 0), "faults at random instants": (67, 2, 0)}
    assert {(row["commit"], row["date"]) for row in rows.values()} == {("abc1234", "2026-01-02")}
