"""The VTOL helicopter of sec. 7.4.1."""

import numpy as np

from plants.vtol import VTOL, vtol_matrices

PRINTED_A = [
    [0.9996, 0.0003, 0.0002, -0.0046],
    [0.0005, 0.9900, -0.0002, -0.0400],
    [0.0010, 0.0036, 0.9930, 0.0141],
    [0.0, 0.0, 0.0100, 1.0001],
]
PRINTED_B = [[0.0044, 0.0018], [0.0353, -0.0755], [-0.0549, 0.0446], [-0.0003, 0.0002]]


def test_the_printed_discrete_model_is_its_zero_order_hold_at_10_ms():
    discrete = VTOL().model().discretise(0.01)
    difference = max(np.abs(discrete.A - PRINTED_A).max(), np.abs(discrete.B - PRINTED_B).max())
    assert difference <= 5.05e-5
    np.testing.assert_array_equal(discrete.C, [[0.0, 1.0, 0.0, 0.0]])


def test_the_eigenvalues_are_the_printed_ones():
    eigenvalues = np.sort_complex(np.linalg.eigvals(VTOL().model().discretise(0.01).A))
    np.testing.assert_allclose(eigenvalues, [0.9795, 0.9977, 1.0028 - 0.0026j, 1.0028 + 0.0026j], atol=1e-4)


def test_the_running_helicopter_is_its_discrete_model():
    x = np.array([1.0, -0.5, 0.2, 0.1])
    run = VTOL(initial_state=tuple(x)).start(np.random.default_rng(0))
    discrete = VTOL().model().discretise(0.01)
    for u in np.random.default_rng(4).normal(size=(300, 2)):
        run.advance(10_000_000, u.tolist())
        x = discrete.A @ x + discrete.B @ u
    np.testing.assert_allclose(run.state, x, rtol=1e-11)
    assert run.measure() == (run.state[1],)


def test_airspeeds_differ_in_three_entries():
    A, B = (np.array(M) for M in vtol_matrices(135))
    for airspeed in (60, 170):
        A2, B2 = (np.array(M) for M in vtol_matrices(airspeed))
        assert {(int(i), int(j)) for i, j in np.argwhere(A != A2)} == {(2, 1), (2, 3)}
        assert {(int(i), int(j)) for i, j in np.argwhere(B != B2)} == {(1, 0)}
