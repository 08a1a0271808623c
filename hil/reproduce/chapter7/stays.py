"""Gains that know how long d has lasted: what the stay is worth (8.2.1)."""

from __future__ import annotations

from typing import Any

import numpy as np

from design.networked_loop.certify import certify_loop
from design.processes.delay_chain import DelayChain
from design.tracking.synthesis import TrackingProblem, solve
from hil.reproduce.chapter import ReportProgress
from hil.reproduce.statements import Statement, below, exactly
from plants.dc_motor import DCMotor

PERIOD_S = 0.05
STAY = np.array([
    [0.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.5, 0.5, 0.0],
    [0.0, 0.0, 0.0, 0.0, 1.0, 0.0], [0.5, 0.0, 0.0, 0.0, 0.0, 0.5], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
])  # fmt: skip
DELAYS = np.array([0, 0, 0, 0, 1, 1])
"""A semi-Markov delay: 0 for three or four samples, then 1 for one or two, each as likely."""


def stays(report_progress: ReportProgress) -> dict[str, Any]:
    """Return the H2 norms of our designs for the motor whose rows know d alone, and d and its stay.

    Args:
        report_progress: takes the share that is done.
    """
    model = DCMotor().model().discretise(PERIOD_S)
    sc = DelayChain(transition=np.ones((1, 1)))
    plain, told = (DelayChain(transition=STAY, delays=DELAYS, labels=labels) for labels in (DELAYS, np.arange(6)))
    found = [
        solve(TrackingProblem(A=model.A, B=model.B, C=model.C, sc=sc, ca=ca, objective="h2", information="applied"))
        for ca in (plain, told)
    ]
    repeated = np.asarray(found[0].gains)[:, DELAYS]
    again = certify_loop(model.A, model.B, model.C, sc, told, repeated, "applied")
    norms = [float(each.certificate.h2_norm or np.nan) for each in found]
    return {
        "plain": norms[0], "told": norms[1], "again": again.h2_norm, "share": norms[1] / norms[0],
        "radius": found[1].certificate.mean_square_radius,
    }  # fmt: skip


STAYS = (
    Statement(
        "8.2.1: gains that know how long d has lasted, over a semi-Markov delay", "less conservative",
        (
            below("H2 norm with the stay of d over that without", "share", 1),
            below("second-moment radius with it", "radius", 1),
            exactly("H2 norm of the gains without it, by the loop that knows it", "again", "plain", 1e-9),
        ),
        basis="DC motor at 0.05 s, no delay to the controller; d is 0 for three or four samples and 1 for one or two: "
        "{told:.4f} against {plain:.4f}. A design alone: packets of the rig have a row for each d, none for its stay",
    ),
)
