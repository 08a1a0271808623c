"""The predicted error beside emulated ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.experiment import load_experiment
from hil.measure.view import view_of
from hil.pages.html.figures import Figure, Table
from hil.pages.sections import theory
from hil.pages.sections.theory import section as theory_section
from hil.session import run_session


@pytest.mark.parametrize(("name", "mean", "sd"), [("dc-motor-hinf", 12.03, 0.41), ("dc-motor-h2", 12.33, 0.46)])
def test_predicted_sums_are_the_known_ones_and_the_band_covers_the_emulation(
    tmp_path: Path, name: str, mean: float, sd: float
) -> None:
    run = run_session(load_experiment(name), path=tmp_path / "a.mcap").run
    section = theory_section(view_of(run))
    assert section is not None
    figure, table = section.blocks
    assert isinstance(figure, Figure) and isinstance(table, Table)
    assert figure.y_unit == "rad" and table.columns[0] == "squared tracking error (rad² s)"
    assert table.rows[0][1] == pytest.approx(mean, abs=0.03)  # 10,000 runs gave the known mean, to 0.005 + rounding
    assert table.rows[0][2] == pytest.approx(sd, rel=0.05)
    theory, emulated = figure.bands
    # Where 95 % of 100 runs lie is within 4 predicted sd of the mean (at slots whose spread is more than rounding).
    centre = (np.asarray(theory.lower) + np.asarray(theory.upper)) / 2
    spread = (np.asarray(theory.upper) - np.asarray(theory.lower)) / 4
    wide = spread > 1e-4
    for edge in (emulated.lower, emulated.upper):
        assert np.all(np.abs(np.asarray(edge) - centre)[wide] < 4 * spread[wide])


def test_a_prediction_over_many_modes_is_of_the_first_slots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = run_session(load_experiment("dc-motor-hinf", ["duration=4"]), path=tmp_path / "a.mcap").run
    monkeypatch.setattr(theory, "MOST_MOMENTS", 6 * 30)  # modes of this network times slots
    found = theory_section(view_of(run))
    assert found is not None and "the first 30 slots of 80" in found.intro
    assert isinstance(found.blocks[0], Figure) and len(found.blocks[0].series[0].y) == 30


@pytest.mark.parametrize("name", ["dc-motor-smith", "smjls-robust-published"])
def test_what_has_no_prediction_has_no_panel(tmp_path: Path, name: str) -> None:
    run = run_session(load_experiment(name, ["duration=2"]), path=tmp_path / "a.mcap").run
    assert theory_section(view_of(run)) is None


def test_prediction_starts_where_the_law_starts(tmp_path: Path) -> None:
    """Always the longest delay in slot 0, a step in slot 0: the first input cannot act before slot 2 or later."""
    changes = ["duration=2", "reference.0.at=0", "network.sc.law.initial=[0.0, 0.0, 1.0]", "disturbance.0.at=1.5"]
    sections = []
    for extra in ([], ["network.sc.law.initial=stationary"]):
        run = run_session(load_experiment("dc-motor-hinf", changes + extra), path=tmp_path / f"{len(extra)}.mcap").run
        section = theory_section(view_of(run))
        assert section is not None and isinstance(section.blocks[0], Figure)
        sections.append(np.asarray(section.blocks[0].series[0].y))
    late, stationary = sections
    assert late[:2] == pytest.approx([-3.0, -3.0], rel=1e-12) and stationary[1] > -2.99
