"""Numbers of sections: the predicted error beside emulated ones, and how stable a contact with a wall is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.topics import BUS, SC
from hil.measure.bus_load import bus_of
from hil.measure.view import view_of
from hil.pages import Figure, Table
from hil.pages.sections import theory
from hil.pages.sections.theory import section as theory_section
from hil.pages.sections.traffic import sensor_nodes
from hil.pages.sections.wall import section as wall_section
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate
from hil.sweeps.lockstep import BatchResult, run_batch
from tests.hil.pages.runs import run_of


@pytest.mark.parametrize(("name", "mean", "sd"), [("dc-motor-hinf", 12.03, 0.41), ("dc-motor-h2", 12.33, 0.46)])
def test_predicted_sums_are_the_known_ones_and_the_band_covers_the_emulation(name: str, mean: float, sd: float) -> None:
    section = theory_section(view_of(run_of(name)))
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


def test_a_prediction_over_many_modes_is_of_the_first_slots(monkeypatch: pytest.MonkeyPatch) -> None:
    run = run_of("dc-motor-hinf", "duration=4")
    monkeypatch.setattr(theory, "MOST_MOMENTS", 6 * 30)  # modes of this network times slots
    emulated: list[int] = []

    def counted(loop: Loop, *given: Any, **more: Any) -> BatchResult:
        emulated.append(loop.experiment.slots)
        return run_batch(loop, *given, **more)

    monkeypatch.setattr(theory, "run_batch", counted)
    found = theory_section(view_of(run))
    assert emulated == [30], "a run that ended early costs no page more runs of its whole duration"
    assert found is not None and "the first 30 slots of 80" in found.intro
    assert isinstance(found.blocks[0], Figure) and len(found.blocks[0].series[0].y) == 30


@pytest.mark.parametrize("name", ["dc-motor-smith", "smjls-robust-published"])
def test_what_has_no_prediction_has_no_panel(name: str) -> None:
    assert theory_section(view_of(run_of(name, "duration=2"))) is None


def test_prediction_starts_where_the_law_starts() -> None:
    """Always the longest delay in slot 0, a step in slot 0: the first input cannot act before slot 2 or later."""
    changes = ["duration=2", "reference.0.at=0", "network.sc.law.initial=[0.0, 0.0, 1.0]", "disturbance.0.at=1.5"]
    sections = []
    for extra in ([], ["network.sc.law.initial=stationary"]):
        section = theory_section(view_of(run_of("dc-motor-hinf", *changes, *extra)))
        assert section is not None and isinstance(section.blocks[0], Figure)
        sections.append(np.asarray(section.blocks[0].series[0].y))
    late, stationary = sections
    assert late[:2] == pytest.approx([-3.0, -3.0], rel=1e-12) and stationary[1] > -2.99


def wall(name: str, *changes: str) -> Any:
    experiment = load_experiment(name, list(changes))
    run = simulate(compose(experiment, certify=False), 0)
    return run, wall_section(view_of(run, experiment))


def test_the_margin_of_the_printed_coupler_ends_where_it_must() -> None:
    _, found = wall("omni-theorem61", "duration=1", "allow_uncertified=true")
    margin = next(b for b in found.blocks if isinstance(b, Figure) and b.title.startswith("Stability"))
    radii = np.max([s.y for s in margin.series[:-1]], axis=0)
    assert radii[0] < 1.0 and radii[1] == pytest.approx(1.083, abs=1e-3) and radii[6] == pytest.approx(1.153, abs=1e-3)
    assert margin.markers[0].x == 6


def test_a_wall_without_a_coupler_shows_depth_force_and_energy() -> None:
    following = ('controller={kind="model-following"}', "allow_uncertified=true", "limits.input=[40.0]", "limits.state.given=1.0")
    run, found = wall("omni-push", "duration=20", *following)
    depth, force, energy = found.blocks
    assert [len(block.series) for block in found.blocks] == [1, 1, 1]  # no avatar beside the device
    assert depth.series[0].y == pytest.approx(1e3 * run.arrays["/plant/measurement"]["position"])
    assert depth.series[0].y[-1] == pytest.approx(1.0, abs=0.05) and force.series[0].y[-1] == pytest.approx(1.0, abs=0.05)
    assert energy.series[0].y.max() > 500.0


def test_numbers_of_an_edited_log_that_are_none_are_left_out_or_named() -> None:
    run = run_of("dc-motor-busy-can", "duration=0.1")
    for topic, field, value in ((SC.name, "slot", -1), (BUS.name, "node", -(10**6))):
        records = run.arrays[topic].copy()
        records[field] = value
        run.arrays[topic] = records
        if topic == SC.name:
            sensor_nodes(view_of(run))
    with pytest.raises(HilError, match="topic /link/bus: node: expected numbers of the"):
        bus_of(view_of(run))
