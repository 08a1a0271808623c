"""Runs of the rig itself, seed by seed, agree with the prediction at every slot."""

import numpy as np
import pytest
from scipy.special import ndtri

from hil.compose import compose
from hil.experiment import load_experiment
from hil.rig.delay_chains import gains_over
from hil.runtime.virtual import simulate
from hil.sweeps.lockstep import run_batch

QUANTISED = 6e-7  # rad: packets carry float32, on both sides of the loop; the prediction knows nothing of it


def predicted_of(loop, slots, **options):
    from design.networked_loop.prediction import predict_tracking

    reference, disturbance, chains = loop.reference().at, loop.disturbance().at, (loop.chains.sc, loop.chains.ca)
    return predict_tracking(
        loop.model.A, loop.model.B, loop.model.C, *chains,
        gains_over(loop.controller, loop.model, *chains), loop.controller.selection,
        np.array([reference(k) for k in range(slots)]),
        period_s=loop.model.period_s, samples=loop.samples,
        disturbance=np.array([disturbance(k) for k in range(slots)]), **options,
    )  # fmt: skip


def squared_errors(loop, seeds):
    """Squared tracking error of every slot of every run, (runs, slots)."""
    found = []
    for seed in seeds:
        run = simulate(loop, seed, ("/plant/measurement", "/reference"))
        found.append((run.arrays["/plant/measurement"]["angle"] - run.arrays["/reference"]["angle"]) ** 2)
    return np.array(found)


def assert_in_bands(squares, predicted, slots):
    runs = len(squares)
    z = -ndtri(0.001 / 4 / slots)  # 99.9 % for means and variances of all slots at once
    spread, size = predicted.square_sd / np.sqrt(runs), np.sqrt(predicted.square_mean) + QUANTISED
    rounding = 2 * QUANTISED * size
    assert np.all(np.abs(squares.mean(axis=0) - predicted.square_mean) <= z * spread + rounding)
    deviation = (squares - predicted.square_mean) ** 2
    error = deviation.std(axis=0) / np.sqrt(runs)
    # a sample that holds no rare run underestimates its own spread: the predicted variance enters the band as well
    band = z * np.maximum(error, 3 * predicted.square_sd**2 / np.sqrt(runs)) + 2 * rounding * size**2
    assert np.all(np.abs(deviation.mean(axis=0) - predicted.square_sd**2) <= band)


# With two samples the error dies out so fast that later only runs too rare for eighty carry its moments.
CASES = [
    ("dc-motor-hinf", 160),
    pytest.param("dc-motor-ours-bursty", 160, marks=pytest.mark.slow),
    ("dc-motor-ours-two-samples", 36),
]


@pytest.mark.parametrize("name, slots", CASES)
def test_eighty_runs_lie_in_the_bands(name, slots):
    loop = compose(load_experiment(name, (f"duration={0.05 * slots} s",)))
    assert_in_bands(squared_errors(loop, range(80)), predicted_of(loop, slots), slots)


@pytest.mark.slow
def test_ten_thousand_runs_lie_in_the_bands():
    """Computed in lockstep, which has the bits of one run after another."""
    loop = compose(load_experiment("dc-motor-hinf"))
    together = run_batch(loop, range(10_000))
    assert together.known.all()
    squares = (together.outputs[0] - together.reference[:, :1]).T ** 2
    assert_in_bands(squares, predicted_of(loop, 1000), 1000)
