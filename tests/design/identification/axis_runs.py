"""Records of the axis under the square wave of Section 6.2.1, many at once."""

import numpy as np

from design.identification import Record, held, square_wave

INERTIA, DAMPING = 0.7943, 1.9857


def square_records(
    *, period_s: float, slots: int, noise_sd: float, seed: int, runs: int = 1, step: float = 0.0, proportional: float = 10.0
) -> list[Record]:
    """Return ``runs`` closed-loop records with white noise on the measured output, then rounded to ``step``."""
    rng = np.random.default_rng(seed)
    gain, hold = 1.0 / INERTIA, held(DAMPING / INERTIA, period_s)
    reference = square_wave(slots, period_s, 1.0 / 2.2, 0.02)
    x, v = np.zeros(runs), np.zeros(runs)
    us, ys = np.zeros((slots, runs)), np.zeros((slots, runs))
    for k in range(slots):
        y = x + noise_sd * rng.standard_normal(runs)
        y = step * np.floor(y / step + 0.5) if step else y
        us[k] = u = proportional * (reference[k] - y)
        ys[k] = y
        x, v = x + hold.s1 * v + gain * hold.s2 * u, hold.a * v + gain * hold.s1 * u
    return [Record(u=us[:, i], y=ys[:, i], period_s=period_s) for i in range(runs)]
