"""The mixed design (7.33) as a curve, and lost packets as delays (Remark 7.1)."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from design.jump_linear.second_moment import mean_square_radius
from design.networked_loop.closed_loop import loop_structure
from hil.pages.html.figures import Figure, Series
from hil.reproduce.chapter import Plot, ReportProgress
from hil.reproduce.chapter7.designs import best
from hil.reproduce.chapter7.emulated import on_all_cores
from hil.reproduce.chapter7.models import H2, motor
from hil.reproduce.statements import Statement, above, below, exactly

LEVELS = (1.003, 1.01, 1.02, 1.04, 1.06)
"""H-infinity levels of the mixed designs, over the smallest that is reached."""
LOST, MOST_LOST = (0.3, 0.4), (2, 1)
"""Probability that a packet is lost, and how many are in a row at most, to the controller and to the actuator."""
SLACK = 1e-3
"""Share by which a descent may end above the minimum."""


def trade_off(report_progress: ReportProgress) -> dict[str, Any]:
    """Smallest H2 norm of the motor's loop for every H-infinity level, and the loop over packets that are lost."""
    ends = on_all_cores(_norms, [("hinf", None), ("h2", None)], report_progress, ["H-infinity", "H2"])
    least = ends[0][1]
    asked = [("mixed", share * least) for share in LEVELS]
    mixed = on_all_cores(_norms, asked, report_progress, [f"gamma {level:.4g}" for _, level in asked])
    beta, gamma = (np.array([each[i] for each in (*mixed, ends[1])]) for i in (0, 1))
    curve = Series(label="designs by (7.33)", x=gamma, y=beta)
    figure = Figure(
        title="H2 norm against H-infinity norm of the motor's loop", series=(curve,), x_label="H-infinity norm", x_unit="",
        y_label="H2 norm", sync=None, note="the last design has no level; stacked z, rows by the d when they are applied",
    )  # fmt: skip
    return {
        "beta": beta, "gamma": gamma, "ends": [gamma[0], gamma[-1], beta[0], beta[-1]],
        "over": float(max(gamma[:-1] / [level for _, level in asked])) - 1.0,
        "rise": float((beta[1:] / beta[:-1]).max()) - 1.0, "paid": float(beta[0] / beta[-1]) - 1.0,
        "gained": 1.0 - float(gamma[0] / gamma[-1]), "chain": _over_chains(), "packets": _packet_by_packet(),
        "figures": (Plot(title="Trade-off of the two norms", panels=(figure,)),),
    }  # fmt: skip


def _norms(objective: str, level: float | None) -> tuple[float, float]:
    certificate = best(motor(), objective=objective, information="applied", hinf_bound=level).certificate
    h2, hinf = (np.nan if norm is None else float(norm) for norm in (certificate.h2_norm, certificate.hinf_norm))
    return h2, hinf


def _over_chains() -> float:
    """Radius of the second moments with the age of the newest packet that came as the delay."""
    chains = []
    for lost, most in zip(LOST, MOST_LOST):
        chain = np.zeros((most + 1, most + 1))
        chain[:, 0] = 1.0 - lost
        chain[most, 0] = 1.0
        chain[np.arange(most), np.arange(1, most + 1)] = lost
        chains.append(chain)
    plant = motor()
    structure = loop_structure(plant.A, plant.B, plant.C, chains[0], chains[1], "applied")
    return mean_square_radius(structure.matrices(H2), structure.transition)


def _packet_by_packet() -> float:
    """The same radius with no delay in it: what each receiver holds, and how many packets in a row it has missed."""
    A, B, C = motor()
    n, size = len(A), len(A) + 3  # x, the sample that the controller holds, the two rows that the actuator holds
    modes = list(product(range(MOST_LOST[0] + 1), range(MOST_LOST[1] + 1)))
    operator = np.zeros((len(modes), size**2, len(modes), size**2))
    for at, missed in enumerate(modes):
        for came in product((True, False), repeat=2):
            chance, now = 1.0, []
            for lost, most, before, through in zip(LOST, MOST_LOST, missed, came):
                chance *= (1.0 if through else 0.0) if before == most else (1.0 - lost if through else lost)
                now.append(0 if through else before + 1)
            if not chance:
                continue
            held = np.hstack([C, np.zeros((1, 3))]) if came[0] else np.eye(1, size, n)
            rows = np.vstack([H2[now[0], d, 0] @ held for d in range(2)]) if came[1] else np.eye(2, size, n + 1)
            F = np.vstack([np.hstack([A, np.zeros((n, 3))]) + B @ rows[now[1]][None], held, rows])
            operator[modes.index((now[0], now[1])), :, at] += chance * np.kron(F, F)
    return float(np.abs(np.linalg.eigvals(operator.reshape(len(modes) * size**2, -1))).max())


# fmt: off
TRADE_OFF = (
    Statement(
        "(7.33): a compromise between H2 and H-infinity by a prescribed gamma", "min beta s.t. (7.24) and (7.30)",
        (
            below("largest H-infinity norm over its level, less 1", "over", 1e-6),
            below("largest rise of beta as the level is let go", "rise", SLACK),
            above("what the tightest level costs in beta", "paid", SLACK),
            above("what it gains in gamma", "gained", SLACK),
        ),
        computed="gamma {ends[0]:.5g} ... {ends[1]:.5g}, beta {ends[2]:.5g} ... {ends[3]:.5g}",
        basis="the motor over its network, stacked z, R = 0.01, rows by the d when they are applied; no mixed design is printed",
    ),
    Statement(
        "Remark 7.1: packets lost, at most so many in a row, are delays of (7.3)-(7.5)", "can accommodate packet dropouts",
        (exactly("second-moment radius over the chain of ages", "chain", "packets", 1e-9),),
        computed="{chain:.10g} over the chain of ages, {packets:.10g} packet by packet",
        basis=f"the motor with (7.37); to the controller a packet is lost with chance {LOST[0]:g}, {MOST_LOST[0]} in a row "
        f"at most, to the actuator {LOST[1]:g} and {MOST_LOST[1]}; beside it nothing but what the receivers hold",
    ),
)
# fmt: on
