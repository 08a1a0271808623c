"""Tables 7.1 and 7.2: squared tracking errors, predicted exactly with their spread, for the stated and the likely period."""

from __future__ import annotations

import numpy as np

from design.networked_loop.prediction import Prediction, predict_tracking
from hil.reproduce import Row, row
from hil.reproduce.chapter7.models import (
    H2,
    HINF,
    LOCAL,
    NETWORK,
    VTOL_H2,
    VTOL_HINF,
    Array,
    everywhere,
    motor,
    vtol,
)

TABLE_7_2 = {"H-infinity": (11.29, 0.0065), "H2": (11.65, 0.0055), "local": (12.11, 0.0693)}
CONTROLLERS = {
    "H-infinity": (HINF, "generated"), "H2": (H2, "generated"), "local": (everywhere(np.array([[LOCAL]])), "constant"),
}  # fmt: skip


def motor_prediction(gains: Array, selection: str, period_s: float) -> Prediction:
    """Table 7.2's run: 3 rad from t = 1 s on, 0.1 at the input for 2 samples at 30 s; error counted from t = 0."""
    ticks = round(50 / period_s)
    reference, disturbance = np.zeros(ticks), np.zeros(ticks)
    reference[round(1 / period_s) :] = 3.0
    pulse = round(30 / period_s)
    disturbance[pulse : pulse + 2] = 0.1
    return predict_tracking(
        *motor(period_s), *NETWORK, gains, selection, reference, period_s=period_s, target=np.full(ticks, 3.0),
        disturbance=disturbance, sums_from=(0, round(5 / period_s)),
    )  # fmt: skip


def table_rows() -> list[Row]:
    """Both simulation columns of Table 7.2 at both periods, and Table 7.1."""
    rows = []
    for name, printed in TABLE_7_2.items():
        for period_s in (0.05, 0.025):
            predicted = motor_prediction(*CONTROLLERS[name], period_s)
            mean, sd = predicted.sum_mean, predicted.sum_sd
            if not mean[0] < 1e3:
                rows.append(
                    row(
                        f"Table 7.2, simulation, {name}, T = {period_s} s", f"{printed[0]} / {printed[1]}", "diverges",
                        "not reproduced", "not mean-square stable",
                    )
                )  # fmt: skip
                continue
            z = [(p - m) / s for p, m, s in zip(printed, mean, sd, strict=True)]
            inside = max(map(abs, z)) < 2.6
            rows.append(
                row(
                    f"Table 7.2, simulation, {name}, T = {period_s} s", f"{printed[0]} / {printed[1]}",
                    f"{mean[0]:.2f} ({sd[0]:.2f}) / {mean[1]:.4f} ({sd[1]:.4f})",
                    "reproduced" if inside else "not reproduced",
                    "mean (sd) of sum of squares times T, step at 1 s, over 0-50 s / 5-50 s; printed is "
                    f"{z[0]:+.1f} / {z[1]:+.1f} sd off"
                    + ("" if period_s == 0.05 else "; half the stated period: very likely what was run"),
                )
            )  # fmt: skip
    return rows + _vtol_rows()


def _vtol_rows() -> list[Row]:
    ticks = 500
    reference, disturbance = np.ones(ticks), np.zeros((ticks, 2))
    disturbance[300] = 1.0
    rows = []
    for name, gains, printed in (("H2", VTOL_H2, 0.0356), ("H-infinity", VTOL_HINF, 0.0512)):
        predicted = predict_tracking(
            *vtol(), *NETWORK, gains, "generated", reference, period_s=0.01, disturbance=disturbance
        )
        quiet = predict_tracking(*vtol(), *NETWORK, gains, "generated", reference, period_s=0.01)
        mean, sd = float(predicted.sum_mean[0]), float(predicted.sum_sd[0])
        rows.append(
            row(
                f"Table 7.1, {name}", f"{printed}",
                f"{mean:.4f} ({sd:.4f}); without the impulse {float(quiet.sum_mean[0]):.4f}",
                "reproduced" if abs(printed - mean) < 2.6 * sd else "not reproduced",
                "unit step at t = 0, sum of squares times T over 0-5 s, impulse of 1 on both inputs at step 300 (its size is "
                "not printed); the spread comes from the first delays",
            )
        )  # fmt: skip
    return rows
