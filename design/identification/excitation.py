"""What moves an axis so that its parameters can be told, and how well they will be told, before anything runs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from design.errors import DesignError
from design.identification.axis import Array, forced, free
from design.identification.record import Record

WORST_CONDITION = 1e7
"""Condition number of the scaled sensitivities above which a record cannot tell the parameters apart."""


def square_wave(slots: int, period_s: float, frequency_hz: float, amplitude: float) -> Array:
    """Return a square wave r (slots,) that begins with +amplitude.

    Args:
        slots: how many samples.
        period_s: T in s.
        frequency_hz: of the wave; half a wave is rounded to whole samples.
        amplitude: in the output's unit.

    Raises:
        DesignError: half a wave is shorter than a sample.

    Reference: sec. 6.2.1: 0.4545 Hz, 0.02.
    """
    half = round(0.5 / (frequency_hz * period_s))
    if half < 1:
        raise DesignError(f"frequency_hz: {frequency_hz:g} Hz, expected at most {0.5 / period_s:g} Hz at T = {period_s:g} s")
    return np.where((np.arange(slots) // half) % 2 == 0, amplitude, -amplitude).astype(np.float64)


def sensitivities(records: Sequence[Record], gain: float, pole: float, starts: Sequence[tuple[float, float]]) -> Array:
    """Return the derivatives of all measured outputs by (g, p, y_0 and v_0 of every record), (samples, 2 + 2 records).

    Args:
        records: what was recorded.
        gain, pole: g and p.
        starts: y_0 and v_0 of every record.
    """
    blocks = []
    for i, (record, (_, speed)) in enumerate(zip(records, starts)):
        kept = record.measured
        by_gain, forced_slope = forced(record.u, pole, record.period_s)
        by_speed, free_slope = free(record.u.size, pole, record.period_s)
        block = np.zeros((int(kept.sum()), 2 + 2 * len(records)))
        block[:, 0] = by_gain[kept]
        block[:, 1] = (gain * forced_slope + speed * free_slope)[kept]
        block[:, 2 + 2 * i] = 1.0
        block[:, 3 + 2 * i] = by_speed[kept]
        blocks.append(block)
    return np.vstack(blocks)


def covariance(jacobian: Array) -> Array:
    """Return (J' J)^-1: the covariance of the parameters for independent noise of sd 1.

    Args:
        jacobian: J (samples, parameters).

    Raises:
        DesignError: the record cannot tell the parameters apart; the message has the condition number that decides it.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    if not (np.isfinite(scale).all() and scale.min() > 0.0):
        raise DesignError("excitation: the input does not move the axis; the record determines neither gain nor pole")
    r = np.linalg.qr(jacobian / scale, mode="r")
    values = np.linalg.svd(r, compute_uv=False)
    condition = math.inf if values[-1] == 0.0 else float(values[0] / values[-1])
    if not condition < WORST_CONDITION:
        raise DesignError(
            f"excitation: the record does not separate gain from pole (condition number {condition:.3g}, expected below "
            f"{WORST_CONDITION:g}); move the axis at other frequencies too, a square wave for instance"
        )
    inverse = np.linalg.inv(r)
    return np.asarray(inverse @ inverse.T / np.outer(scale, scale))


def expected_errors(u: npt.ArrayLike, period_s: float, gain: float, pole: float, noise_sd: float) -> tuple[float, float]:
    """Return the standard errors of g and p that a record of this input, from rest, will give (Cramer-Rao).

    Args:
        u: input (n,).
        period_s: T in s.
        gain, pole: g and p as expected.
        noise_sd: standard deviation of the measured output.
    """
    inputs = np.asarray(u, dtype=np.float64)
    record = Record(u=inputs, y=np.zeros(inputs.size), period_s=period_s)
    sd = noise_sd * np.sqrt(np.diag(covariance(sensitivities([record], gain, pole, [(0.0, 0.0)]))))
    return float(sd[0]), float(sd[1])
