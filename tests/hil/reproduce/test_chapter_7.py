"""Chapter 7: verdicts with the numbers that they rest on, and a fit that finds what it looks for."""

import numpy as np
import pytest

from hil.reproduce import reproduce
from hil.reproduce.chapter7.friction import EXPERIMENT, Imperfections, errors_of_all, experiment_rows, loop_of, misfit
from hil.reproduce.chapter7.models import model_rows, theorem_rows
from hil.reproduce.chapter7.tables import table_rows

LABORATORY = Imperfections(
    saturation_v=0.0576, coulomb_v=0.0017, static_ratio=2.5, dead_zone_v=0.0021, encoder_rad=0.0019
)


def verdicts(rows):
    return {r.item: r.verdict for r in rows}


def test_printed_model_and_statements_are_told_apart():
    found = verdicts(model_rows() + theorem_rows())
    assert found["motor: A, B at T = 0.05 s"] == "claim false"
    assert found["VTOL: A, B at T = 0.01 s"] == "reproduced"
    assert found["VTOL: eigenvalues of A"] == "reproduced"
    assert found["Remark 7.5: P1 > P2 implies Gamma(P1) < Gamma(P2)"] == "claim false"


def test_table_7_2_was_made_at_half_the_stated_period():
    found = verdicts(table_rows())
    for name in ("H-infinity", "H2", "local"):
        assert found[f"Table 7.2, simulation, {name}, T = 0.05 s"] == "not reproduced"
        assert found[f"Table 7.2, simulation, {name}, T = 0.025 s"] == "reproduced"


def test_friction_brings_the_experiment_column_near():
    (near,) = errors_of_all([LABORATORY], range(6), jobs=1)
    (far,) = errors_of_all([Imperfections(**{**_fields(LABORATORY), "saturation_v": 0.3})], range(6), jobs=1)
    assert set(near) == set(EXPERIMENT) and near["hinf"].shape == (6, 3)
    assert misfit(near) < 30 < misfit(far)


def _fields(motor):
    return {name: getattr(motor, name) for name in motor.__slots__}


def test_fitted_motor_is_the_plant_that_runs():
    plant = loop_of("h2", LABORATORY).experiment.plant
    assert plant.driver.saturation_v == 0.0576 and np.isclose(plant.friction.static_v, 2.5 * 0.0017)


def test_experiment_rows_tell_the_parameters_and_the_distance():
    rows = experiment_rows(LABORATORY, 0.0, lambda text: None, seeds=6)
    assert len(rows) == 5 and "saturation 0.0576 V" in rows[0].basis and "sd off" in rows[0].basis


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_whole_chapter_with_its_page():
    result = reproduce("ch7")
    found = verdicts(result.rows)
    assert found["motor: gamma_min"] == "reproduced" and found["motor: beta_min"] == "not reproduced"
    assert all(found[f"Table 7.2, experiment, {name}"] == "reproduced" for name in ("H-infinity", "H2", "local"))
    page = result.page()
    assert all(f"Figure 7.{n}" in page for n in (2, 3, 4, 6, 7, 8)) and "http" not in page.split("<body>")[1][:200]
