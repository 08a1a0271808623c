"""Plants, network and published gains of Section 7.4, and what may be said of the plants alone."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from design.jump_linear.bounded_real import hinf_norm
from design.jump_linear.h2 import h2_norm
from design.monte_carlo.markov_batch import simulate_mjls
from design.networked_loop.closed_loop import loop_structure
from hil.design_questions.design_problem import LAMBDA, PI, PRINTED_VTOL
from hil.thesis.chapter import ReportProgress
from hil.thesis.statements import ERRORS, Statement, above, below, exactly, within
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


def norms_of(plant: Plant, gains: Array) -> tuple[float, float]:
    """H2 and H-infinity norm of the loop with the printed selection rule."""
    system = loop_structure(*plant, *NETWORK, "generated", output="sum").system(gains)
    return h2_norm(system), hinf_norm(system)


def models(report_progress: ReportProgress) -> dict[str, Any]:
    """The printed matrices against the plants, and statements of Section 7.3 that do not hold as printed."""
    A, right = PRINTED_MOTOR[0], motor()
    printed = np.sort(np.linalg.eigvals(A))
    exact = VTOL().model().discretise(0.01)
    A_v, B_v, _ = vtol()
    pair = np.linalg.eigvals(np.asarray(exact.A))
    pair = pair[np.lexsort((-pair.imag, -np.round(np.abs(pair), 9)))]
    jump = np.array([[0.0, 2.0], [0.0, 0.0]])
    P2 = 10.0 * np.array([[1.0, 0.0], [0.0, 5.0]])
    P1 = P2 + np.eye(2)
    gammas = [jump.T @ P @ jump - P for P in (P1, P2)]
    loop = loop_structure(*right, *NETWORK, "generated", output="sum").system(H2)
    energy, mean = h2_norm(loop), h2_norm(loop, definition="mean")
    transition = loop.matrices[4]
    after_impulse = np.full(len(transition), 1.0 / len(transition)) @ transition  # the mode one slot after a uniform start
    runs = simulate_mjls(loop, 4000, 300, start=loop.matrices[1][0, :, 0], initial=after_impulse, seed=1).energy
    return {
        "eigenvalues": printed, "smaller": float(np.exp(-3.5287 * 0.05)), "needed": -float(np.log(printed[0])) / 3.5287,
        "excess": printed[1] - 1.0, "A": right.A, "B": right.B, "entry": float(np.abs(np.asarray(exact.A)).max()),
        "off": max(float(np.abs(np.asarray(exact.A) - A_v).max()), float(np.abs(np.asarray(exact.B) - B_v).max())),
        "pair": pair, "words": ", ".join(f"{v.real:.4f}{v.imag:+.4f}i" if v.imag else f"{v.real:.4f}" for v in pair),
        "rounded": max(float(v.imag) for v in np.linalg.eigvals(A_v)), "change": np.linalg.eigvalsh(gammas[0] - gammas[1]),
        "valid": min(float(np.linalg.eigvalsh(-gamma).min()) for gamma in gammas),
        "greater": float(np.linalg.eigvalsh(P1 - P2).min()), "energy": energy, "mean": mean, "over": energy / mean - 1.0,
        "emulated": float(runs.mean()) ** 0.5,
        "errors": (float(runs.mean()) - energy**2) / (float(runs.std()) / len(runs) ** 0.5),
        "bytes": 4 * (len(PI) * vtol().B.shape[1] + 1),
    }  # fmt: skip


HALF = 0.5e-4
EIGENVALUES = ((1.0028, 0.0026), (1.0028, -0.0026), (0.9977, 0.0), (0.9795, 0.0))
# fmt: off
MODELS = (
    Statement(
        "motor: A, B at T = 0.05 s", "[1.00021 .00460; .00460 .00004], [.34868; 7.68069]",
        (
            exactly("largest eigenvalue", "eigenvalues[1]", 1, 0.5e-5),
            exactly("smallest eigenvalue", "eigenvalues[0]", "smaller", 0.5e-5),
        ),
        (above("distance of the printed A from any hold: largest eigenvalue - 1", "excess", 1e-4),),
        computed="[1 {A[0][1]:.6f}; 0 {A[1][1]:.6f}], [{B[0][0]:.6f}; {B[1][0]:.6f}]",
        basis="a hold has the eigenvalues 1 and exp(-3.5287 T) at every T; the printed ones are {eigenvalues[1]:.5f} and "
        "{eigenvalues[0]:.5f}, so the first is never met and the second asks for T = {needed:.1f} s",
    ),
    Statement(
        "VTOL: A, B at T = 0.01 s", "4 decimals", (exactly("largest difference", "off", 0, HALF, "entry"),),
        basis="half a unit of the last printed digit; zero-order hold of the matrices of Chapters 3 and 4",
    ),
    Statement(
        "VTOL: eigenvalues of A", "0.9977, 0.9795, 1.0028 +- 0.0026i",
        tuple(
            exactly(f"{part} of eigenvalue {n + 1}", f"pair[{n}].{name}", value, HALF)
            for n, both in enumerate(EIGENVALUES)
            for part, name, value in zip(("real part", "imaginary part"), ("real", "imag"), both)
        ),
        computed="{words}",
        basis="half a unit of the last printed digit, of the unrounded hold; the printed four decimals have the imaginary part "
        "{rounded:.4f}",
    ),
    Statement(
        "Remark 7.5: P1 > P2 implies Gamma(P1) < Gamma(P2)", "monotonically decreasing",
        (below("largest eigenvalue of Gamma(P1) - Gamma(P2)", "change[1]", 0),),
        (
            above("largest eigenvalue of Gamma(P1) - Gamma(P2)", "change[1]", 0), above("margin of both in (7.17)", "valid", 0),
            above("smallest eigenvalue of P1 - P2", "greater", 0),
        ),
        computed="Gamma(P1) - Gamma(P2) has the eigenvalues {change[0]:g} and {change[1]:g}",
        basis="one mode, A = [0 2; 0 0], P2 = diag(10, 50), P1 = P2 + I; both fulfil (7.17)",
    ),
    Statement(
        "(7.19): the H2 norm sums |E z|^2", "|| E z ||^2", (exactly("norm by (7.20)-(7.21)", "energy", "mean", 1e-6),),
        (
            above("excess of (7.20)-(7.21) over (7.19)", "over", 0.01),
            within("sum of E |z|^2 over 4000 runs less (7.20)-(7.21), standard errors", "errors", -ERRORS, ERRORS),
        ),
        computed="with (7.37): {energy:.4f} by (7.20)-(7.21), {mean:.4f} by (7.19) as printed; sum of E |z|^2 over 4000 runs "
        "{emulated:.4f}",
        basis='(7.20)-(7.21) and the proof compute the sum of E |z|^2; both are offered (definition="mean" is as printed)',
    ),
    Statement(
        "(7.35): payload of one control packet", "20 bytes", (exactly("bytes", "bytes", 20),),
        basis="(d + 1) rows x 2 inputs + one time stamp, 4 bytes each: one CAN FD frame with our header",
    ),
)
# fmt: on
