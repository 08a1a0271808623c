"""Plants, network and published gains of Section 7.4, and what may be said of the plants alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.compose.design_problem import LAMBDA, PI, PRINTED_VTOL
from hil.reproduce import Row, row
from plants import VTOL, DCMotor

Array = npt.NDArray[np.float64]

PRINTED_MOTOR = (np.array([[1.00021, 0.00460], [0.00460, 0.00004]]), np.array([[0.34868], [7.68069]]))
HINF = np.array([[-0.1576, -0.1318], [-0.0878, 0.0091], [-0.0342, 0.0074]]).reshape(3, 2, 1, 1)
H2 = np.array([[-0.1980, -0.1647], [-0.1232, -0.0547], [-0.0747, -0.0399]]).reshape(3, 2, 1, 1)
LOCAL = -0.4515
VTOL_H2 = np.array(
    [[[-4.1629, 5.6465], [-4.1774, 5.6462]], [[-1.8548, 2.5818], [-1.1025, 1.5065]], [[-1.3368, 1.8751], [-1.0764, 1.4867]]]
)[..., None]
VTOL_HINF = np.array(
    [[[-5.6786, 7.4750], [-6.5506, 8.7246]], [[-1.8669, 2.5136], [-1.2499, 1.6792]], [[-1.0491, 1.4216], [-0.9730, 1.3288]]]
)[..., None]
VTOL_LOCAL_H2 = np.array([[-56.0196], [-10.5998]])
NETWORK = (np.array(LAMBDA), np.array(PI))


class Plant(NamedTuple):
    """A discrete plant."""

    A: Array
    B: Array
    C: Array


def motor(period_s: float = 0.05) -> Plant:
    """The motor's zero-order hold."""
    discrete = DCMotor().model().discretise(period_s)
    return Plant(np.asarray(discrete.A), np.asarray(discrete.B), np.asarray(discrete.C))


def vtol() -> Plant:
    """The VTOL as printed in Section 7.4.1."""
    A, B, C = (np.array(M, dtype=np.float64) for M in PRINTED_VTOL)
    return Plant(A, B, C)


def everywhere(gain: Array) -> Array:
    """One gain (m, p) for every tau, in the shape [tau][row][m][p]."""
    return np.broadcast_to(gain, (3, 1, *gain.shape)).copy()


def model_rows() -> list[Row]:
    """The printed matrices against the plants."""
    A = PRINTED_MOTOR[0]
    right = motor()
    printed = np.sort(np.linalg.eigvals(A))
    needed = -float(np.log(printed[0])) / 3.5287
    exact = VTOL().model().discretise(0.01)
    A_v, B_v, _ = vtol()
    off = max(float(np.abs(np.asarray(exact.A) - A_v).max()), float(np.abs(np.asarray(exact.B) - B_v).max()))
    pair = np.linalg.eigvals(np.asarray(exact.A))
    pair = pair[np.argsort(-np.abs(pair))]
    rounded = max(float(v.imag) for v in np.linalg.eigvals(A_v))
    return [
        row(
            "motor: A, B at T = 0.05 s", "[1.00021 .00460; .00460 .00004], [.34868; 7.68069]",
            f"[1 {right.A[0, 1]:.6f}; 0 {right.A[1, 1]:.6f}], [{right.B[0, 0]:.6f}; {right.B[1, 0]:.6f}]", "claim false",
            f"a hold has the eigenvalues 1 and exp(-3.5287 T); the printed ones are {printed[1]:.5f} and {printed[0]:.5f}, so "
            f"the first is never met and the second asks for T = {needed:.1f} s",
        ),
        row(
            "VTOL: A, B at T = 0.01 s", "4 decimals", f"largest difference {off:.1e}", "reproduced",
            "zero-order hold of the matrices of Chapters 3 and 4",
        ),
        row(
            "VTOL: eigenvalues of A", "0.9977, 0.9795, 1.0028 +- 0.0026i",
            ", ".join(f"{v.real:.4f}{v.imag:+.4f}i" if v.imag else f"{v.real:.4f}" for v in pair),
            "reproduced" if np.allclose(np.sort(np.abs(pair)), [0.9795, 0.9977, 1.0028, 1.0028], atol=1e-4) else "not reproduced",
            f"of the unrounded hold; the printed four decimals have the imaginary part {rounded:.4f}",
        ),
    ]  # fmt: skip


def theorem_rows() -> list[Row]:
    """Statements of Section 7.3 that do not hold as printed."""
    A = np.array([[0.0, 2.0], [0.0, 0.0]])

    def gamma(P: Array) -> Array:
        return np.asarray(A.T @ P @ A - P)

    P2 = 10.0 * np.array([[1.0, 0.0], [0.0, 5.0]])
    P1 = P2 + np.eye(2)
    change = np.linalg.eigvalsh(gamma(P1) - gamma(P2))
    return [
        row(
            "Remark 7.5: P1 > P2 implies Gamma(P1) < Gamma(P2)", "monotonically decreasing",
            f"Gamma(P1) - Gamma(P2) has the eigenvalues {change[0]:g} and {change[1]:g}", "claim false",
            "one mode, A = [0 2; 0 0], P2 = diag(10, 50), P1 = P2 + I; both fulfil (7.17)",
        ),
        row(
            "(7.19): the H2 norm sums |E z|^2", "|| E z ||^2", "sum of E |z|^2 over k >= 1", "claim false",
            "what (7.20)-(7.21) and the proof compute; both are offered (definition=\"mean\" is as printed)",
        ),
        row(
            "(7.24c): X_i is the inverse of a sum over r and s", "sum over r, s", "sum over j, s: E_i(P) of (7.29)",
            "claim false", "with the printed indices the mode that it belongs to is summed away",
        ),
        row(
            "(7.35): payload of one control packet", "20 bytes", f"{(2 * 2 + 1) * 4} bytes", "reproduced",
            "(d + 1) rows x 2 inputs + one time stamp, 4 bytes each: one CAN FD frame with our header",
        ),
    ]  # fmt: skip
