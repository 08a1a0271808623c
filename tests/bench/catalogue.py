"""All figures of `python -m tests.bench all`, and the process in which some of them are measured together.

    python -m tests.bench.catalogue PART 0,1 [--quick]     one JSON object a line, as soon as it is measured
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from typing import Any, Final

from hil.errors import HilError
from hil.runtime.real import die_with_parent
from tests.bench import part_designs, part_logs, part_real_time, part_start, part_sweeps
from tests.bench.figure import Measure, Part, Row, row_of

PARTS: Final[tuple[Part, ...]] = (
    part_start.PART, part_sweeps.PART, part_real_time.PART, part_logs.PART, part_designs.PART,
)  # fmt: skip
"""In the order in which they are measured."""


def take(part: Part, measure: Measure, *, quick: bool) -> Iterator[Row]:
    """Measure some figures of a part, one row each; what fails costs the figures that were not yet measured.

    Args:
        part: to which they belong.
        measure: measures them.
        quick: whether something smaller is measured, a few seconds in all.
    """
    missing, why = {figure.name: figure for figure in measure.figures}, "its peer or itself gave no number"
    try:
        for found in measure.take(_tell, quick):
            yield row_of(part.name, missing.pop(found.name), found, quick=quick)
    except Exception as error:  # whatever it is, the rest is worth having
        why = str(error) if isinstance(error, HilError) else f"{type(error).__name__}: {error}"
    for figure in missing.values():
        yield row_of(part.name, figure, None, " ".join(why.split()))


def _tell(text: str) -> None:
    print(f"  {text}", file=sys.stderr, flush=True)


def main(arguments: list[str]) -> None:
    """Measure what is named."""
    die_with_parent(os.getppid())
    name, numbers, *options = arguments
    (part,) = (each for each in PARTS if each.name == name)
    for number in map(int, numbers.split(",")):
        for row in take(part, part.measures[number], quick="--quick" in options):
            print(_line(row), flush=True)


def _line(row: dict[str, Any]) -> str:
    return json.dumps(row, allow_nan=False)


if __name__ == "__main__":
    main(sys.argv[1:])
