"""Sweep, comparison and page say where a mean of squared errors converges badly."""

from __future__ import annotations

import json

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.measure.view import view_of
from hil.pages.html.figures import Table
from hil.pages.many_runs import compare_page
from hil.pages.sections.theory import section as theory_section
from hil.runtime.virtual import simulate
from hil.sweeps.comparison import compare
from tests.hil.cli.conftest import Hil
from tests.hil.compose.test_fourth_moments import STABLE_WITHOUT_VARIANCE


def test_sweep_compare_and_page_say_it(cli: Hil) -> None:
    said = ("--runs", "2", "--jobs", "1", *(word for change in STABLE_WITHOUT_VARIANCE for word in ("--set", change)))
    assert "converges badly" in " ".join(cli("sweep", "dc-motor-local", *said)[1].split())
    assert "converges badly" in json.loads(cli("sweep", "dc-motor-local", *said, "--json")[1])["caution"]
    loaded = {name: load_experiment("dc-motor-local", STABLE_WITHOUT_VARIANCE) for name in ("a", "b")}
    compared = compare(loaded, 2, jobs=1)
    assert set(compared.cautions) == {"a", "b"} and "converges badly" in compare_page(compared)
    loop = compose(loaded["a"])
    section = theory_section(view_of(simulate(loop, 0), loop.experiment))
    assert section is not None
    (table,) = (block for block in section.blocks if isinstance(block, Table))
    assert "converges badly" in table.note
