"""Controllers that are designed without the network (tau = d = 0 always), and what they do over it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from design.jump_linear.h2 import h2_norm
from design.networked_loop.certify import certify_loop
from design.networked_loop.closed_loop import loop_structure
from design.tracking.synthesis import TrackingProblem, solve
from hil.reproduce.chapter import Part, ReportProgress
from hil.reproduce.chapter7.models import (
    H2,
    HINF,
    LOCAL,
    NETWORK,
    VTOL_H2,
    VTOL_HINF,
    VTOL_LOCAL,
    Array,
    everywhere,
    motor,
    norms_of,
    vtol,
)
from hil.reproduce.judgement import Row, above, below, near, row

ALONE = np.eye(1)


def local_designs(report_progress: ReportProgress) -> Part:
    """Gains designed without the network, printed and computed, and the stability of both kinds over it."""
    gains = everywhere(np.array([[LOCAL]]))
    over, fast = (certify_loop(*motor(T), *NETWORK, gains, "constant").mean_square_radius for T in (0.05, 0.025))
    vertical = certify_loop(*vtol(), *NETWORK, everywhere(VTOL_LOCAL), "constant").mean_square_radius
    radii = [certify_loop(*motor(), *NETWORK, K, "generated").mean_square_radius for K in (HINF, H2)]
    report_progress("motor, local H-infinity gain", 1, 3)
    A, B, C = motor()
    local = solve(TrackingProblem(A=A, B=B, C=C, sc=ALONE, ca=ALONE, objective="hinf", output="sum"))
    report_progress("VTOL, local gains", 2, 3)
    rows = (
        row(
            "motor: (7.36) and (7.37) stabilise at T = 0.05 s", "stochastically stable",
            below("radius with (7.36)", radii[0], 1.0), below("radius with (7.37)", radii[1], 1.0),
            basis="spectral radius of the second-moment operator: Theorem 7.1, exactly",
        ),
        row(
            "motor: local H-infinity gain", f"{LOCAL}", near("gain", float(local.gains[0, 0, 0, 0]), LOCAL, absolute=0.005),
            basis=f"designed without the network, z a sum, T = 0.05 s: norm {local.certificate.hinf_norm:.4f}",
        ),
        row(
            "motor: the local gain runs over the network", "12.11 (Table 7.2)", below("radius at T = 0.05 s", over, 1.0),
            witness=(above("radius at T = 0.05 s", over, 1.0), below("radius at T = 0.025 s", fast, 1.0)),
            basis="not mean-square stable at the stated period; stable at half of it",
        ),
        row(
            "VTOL: the local gain runs over the network", "0.3319 (Table 7.1)", below("radius", vertical, 1.0),
            witness=(above("radius", vertical, 1.0),), basis="not mean-square stable; five seconds of it are finite all the same",
        ),
        *_vtol_rows(),
    )  # fmt: skip
    return Part(rows=rows)


def _vtol_rows() -> list[Row]:
    A, B, C = vtol()
    h2 = solve(TrackingProblem(A=A, B=B, C=C, sc=ALONE, ca=ALONE, objective="h2", output="sum")).gains[0, 0]
    hinf = smallest_peak(VTOL_LOCAL[:, 0])[:, None]
    loop = loop_structure(A, B, C, ALONE, ALONE, "generated", output="sum")
    h2_of = [h2_norm(loop.system(K[None, None])) for K in (VTOL_LOCAL, h2)]
    peak_of = [peak(K[:, 0]) for K in (VTOL_LOCAL, hinf)]
    printed = "[" + " ".join(f"{v:.4f}" for v in VTOL_LOCAL[:, 0]) + "]"
    rows = []
    for name, best, values in (("H2", h2, h2_of), ("H-infinity", hinf, peak_of)):
        excess = values[0] / values[1] - 1.0
        rows.append(
            row(
                f"VTOL: {printed} is the local {name} gain", printed if name == "H2" else "-",
                below("its norm above the smallest found, relative,", excess, 0.01),
                computed=f"smallest {values[1]:.4f} at [{best[0, 0]:.4f} {best[1, 0]:.4f}]; the printed gain has "
                f"{values[0]:.4f}, {excess:.0%} more",
                witness=(above("its norm above the smallest found, relative,", excess, 0.01),),
                basis="designed without the network, z = Q x + R u1(k-1) as printed (a sum); no local H-infinity gain is "
                "printed. The label is not swapped either: the printed gain is the optimum of neither norm",
            )
        )  # fmt: skip
    return [*rows, labels_row()]


def labels_row() -> Row:
    """Whether the gains of 7.4.1 bear the right names: those called H2 have the smaller H2 norm, the others the smaller peak."""
    own = {name: norms_of(vtol(), gains) for name, gains in (("H2", VTOL_H2), ("H-infinity", VTOL_HINF))}
    (h2, peak_of_h2), (h2_of_hinf, hinf) = own["H2"], own["H-infinity"]
    return row(
        "VTOL: the labels of the networked gains of 7.4.1", "K for beta_min, K for gamma_min",
        below("H2 norm of the H2 gains less that of the others", h2 - h2_of_hinf, 0.0),
        below("H-infinity norm of the H-infinity gains less that of the others", hinf - peak_of_h2, 0.0),
        computed=f"H2 norms {h2:.4f} and {h2_of_hinf:.4f}, H-infinity norms {peak_of_h2:.4f} and {hinf:.4f}, of the gains that "
        "are called H2 and H-infinity",
        basis="z a sum; printed are beta_min = 0.1225 and gamma_min = 0.3464, which no exchange of the labels would give",
    )  # fmt: skip


def peak(gain: npt.ArrayLike) -> float:
    """H-infinity norm of the VTOL with u = K y and no delay, from w to z = Q x + R u1(k-1), on a grid of frequencies.

    A large number where the loop is not stable. The descent of ``design.tracking`` did not end here in four minutes.
    """
    A, B, C = vtol()
    K = np.asarray(gain, dtype=np.float64).reshape(-1, 1)
    closed = A + B @ K @ C
    if np.abs(np.linalg.eigvals(closed)).max() >= 1.0:
        return 1e3
    wave = np.exp(1j * np.geomspace(1e-4, np.pi, 600))[:, None, None]
    state = np.linalg.solve(wave * np.eye(len(A)) - closed, B + 0j)
    z = C @ state + 0.01 * np.ones((1, B.shape[1])) @ (K @ C @ state) / wave
    return float(np.linalg.norm(z, axis=(1, 2)).max())


def smallest_peak(*starts: npt.ArrayLike) -> Array:
    """The gain of least `peak` that a direct search finds from the starts and from the H2 gain's neighbourhood, (m,)."""
    from scipy.optimize import minimize

    found = [
        minimize(peak, np.asarray(start, dtype=np.float64), method="Nelder-Mead", options={"maxiter": 200})
        for start in (*starts, (-10.0, 9.0))
    ]
    return np.asarray(min(found, key=lambda result: float(result.fun)).x)
