"""The table of attacks on the guide's page of faults, made of what pytest wrote: nothing in it is typed.

    python -m tests.hostile.table files                         # what `make test-hostile` runs
    python -m tests.hostile.table page runs/hostile/*.xml       # the results into attacks.json and the page

A test is one try, unless it says how many it made (the properties `tried` and `failed`, or `read` and `refused`).
"""

from __future__ import annotations

import json
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

from tests.hostile.attacks import ATTACKS, ROOT, attack_of, files

DATA: Final = ROOT / "tests/hostile/attacks.json"
PAGE: Final = ROOT / "hil/guide/faults.md"
HEAD: Final = "## Attacks"
TEXT: Final = """\
`make test-hostile` tries all of these and writes this table. A try is one input, one session or one test. Each row says at
which commit and on which day it was run; what this machine could not try is counted as left out.
"""

Row = dict[str, Any]


def rows_of(results: Iterable[Path]) -> dict[str, Row]:
    """Return attack to its row, of JUnit files; the suite's name is the commit."""
    rows: dict[str, Row] = {}
    for result in results:
        for suite in ElementTree.parse(result).iter("testsuite"):
            for case in suite.iter("testcase"):
                if not case.get("classname"):
                    continue  # it was interrupted
                attack = attack_of(f"{case.get('classname', '').replace('.', '/')}.py")
                row = rows.setdefault(attack, {"tried": 0, "failed": 0, "left_out": 0})
                row |= {"commit": suite.get("name"), "date": str(suite.get("timestamp"))[:10]}
                tried, failed, left_out = _counts(case)
                row["tried"] += tried
                row["failed"] += failed
                row["left_out"] += left_out
    return rows


def _counts(case: ElementTree.Element) -> tuple[int, int, int]:
    """Return how many were tried, failed and left out in one test."""
    if case.find("skipped") is not None:
        return 0, 0, 1
    said = {each.get("name"): each.get("value", "0") for each in case.iter("property")}
    tried = int(said.get("tried", 0)) or int(said.get("read", 0)) + int(said.get("refused", 0))
    fell = case.find("failure") is not None or case.find("error") is not None
    return max(tried, 1), max(int(said.get("failed", 0)), int(fell)), 0


def section(data: Mapping[str, Any]) -> str:
    """Return the section of the page, its heading first."""
    lines = [HEAD, "", TEXT, *textwrap.wrap(f"Machine: {data['machine']}.", 125), ""]
    lines += ["| attack | tried | failed | left out | at |", "|---|---:|---:|---:|---|"]
    for attack, row in data["attacks"].items():
        at = f"{row['commit']}, {row['date']}"
        lines.append(f"| {attack} | {row['tried']:,} | {row['failed']:,} | {row['left_out']:,} | {at} |")
    lines += [f"| {attack} | 0 | 0 | 0 | not run yet |" for attack in ATTACKS if attack not in data["attacks"]]
    total = {name: sum(row[name] for row in data["attacks"].values()) for name in ("tried", "failed", "left_out")}
    lines.append(f"| all | {total['tried']:,} | {total['failed']:,} | {total['left_out']:,} | |")
    return "\n".join(lines) + "\n"


def with_section(page: str, data: Mapping[str, Any]) -> str:
    """Return the page with the section at its end, in the place of the one that stood there."""
    return page.partition(f"\n{HEAD}\n")[0].rstrip() + "\n\n" + section(data)


def main(arguments: Sequence[str]) -> int:
    """Print the files, or take results into the page; return 1 if an attack succeeded."""
    if arguments[:1] == ["files"]:
        print(*files())
        return 0
    from hil.cli.doctor import cpu_text

    known = json.loads(DATA.read_text())["attacks"] if DATA.is_file() else {}
    found = known | rows_of(map(Path, arguments[1:]))
    order = [*ATTACKS, *sorted(found.keys() - ATTACKS.keys())]
    data = {"machine": cpu_text(), "attacks": {attack: found[attack] for attack in order if attack in found}}
    DATA.write_text(json.dumps(data, indent=1) + "\n")
    PAGE.write_text(with_section(PAGE.read_text(), data))
    print(section(data))
    return int(any(row["failed"] for row in data["attacks"].values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
