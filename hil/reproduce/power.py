"""What the rules can tell: the share of the reproduced rows that turn when every computed number is 10 % larger, and smaller.

A row that claims an equality turns both ways, or its check would have been undecided (`hil.reproduce.judgement`). A one-sided
claim need not: how far its number lies from the limit is no part of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from hil.reproduce.judgement import OFF, Kind, Row

KINDS: tuple[Kind, ...] = ("equality", "one run", "one-sided")
"""What a row with numbers claims: the first of these that one of its checks is."""


def turns(row: Row, share: float) -> bool:
    """Return whether the verdict is another one when every computed number of the row is this share larger."""
    checks = tuple(check.off(share) or check for check in row.checks)
    return replace(row, checks=checks).verdict != row.verdict


def power(rows: Iterable[Row], share: float = OFF) -> dict[str, tuple[int, int]]:
    """Return by kind how many reproduced rows turn both ways, and how many there are; rows of words are left out."""
    found: dict[str, tuple[int, int]] = dict.fromkeys(KINDS, (0, 0))
    for row in rows:
        kind = next((kind for kind in KINDS if kind in row.kinds), None)
        if kind is not None and row.verdict == "reproduced":
            turned, of = found[kind]
            found[kind] = (turned + (turns(row, share) and turns(row, -share)), of + 1)
    return found


def power_in_words(rows: Iterable[Row]) -> str:
    """Return `power` as a sentence."""
    found = power(rows)
    kinds = ", ".join(f"{turned} of {of} {kind}" for kind, (turned, of) in found.items())
    turned, of = (sum(each) for each in zip(*found.values()))
    return f"every number {OFF:.0%} larger or smaller turns {turned} of {of} reproduced rows with numbers: {kinds}"
