"""Means of squared errors that converge badly are said so: a stable loop whose fourth moments grow."""

from __future__ import annotations

import json

import hil
from hil.compose import compose
from hil.compose.judged import caution, fourth_moments_of
from hil.experiment import load_experiment
from hil.measure.view import view_of
from hil.pages import Table
from hil.pages.many_runs import compare_page
from hil.pages.sections.theory import section as theory_section
from hil.runtime.virtual import simulate
from hil.sweeps.comparison import compare
from tests.hil.cli.conftest import Hil
from tests.hil.cli.conftest import cli as cli

STABLE_WITHOUT_VARIANCE = ["controller.gain=[[-0.32]]", "duration=3 s"]
"""Over the network of dc-motor-local: second moments fall (radius below 1), fourth moments grow."""


def test_a_stable_loop_may_have_fourth_moments_that_grow() -> None:
    loop = compose(load_experiment("dc-motor-local", STABLE_WITHOUT_VARIANCE))
    found = fourth_moments_of(loop)
    assert loop.verdict is not None and loop.verdict.certified and found is not None
    assert found.state == "growing" and found.radius is not None and found.radius > 1.0
    assert "converges badly" in caution(loop)
    assert caution(compose(load_experiment("dc-motor-hinf"))) == ""
    assert fourth_moments_of(compose(load_experiment("dc-motor-smith", ["allow_uncertified=true"]))) is None


def test_what_grows_for_a_thousand_slots_and_then_falls_is_bounded() -> None:
    """1386 moments that grow by 1.0025 a slot at first; their radius is 0.99299."""
    found = fourth_moments_of(compose(load_experiment("dc-motor-1khz"), certify=False))
    assert found is not None and found.state == "bounded"


def test_a_loop_whose_means_converge_has_no_caution() -> None:
    assert hil.sweep("dc-motor-hinf", runs=2, jobs=1, duration=1).caution == ""
    assert hil.compare("dc-motor-hinf", "dc-motor-h2", runs=2, jobs=1, duration=1).cautions == {}


def test_sweep_compare_and_page_say_it(cli: Hil) -> None:
    said = ("--runs", "2", "--jobs", "1", *(word for change in STABLE_WITHOUT_VARIANCE for word in ("--set", change)))
    assert "converges badly" in " ".join(cli("sweep", "dc-motor-local", *said)[1].split())
    assert "converges badly" in json.loads(cli("sweep", "dc-motor-local", *said, "--json")[1])["caution"]
    loaded = load_experiment("dc-motor-local", STABLE_WITHOUT_VARIANCE)
    compared = compare({"a": loaded, "b": loaded}, 2, jobs=1)
    assert set(compared.cautions) == {"a", "b"} and "converges badly" in compare_page(compared)
    loop = compose(loaded)
    section = theory_section(view_of(simulate(loop, 0), loop.experiment))
    assert section is not None
    (table,) = (block for block in section.blocks if isinstance(block, Table))
    assert "converges badly" in table.note
