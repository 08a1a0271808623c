"""What the record of a plant that jumps fulfils in a slot in which its mode stays: the flow of that mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from design.controllers import LoopModel
from hil.plugins.protocols import JumpPlant

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class JumpStep:
    """What holds in a slot without a jump: |x(k+1) - F_i x(k) - G_i v| <= W_i (|x(k)|, |v|), entry by entry; v = u + w.

    Args:
        flows: [F_i G_i], (N, n, n + m).
        bands: W_i, (N, n, n + m); zero where the matrices are certain.
        seen: whether the mode that is measured is the true one; else any of them may be it.
        unseen: mean number of jumps in a slot whose two ends show the same mode.
        names: name and unit of every state.
    """

    flows: Array
    bands: Array
    seen: bool
    unseen: float
    names: tuple[tuple[str, str], ...]


def jump_step(plant: JumpPlant, model: LoopModel) -> JumpStep | None:
    r"""Return what the record of a plant that jumps fulfils; None for one with a delay inside, whose record does not show it.

    What is uncertain lies within +-D_A, +-D_B. With M(A) for A with the absolute values beside its diagonal, the deviation e of
    the motion from that of the mode is bounded by the flow of

    .. math::
        X' = (M(A) + D_A) X + (|B| + D_B) |v|, \quad E' = M(A) E + D_A X + D_B |v|, \quad X(0) = |x(k)|,\; E(0) = 0.

    Args:
        plant: what runs.
        model: of the loop, with its period.
    """
    from scipy.linalg import expm

    system, rates, T = plant.jump_system(), plant.jump_process(), model.period_s
    if system.Ad:
        return None
    A, B = np.array(system.A, dtype=float), np.array(system.B, dtype=float)
    N, n, m = B.shape
    DA, DB = np.zeros_like(A), np.zeros_like(B)
    for dA, dB in system.changes:
        DA, DB = np.maximum(DA, np.abs(np.array(dA, dtype=float))), np.maximum(DB, np.abs(np.array(dB, dtype=float)))
    flows, bands = np.zeros((N, n, n + m)), np.zeros((N, n, n + m))
    for i in range(N):
        flows[i] = expm(T * np.block([[A[i], B[i]], [np.zeros((m, n + m))]]))[:n]
        if DA[i].any() or DB[i].any():
            away = np.abs(A[i])
            np.fill_diagonal(away, np.diag(A[i]))
            whole = np.block([
                [away + DA[i], np.zeros((n, n)), np.abs(B[i]) + DB[i]], [DA[i], away, DB[i]], [np.zeros((m, 2 * n + m))],
            ])  # fmt: skip
            bands[i] = np.delete(expm(T * whole)[n : 2 * n], slice(n, 2 * n), axis=1)
    fastest = max((sum(rate for rate in row if rate > 0.0) for matrix in rates.rates.rates for row in matrix), default=0.0)
    return JumpStep(
        flows=flows, bands=bands, seen=not rates.detection,
        unseen=fastest * T if rates.detection else (fastest * T) ** 2,
        names=tuple((str(s.name), str(s.unit)) for s in plant.outputs[:n]),
    )  # fmt: skip
