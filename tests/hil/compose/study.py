"""The study of random loops by family: ``python -m tests.hil.compose.study`` writes its table into the guide, in some minutes.

Each loop is judged beside exact second moments, or drawn runs, that share no code with the door.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.certify import CertificationProblem
from hil.certify.certify import judge
from tests.hil.compose.random_delayed_loops import delayed_case
from tests.hil.compose.random_jump_loops import fault_case, jump_case, network_case, sectioned_case, uncertain_case
from tests.hil.compose.random_limited_loops import limited_case
from tests.hil.compose.random_table_loops import send_all_case, sojourn_case

Case = Callable[[np.random.Generator], tuple[CertificationProblem, float]]
EDGE = 1e-6
CASES: dict[str, tuple[Case, int]] = {
    "send-all": (send_all_case, 110), "jump": (jump_case, 80), "uncertain": (uncertain_case, 50), "fault": (fault_case, 60),
    "sojourns": (sojourn_case, 40), "network": (network_case, 40), "sectioned": (sectioned_case, 40),
    "delayed": (delayed_case, 40), "limited": (limited_case, 40),
}  # fmt: skip
WORDS = {
    "send-all": "tables of gains, Markov networks", "jump": "gains by mode, plants that jump",
    "uncertain": "the same, uncertain plants", "fault": "gains by the detected mode",
    "sojourns": "tables of gains, semi-Markov networks", "network": "plants that jump, random delays",
    "sectioned": "gains by mode and sojourn time", "delayed": "a delay inside the plant",
    "limited": "tables of gains, actuators that saturate",
}  # fmt: skip
PAGE = Path(__file__).parents[3] / "hil/guide/designs-and-certificates.md"
BEGIN, END = "<!-- study: written by python -m tests.hil.compose.study -->\n", "<!-- end of study -->"


class Found(NamedTuple):
    """What the door said of the loops of a family, how many are stable, and where it was wrong: seed, state, growth, number."""

    loops: int
    stable: int
    certified: int
    refused: int
    undecided: int
    false: tuple[tuple[object, ...], ...]


def studied(family: str) -> Found:
    """Judge the loops of a family."""
    case, count = CASES[family]
    states, false, stable = [], [], 0
    for seed in range(count):
        loop, growth = case(np.random.default_rng([list(CASES).index(family), seed]))
        verdict = judge(loop)
        states.append(verdict.state)
        stable += growth < 1.0
        if (verdict.state == "certified" and growth > 1.0 + EDGE) or (verdict.state == "refused" and growth < 1.0 - EDGE):
            false.append((seed, verdict.state, growth, verdict.number))
    return Found(count, stable, *(states.count(s) for s in ("certified", "refused", "undecided")), tuple(false))


def row(family: str, found: Found) -> str:
    """Return a family's row of the table."""
    share = f"{100.0 * found.undecided / found.loops:.0f} %"
    numbers = (found.loops, found.stable, found.certified, found.refused, found.undecided, share, len(found.false))
    return f"| {WORDS[family]} | " + " | ".join(map(str, numbers)) + " |"


def undecided_in_the_guide() -> dict[str, int]:
    """Return how many loops of each family are undecided, as the guide says."""
    said = PAGE.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0]
    return {
        family: int(found[1])
        for family, words in WORDS.items()
        if (found := re.search(rf"^\| {re.escape(words)} \|(?: \d+ \|){{4}} (\d+) \|", said, re.MULTILINE)) is not None
    }


def main() -> None:
    """Write the table into the guide."""
    rows = []
    for family in CASES:
        rows.append(row(family, studied(family)))
        print(rows[-1], flush=True)
    columns = ("random loops", "loops", "stable", "certified", "refused", "undecided", "share", "false")
    head = f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|\n"
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(before + BEGIN + head + "\n".join(rows) + "\n" + END + rest.partition(END)[2], encoding="utf-8")


if __name__ == "__main__":
    main()
