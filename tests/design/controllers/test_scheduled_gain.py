"""Scheduled gains: held and linear schedules, and nothing heavier than numpy behind the import."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from design.as_printed import chapter2_gain
from design.controllers.scheduled_gain import Schedule, ScheduledGain, constant_gain


def test_held_gain_steps_at_its_section_start_and_stays() -> None:
    gain = chapter2_gain()
    assert gain.at(0, 0.0).tolist() == gain.at(0, 0.8325).tolist() == [[-22.1292, 14.1944]]
    assert gain.at(0, 0.8326).tolist() == gain.at(0, 100.0).tolist() == [[-11.0213, 7.1232]]
    assert gain.norm == pytest.approx(26.29, abs=0.01)


def test_linear_gain_interpolates_and_never_exceeds_the_norm_of_its_nodes() -> None:
    gain = ScheduledGain(gain=chapter2_gain().gain, starts_s=np.array([[0.0, 2.0]] * 2), schedule="linear")
    assert gain.at(1, 1.0) == pytest.approx(0.5 * (gain.gain[1, 0] + gain.gain[1, 1]))
    assert gain.at(1, 5.0) == pytest.approx(gain.gain[1, 1])
    assert max(np.linalg.norm(gain.at(0, h)) for h in np.linspace(0, 3, 50)) <= gain.norm


@pytest.mark.parametrize("schedule", ["hold", "linear"])
def test_rows_for_a_loop_are_the_gain_at_every_instant_and_at_the_starts(schedule: Schedule) -> None:
    gain = ScheduledGain(gain=chapter2_gain().gain, starts_s=np.array([[0.0, 0.8326], [0.0, 2.0]]), schedule=schedule)
    rows = gain.rows()
    for mode, h in [(mode, h) for mode in (0, 1) for h in (-0.1, 0.0, 0.5, 0.8325, 0.8326, 1.9, 2.0, 100.0)]:
        assert rows(mode, h) == gain.at(mode, h).tolist()


def test_import_needs_numpy_only() -> None:
    heavy = "[m for m in ('scipy', 'control', 'cvxpy', 'clarabel', 'matplotlib') if m in sys.modules]"
    code = f"import sys, design.controllers.scheduled_gain; sys.exit(str({heavy}) if {heavy} else 0)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: constant_gain(np.zeros((2, 2))), r"gain: shape \(2, 2\)"),
        (lambda: constant_gain(np.full((1, 1, 2), np.inf)), r"gain: entry \(0, 0, 0, 0\) is not finite"),
        (
            lambda: ScheduledGain(gain=np.zeros((1, 2, 1, 1)), starts_s=np.array([[0.0, 0.0]])),
            "starts_s: expected finite increasing",
        ),
        (lambda: ScheduledGain(gain=np.zeros((1, 2, 1, 1)), starts_s=np.zeros((1, 1))), r"starts_s: shape \(1, 1\)"),
        (
            lambda: ScheduledGain(gain=np.zeros((1, 1, 1, 1)), starts_s=np.zeros((1, 1)), schedule="spline"),  # type: ignore[arg-type]
            "schedule: 'spline'",
        ),
    ],
)
def test_bad_gain_is_refused(call: object, message: str) -> None:
    with pytest.raises(ValueError, match="^" + message):
        call()  # type: ignore[operator]
