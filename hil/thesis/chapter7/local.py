"""Controllers that are designed without the network (tau = d = 0 always), and what they do over it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from design.jump_linear.h2 import h2_norm
from design.networked_loop.certify import certify_loop
from design.networked_loop.closed_loop import loop_structure
from design.tracking.synthesis import TrackingProblem, solve
from hil.thesis.chapter import ReportProgress
from hil.thesis.chapter7.models import (
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
from hil.thesis.statements import Statement, above, below, equal

ALONE = np.eye(1)


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
    hinf = smallest_peak(VTOL_LOCAL[:, 0])[:, None]
    loop = loop_structure(A, B, C, ALONE, ALONE, "generated", output="sum")
    values = {
        "h2": [h2_norm(loop.system(K[None, None])) for K in (VTOL_LOCAL, h2)],
        "hinf": [peak(K[:, 0]) for K in (VTOL_LOCAL, hinf)],
    }  # fmt: skip
    return {
        "over": over, "vertical": vertical, "radii": radii, "gain": local.gains[0, 0, 0, 0], "norm": local.certificate.hinf_norm,
        "best": {"h2": h2, "hinf": hinf}, "values": values, "labels": [norms_of(vtol(), K) for K in (VTOL_H2, VTOL_HINF)],
        "excess": {name: mine / least - 1.0 for name, (mine, least) in values.items()},
    }  # fmt: skip


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


VTOL_GAIN = "[-56.0196 -10.5998]"
# fmt: off
LOCAL_DESIGNS = (
    Statement(
        "motor: (7.36) and (7.37) stabilise at T = 0.05 s", "stochastically stable",
        (below("radius with (7.36)", "radii[0]", 1), below("radius with (7.37)", "radii[1]", 1)),
        basis="spectral radius of the second-moment operator: Theorem 7.1, exactly",
    ),
    Statement(
        "motor: local H-infinity gain", f"{LOCAL}", (equal("gain", "gain", f"{LOCAL}"),),
        basis="designed without the network, z a sum, T = 0.05 s: norm {norm:.4f}",
    ),
    Statement(
        "motor: the local gain runs over the network", "stable (Figure 7.8)", (below("radius at T = 0.05 s", "over[0]", 1),),
        (above("radius at T = 0.05 s", "over[0]", 1), below("radius at T = 0.025 s", "over[1]", 1)),
        basis="not mean-square stable at the stated period; stable at half of it",
    ),
    Statement(
        "VTOL: the local gain runs over the network", "stable (Figures 7.2, 7.3)", (below("radius", "vertical", 1),),
        (above("radius", "vertical", 1),), basis="not mean-square stable; five seconds of it are finite all the same",
    ),
    Statement(
        f"VTOL: {VTOL_GAIN} is the local H2 gain", VTOL_GAIN,
        (below("its H2 norm above the smallest found, relative,", "excess[h2]", 0.01),),
        (above("its H2 norm above the smallest found, relative,", "excess[h2]", 0.01),),
        beside=(below("its H-infinity norm above the smallest found, relative,", "excess[hinf]", 0.01),),
        computed="smallest H2 norm {values[h2][1]:.4f} at [{best[h2][0][0]:.4f} {best[h2][1][0]:.4f}]; the printed gain has "
        "{values[h2][0]:.4f}, {excess[h2]:.0%} more",
        basis="designed without the network, z = Q x + R u1(k-1) as printed (a sum); no local H-infinity gain is printed. The "
        "label is not swapped either: the smallest H-infinity norm found is {values[hinf][1]:.4f} at "
        "[{best[hinf][0][0]:.4f} {best[hinf][1][0]:.4f}], the printed gain has {values[hinf][0]:.4f}, {excess[hinf]:.0%} more",
    ),
    Statement(
        "VTOL: the labels of the networked gains of 7.4.1", "K for beta_min, K for gamma_min",
        (
            below("H2 norm of the H2 gains, less than of the others", "labels[0][0]", "labels[1][0]"),
            below("H-infinity norm of the H-infinity gains, less than of the others", "labels[1][1]", "labels[0][1]"),
        ),
        computed="H2 norms {labels[0][0]:.4f} and {labels[1][0]:.4f}, H-infinity norms {labels[0][1]:.4f} and {labels[1][1]:.4f} "
        "of the gains that are called H2 and H-infinity",
        basis="z a sum; no exchange of the labels would give the printed beta_min and gamma_min",
    ),
)
# fmt: on
