"""Plants, network and published gains of Section 7.4, and what may be said of the plants alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.jump_linear.bounded_real import hinf_norm
from design.jump_linear.h2 import h2_norm
from design.jump_linear.mjls import MJLS
from design.monte_carlo.markov_batch import simulate_mjls
from design.networked_loop.closed_loop import loop_structure
from hil.compose.design_problem import LAMBDA, PI, PRINTED_VTOL
from hil.reproduce.judgement import Row, above, below, near, row, within_error
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
VTOL_LOCAL = np.array([[-56.0196], [-10.5998]])
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


def norms_of(plant: Plant, gains: Array, output: str = "sum") -> tuple[float, float]:
    """H2 and H-infinity norm of the loop with the printed selection rule."""
    system = loop_structure(*plant, *NETWORK, "generated", output=output).system(gains)  # type: ignore[arg-type]
    return h2_norm(system), hinf_norm(system)


def model_rows() -> list[Row]:
    """The printed matrices against the plants."""
    A = PRINTED_MOTOR[0]
    right = motor()
    printed = np.sort(np.linalg.eigvals(A))
    needed = -float(np.log(printed[0])) / 3.5287
    smaller = float(np.exp(-3.5287 * 0.05))
    exact = VTOL().model().discretise(0.01)
    A_v, B_v, _ = vtol()
    off = max(float(np.abs(np.asarray(exact.A) - A_v).max()), float(np.abs(np.asarray(exact.B) - B_v).max()))
    pair = np.linalg.eigvals(np.asarray(exact.A))
    pair = pair[np.lexsort((-pair.imag, -np.round(np.abs(pair), 9)))]
    rounded = max(float(v.imag) for v in np.linalg.eigvals(A_v))
    return [
        row(
            "motor: A, B at T = 0.05 s", "[1.00021 .00460; .00460 .00004], [.34868; 7.68069]",
            near("largest eigenvalue", printed[1], 1.0, absolute=0.5e-5),
            near("smallest eigenvalue", printed[0], smaller, absolute=0.5e-5),
            computed=f"[1 {right.A[0, 1]:.6f}; 0 {right.A[1, 1]:.6f}], [{right.B[0, 0]:.6f}; {right.B[1, 0]:.6f}]",
            witness=(above("distance of the printed A from any hold: largest eigenvalue - 1", printed[1] - 1.0, 1e-4),),
            basis=f"a hold has the eigenvalues 1 and exp(-3.5287 T) at every T; the printed ones are {printed[1]:.5f} and "
            f"{printed[0]:.5f}, so the first is never met and the second asks for T = {needed:.1f} s",
        ),
        row(
            "VTOL: A, B at T = 0.01 s", "4 decimals", below("largest difference", off, 0.51e-4),
            basis="zero-order hold of the matrices of Chapters 3 and 4",
        ),
        row(
            "VTOL: eigenvalues of A", "0.9977, 0.9795, 1.0028 +- 0.0026i",
            *(
                near(f"{part} of eigenvalue {n + 1}", value, wanted, absolute=0.51e-4)
                for n, (v, w) in enumerate(zip(pair, (1.0028 + 0.0026j, 1.0028 - 0.0026j, 0.9977, 0.9795), strict=True))
                for part, value, wanted in (("real part", v.real, complex(w).real), ("imaginary part", v.imag, complex(w).imag))
            ),
            computed=", ".join(f"{v.real:.4f}{v.imag:+.4f}i" if v.imag else f"{v.real:.4f}" for v in pair),
            basis=f"of the unrounded hold; the printed four decimals have the imaginary part {rounded:.4f}",
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
    valid = min(float(np.linalg.eigvalsh(-gamma(P)).min()) for P in (P1, P2))
    return [
        row(
            "Remark 7.5: P1 > P2 implies Gamma(P1) < Gamma(P2)", "monotonically decreasing",
            below("largest eigenvalue of Gamma(P1) - Gamma(P2)", change[1], 0.0),
            computed=f"Gamma(P1) - Gamma(P2) has the eigenvalues {change[0]:g} and {change[1]:g}",
            witness=(
                above("largest eigenvalue of Gamma(P1) - Gamma(P2)", change[1], 0.0),
                above("margin of both in (7.17)", valid, 0.0),
                above("smallest eigenvalue of P1 - P2", float(np.linalg.eigvalsh(P1 - P2).min()), 0.0),
            ),
            basis="one mode, A = [0 2; 0 0], P2 = diag(10, 50), P1 = P2 + I; both fulfil (7.17)",
        ),
        _definition(),
        _payload(),
    ]  # fmt: skip


def _definition() -> Row:
    loop = loop_structure(*motor(), *NETWORK, "generated", output="sum").system(H2)
    energy, mean = h2_norm(loop), h2_norm(loop, definition="mean")
    runs = simulate_mjls(loop, 4000, 300, start=loop.matrices[1][0, :, 0], initial=_after_impulse(loop), seed=1).energy
    found, error = float(runs.mean()), float(runs.std()) / len(runs) ** 0.5
    return row(
        "(7.19): the H2 norm sums |E z|^2", "|| E z ||^2",
        near("norm by (7.20)-(7.21)", energy, mean, relative=0.01),
        computed=f"with (7.37): {energy:.4f} by (7.20)-(7.21), {mean:.4f} by (7.19) as printed; sum of E |z|^2 over 4000 runs "
        f"{found**0.5:.4f}",
        witness=(
            above("excess of (7.20)-(7.21) over (7.19)", energy / mean - 1.0, 0.01),
            within_error("sum of E |z|^2 over 4000 runs", found, energy**2, error=error, why="4 standard errors of the runs"),
        ),
        basis="(7.20)-(7.21) and the proof compute the sum of E |z|^2; both are offered (definition=\"mean\" is as printed)",
    )  # fmt: skip


def _after_impulse(loop: MJLS) -> Array:
    """Distribution of the mode one slot after a uniform start, when the impulse has entered the state."""
    transition = loop.matrices[4]
    return np.asarray(np.full(len(transition), 1.0 / len(transition)) @ transition)


def _payload() -> Row:
    words = len(PI) * vtol().B.shape[1] + 1
    return row(
        "(7.35): payload of one control packet", "20 bytes", near("bytes", words * 4, 20.0, absolute=0.5),
        basis="(d + 1) rows x 2 inputs + one time stamp, 4 bytes each: one CAN FD frame with our header",
    )  # fmt: skip
