"""Plants, network and published gains of Section 7.4, and what may be said of the plants without the network.

That is of the printed models, and of controllers that are designed without it (tau = d = 0 always), and what they do over it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from design.jump_linear import h2_norm
from design.jump_linear.bounded_real import hinf_norm
from design.monte_carlo.studies import mjls_energies
from design.networked_loop.certify import certify_loop
from design.networked_loop.closed_loop import loop_structure
from design.tracking.synthesis import TrackingProblem, solve
from hil.design_questions import LAMBDA, PI, PRINTED_VTOL
from hil.thesis import Array, ReportProgress
from hil.thesis.statements import ERRORS, above, below, equal, exactly, statement, within
from plants import VTOL, DCMotor
from transport.packets import encode_control
from transport.wire import FD_LENGTHS, ControlPacket

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


def norm_of(plant: Plant, gains: Array, objective: str) -> float:
    """The norm, "h2" or "hinf", of the loop with the printed selection rule."""
    system = loop_structure(*plant, *NETWORK, "generated", output="sum").system(gains)
    return h2_norm(system) if objective == "h2" else hinf_norm(system)


def models(report_progress: ReportProgress) -> dict[str, Any]:
    """The printed matrices against the plants, and statements of Section 7.3 that do not hold as printed."""
    A, right = PRINTED_MOTOR[0], motor()
    printed = np.sort(np.linalg.eigvals(A).real)
    exact = VTOL().model().discretise(0.01)
    A_v, B_v, _ = vtol()
    pair = np.linalg.eigvals(np.asarray(exact.A))
    pair = pair[np.lexsort((-pair.imag, -np.round(np.abs(pair), 9)))]
    jump = np.array([[0.0, 2.0], [0.0, 0.0]])
    P2 = 10.0 * np.array([[1.0, 0.0], [0.0, 5.0]])
    P1 = P2 + np.eye(2)
    gammas = [jump.T @ P @ jump - P for P in (P1, P2)]
    modal = np.linalg.inv(np.linalg.eig(right.A)[1].real)
    idle = modal.T @ modal
    loop = loop_structure(*right, *NETWORK, "generated", output="sum").system(H2)
    energy, mean = h2_norm(loop), h2_norm(loop, definition="mean")
    transition = loop.matrices[4]
    after_impulse = np.full(len(transition), 1.0 / len(transition)) @ transition  # the mode one slot after a uniform start
    runs = mjls_energies(loop, 4000, 300, start=loop.matrices[1][0, :, 0], initial=after_impulse, seed=1)
    rows = tuple(map(tuple, VTOL_H2[0, :, :, 0].tolist()))
    frame = encode_control(ControlPacket(seq=0, sample_ns=0, control_ns=0, tau=0, selection=0, rows=rows))
    return {
        "eigenvalues": printed, "smaller": float(np.exp(-3.5287 * 0.05)), "needed": -float(np.log(printed[0])) / 3.5287,
        "response": _response(*PRINTED_MOTOR), "hold": _response(right.A, right.B),
        "A": right.A, "B": right.B, "entry": float(np.abs(np.asarray(exact.A)).max()),
        "off": float(np.abs(np.hstack([np.asarray(exact.A) - A_v, np.asarray(exact.B) - B_v])).max()),
        "pair": pair, "words": ", ".join(f"{v.real:.4f}{v.imag:+.4f}i" if v.imag else f"{v.real:.4f}" for v in pair),
        "rounded": max(float(v.imag) for v in np.linalg.eigvals(A_v)), "change": np.linalg.eigvalsh(gammas[0] - gammas[1]),
        "valid": float(np.linalg.eigvalsh(np.negative(gammas)).min()),
        "greater": float(np.linalg.eigvalsh(P1 - P2).min()), "idle": float(np.abs(np.linalg.eigvals(right.A)).max()),
        "left": float(np.linalg.eigvalsh(right.A.T @ idle @ right.A - idle).max()), "idle_P": np.linalg.eigvalsh(idle).min(),
        "energy": energy, "mean": mean,
        "emulated": float(runs.mean()) ** 0.5,
        "errors": [(float(runs.mean()) - norm**2) / (float(runs.std()) / len(runs) ** 0.5) for norm in (energy, mean)],
        "bytes": np.float32().itemsize * (VTOL_H2[0].size + 1), "frames": -(-len(frame) // FD_LENGTHS[-1]),
    }  # fmt: skip


def _response(A: Array, B: Array) -> list[float]:
    """The angle one and two samples after an impulse."""
    return [float(B[0, 0]), float((A @ B)[0, 0])]


HALF = 0.5e-4
EIGENVALUES = ((1.0028, 0.0026), (1.0028, -0.0026), (0.9977, 0.0), (0.9795, 0.0))


# fmt: off
MODELS = (
    statement(
        "motor: A, B at T = 0.05 s", "[1.00021 .00460; .00460 .00004], [.34868; 7.68069]",
        exactly("largest eigenvalue", "eigenvalues[1]", 1, 0.5e-5),
        exactly("smallest eigenvalue", "eigenvalues[0]", "smaller", 0.5e-5),
        *(exactly(f"angle {n + 1} samples after an impulse", f"response[{n}]", f"hold[{n}]", 0.5e-5) for n in (0, 1)),
        witness=(above("largest eigenvalue, 1 of any hold,", "eigenvalues[1]", 1.0001),),
        computed="[1 {A[0][1]:.6f}; 0 {A[1][1]:.6f}], [{B[0][0]:.6f}; {B[1][0]:.6f}]",
        basis="a hold has the eigenvalues 1 and exp(-3.5287 T) at every T; the printed ones are {eigenvalues[1]:.5f} and "
        "{eigenvalues[0]:.5f}, so the first is never met and the second asks for T = {needed:.1f} s",
    ),
    statement(
        "VTOL: A, B at T = 0.01 s", "4 decimals", exactly("largest difference", "off", 0, HALF, "entry"),
        basis="half a unit of the last printed digit; zero-order hold of the matrices of Chapters 3 and 4",
    ),
    statement(
        "VTOL: eigenvalues of A", "0.9977, 0.9795, 1.0028 +- 0.0026i",
        *(
            exactly(f"{part} of eigenvalue {n + 1}", f"pair[{n}].{name}", value, HALF)
            for n, both in enumerate(EIGENVALUES)
            for part, name, value in zip(("real part", "imaginary part"), ("real", "imag"), both)
        ),
        computed="{words}",
        basis="half a unit of the last printed digit, of the unrounded hold; the printed four decimals have the imaginary part "
        "{rounded:.4f}",
    ),
    statement(
        "Remark 7.5: P1 > P2 implies Gamma(P1) < Gamma(P2)", "monotonically decreasing",
        below("largest eigenvalue of Gamma(P1) - Gamma(P2)", "change[1]", 0),
        witness=(
            above("largest eigenvalue of Gamma(P1) - Gamma(P2)", "change[1]", 0), above("margin of both in (7.17)", "valid", 0),
            above("smallest eigenvalue of P1 - P2", "greater", 0),
        ),
        computed="Gamma(P1) - Gamma(P2) has the eigenvalues {change[0]:g} and {change[1]:g}",
        basis="one mode, A = [0 2; 0 0], P2 = diag(10, 50), P1 = P2 + I; both fulfil (7.17)",
    ),
    statement(
        "Theorem 7.1: (7.17), with <= 0, is sufficient", "stochastically stable",
        below("spectral radius of the motor without control", "idle", 1),
        witness=(
            exactly("largest eigenvalue of A' P A - P", "left", 0, 1e-12), above("smallest eigenvalue of P", "idle_P", 0),
            above("spectral radius", "idle", 1 - 1e-12),
        ),
        basis="P = V^-T V^-1 of its eigenvectors V: where nothing is done the angle stays; (7.17) has to be strict. The proof of "
        "Theorem 7.2 has no more than <= from (7.21)",
    ),
    statement(
        "(7.19): the H2 norm sums |E z|^2", "|| E z ||^2", exactly("norm by (7.20)-(7.21)", "energy", "mean", 1e-6),
        witness=(
            within("sum of E |z|^2 over 4000 runs less (7.20)-(7.21), standard errors", "errors[0]", -ERRORS, ERRORS),
            above("the same less (7.19), standard errors", "errors[1]", ERRORS),
        ),
        computed="with (7.37): {energy:.4f} by (7.20)-(7.21), {mean:.4f} by (7.19) as printed; sum of E |z|^2 over 4000 runs "
        "{emulated:.4f}",
        basis='(7.20)-(7.21) and the proof compute the sum of E |z|^2; both are offered (definition="mean" is as printed)',
    ),
    statement(
        "(7.35): payload of one control packet", "20 bytes",
        exactly("bytes", "bytes", 20), exactly("CAN FD frames of our packet", "frames", 1),
        basis="(d + 1) rows x 2 inputs + one time stamp, 4 bytes each: one CAN FD frame with our header",
    ),
)
# fmt: on

ALONE = np.eye(1)
SMALL_PEAK = np.array([[-71.05], [-26.80]])
"""A gain of the VTOL without the network, from a direct search on its H-infinity norm, z a sum."""


def local_designs(report_progress: ReportProgress) -> dict[str, Any]:
    """Gains designed without the network, printed and computed, and the stability of both kinds over it."""
    gains, (A, B, C) = everywhere(np.array([[LOCAL]])), vtol()
    over = [certify_loop(*motor(T), *NETWORK, gains, "constant").mean_square_radius for T in (0.05, 0.025)]
    vertical = certify_loop(*vtol(), *NETWORK, everywhere(VTOL_LOCAL), "constant").mean_square_radius
    radii = [certify_loop(*motor(), *NETWORK, K, "generated").mean_square_radius for K in (HINF, H2)]
    report_progress("motor, local H-infinity gain", 1, 3)
    a, b, c = motor()
    local = solve(TrackingProblem(A=a, B=b, C=c, sc=ALONE, ca=ALONE, objective="hinf", output="sum"))
    report_progress("VTOL, local gains", 2, 3)
    h2 = solve(TrackingProblem(A=A, B=B, C=C, sc=ALONE, ca=ALONE, objective="h2", output="sum")).gains[0, 0]
    loop = loop_structure(A, B, C, ALONE, ALONE, "generated", output="sum")
    values = {
        "h2": [h2_norm(loop.system(K[None, None])) for K in (VTOL_LOCAL, h2)],
        "hinf": [hinf_norm(loop.system(K[None, None])) for K in (VTOL_LOCAL, SMALL_PEAK)],
    }  # fmt: skip
    return {
        "over": over, "vertical": vertical, "radii": radii, "gain": local.gains[0, 0, 0, 0], "norm": local.certificate.hinf_norm,
        "best": h2, "values": values,
        "labels": [[norm_of(vtol(), K, which) for which in ("h2", "hinf")] for K in (VTOL_H2, VTOL_HINF)],
        "excess": {name: mine / least - 1.0 for name, (mine, least) in values.items()},
    }  # fmt: skip


VTOL_GAIN, SMALL_GAIN = "[-56.0196 -10.5998]", "[-71.05 -26.80]"


# fmt: off
LOCAL_DESIGNS = (
    statement(
        "motor: (7.36) and (7.37) stabilise at T = 0.05 s", "stochastically stable",
        below("radius with (7.36)", "radii[0]", 1), below("radius with (7.37)", "radii[1]", 1),
        basis="spectral radius of the second-moment operator: Theorem 7.1, exactly",
    ),
    statement(
        "motor: local H-infinity gain", f"{LOCAL}", equal("gain", "gain", f"{LOCAL}"),
        basis="designed without the network, z a sum, T = 0.05 s: norm {norm:.4f}",
    ),
    statement(
        "motor: the local gain runs over the network", "stable (Figure 7.8)", below("radius at T = 0.05 s", "over[0]", 1),
        witness=(above("radius at T = 0.05 s", "over[0]", 1), below("radius at T = 0.025 s", "over[1]", 1)),
        basis="not mean-square stable at the stated period; stable at half of it",
    ),
    statement(
        "VTOL: the local gain runs over the network", "stable (Figures 7.2, 7.3)", below("radius", "vertical", 1),
        witness=(above("radius", "vertical", 1),), basis="not mean-square stable; five seconds of it are finite all the same",
    ),
    statement(
        f"VTOL: {VTOL_GAIN} is the local H2 gain", VTOL_GAIN,
        below("its H2 norm above the smallest found, relative,", "excess[h2]", 0.01),
        witness=(above("its H2 norm above the smallest found, relative,", "excess[h2]", 0.01),),
        beside=(below(f"its H-infinity norm above that of {SMALL_GAIN}, relative,", "excess[hinf]", 0.01),),
        computed="smallest H2 norm {values[h2][1]:.4f} at [{best[0][0]:.4f} {best[1][0]:.4f}]; the printed gain has "
        "{values[h2][0]:.4f}, {excess[h2]:.0%} more",
        basis="designed without the network, z = Q x + R u1(k-1) as printed (a sum); no local H-infinity gain is printed. The "
        f"label is not swapped either: {SMALL_GAIN} has the H-infinity norm {{values[hinf][1]:.4f}}, the printed gain "
        "{values[hinf][0]:.4f}, {excess[hinf]:.0%} more",
    ),
    statement(
        "VTOL: the labels of the networked gains of 7.4.1", "K for beta_min, K for gamma_min",
        below("H2 norm of the H2 gains, less than of the others", "labels[0][0]", "labels[1][0]"),
        below("H-infinity norm of the H-infinity gains, less than of the others", "labels[1][1]", "labels[0][1]"),
        computed="H2 norms {labels[0][0]:.4f} and {labels[1][0]:.4f}, H-infinity norms {labels[0][1]:.4f} and {labels[1][1]:.4f} "
        "of the gains that are called H2 and H-infinity",
        basis="z a sum; no exchange of the labels would give the printed beta_min and gamma_min",
    ),
)
# fmt: on
