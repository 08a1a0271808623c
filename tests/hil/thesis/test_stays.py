"""What the stay of d is worth: a row that turns with its numbers, and a check of the loop by its own second moments."""

import numpy as np
import pytest

from design.processes.delay_chain import DelayChain
from design.tracking.synthesis import TrackingProblem, solve
from hil.thesis.chapter7_delays import DELAYS, PERIOD_S, STAY, STAYS, stays
from hil.thesis.statements import judge
from plants.dc_motor import DCMotor
from tests.hil.thesis.judging import assert_every_number_decides


def test_the_row_turns_with_its_numbers():
    values = stays(lambda *_: None)
    rows = judge(STAYS, values)
    assert_every_number_decides(rows)
    assert rows[0].verdict == "reproduced" and values["share"] < 0.6


def test_the_norm_is_that_of_the_loop_slot_by_slot():
    """E sum |z|^2 of an impulse, from own matrices: x(k+1) = A x + B K[label(d_k)] y(k - d_k)."""
    model = DCMotor().model().discretise(PERIOD_S)
    reported = DelayChain(transition=STAY, delays=DELAYS, labels=np.arange(6))
    sc = DelayChain(transition=np.ones((1, 1)))
    found = solve(TrackingProblem(A=model.A, B=model.B, C=model.C, sc=sc, ca=reported, objective="h2", information="applied"))
    K, n = np.asarray(found.gains)[0, :, 0, 0], 3  # (x, y(k - 1))
    closed, cost = np.zeros((6, n, n)), np.zeros((6, n, n))
    for mode, d in enumerate(DELAYS):
        seen = np.array([*(0.0 * model.C[0]), 1.0]) if d else np.array([*model.C[0], 0.0])
        u = K[mode] * seen
        closed[mode, :2, :2] = model.A
        closed[mode, :2] += np.outer(model.B[:, 0], u)
        closed[mode, 2, :2] = model.C[0]
        z = np.vstack([[*model.C[0], 0.0], 0.01 * u])
        cost[mode] = z.T @ z
    P = np.zeros((6, n, n))
    for _ in range(4000):
        after = np.einsum("ij,jab->iab", STAY, P)
        P = cost + np.einsum("iba,ibc,icd->iad", closed, after, closed)
    push = np.array([*model.B[:, 0], 0.0])
    law = np.linalg.matrix_power(0.5 * (STAY + np.eye(6)), 4096)[0]
    total = sum(law[i] * push @ sum(STAY[i, j] * P[j] for j in range(6)) @ push for i in range(6))
    assert np.sqrt(total) == pytest.approx(found.certificate.h2_norm, rel=1e-6)
