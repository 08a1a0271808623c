"""The thesis as it stands, not sound: its examples, its printed conditions, and ERRATA.md. Nothing sound imports it.

Here are the examples and the printed gains of Chapters 2, 3 and 4, as data: they can be analysed, simulated and run. Modes are
counted from 0 here and from 1 in the thesis. Everything is a function, so that nothing is built at import.

References: thesis Sections 2.5, 3.4, 4.4; `ERRATA.md` says where the printed data contradict each other.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.processes.rates import PiecewiseLinearRate, clip_rate
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop import DelayedJumpSystem, FloatArray, JumpSystem, NormBounded, VertexUncertainty

CHAPTER2_BOUNDARY_S = 0.8326
"""Printed section boundary below (2.26): the median of the hazard 2h, not of the printed hazard h."""


def chapter2_system(uncertainty: Literal["printed", "matched", "vertices", "none"] = "vertices") -> JumpSystem:
    """The example (2.25).

    ``printed``: the norm-bounded F_A, F_B of (2.25), which do not give the printed A_1(t), A_2(t). ``matched``: the F_A, F_B that
    do, with delta = diag(sigma, rho). ``vertices``: the printed A_i(t), B_2(t) at sigma, rho = -1 and 1 (one parameter per mode).
    """
    a = np.array([[[1.1555, -0.4006], [-0.4470, -0.7930]], [[-0.0274, 0.0249], [-0.3835, 0.3026]]])
    b = np.array([[[1.0], [1.0]], [[1.0], [0.0]]])
    fb = np.array([[[0.0], [0.0]], [[0.0], [0.1]]])
    eye = np.stack([np.eye(2)] * 2)
    if uncertainty == "printed":
        fa = np.array([[[0.2, 0.1], [0.1, 0.0]], [[0.0, 0.0], [0.1, 0.0]]])
        return JumpSystem(a=a, b=b, uncertainty=NormBounded(e=eye, fa=fa, fb=fb))
    if uncertainty == "matched":
        # DEVIATION: (2.25) prints other F_A; these reproduce A_1(t) and A_2(t) as printed above (2.25).
        fa = np.array([[[0.0, 0.1], [0.0, 0.0]], [[0.0, 0.0], [0.0, 0.7]]])
        return JumpSystem(a=a, b=b, uncertainty=NormBounded(e=eye, fa=fa, fb=fb))
    if uncertainty == "none":
        return JumpSystem(a=a, b=b)
    da, db = np.zeros((2, 2, 2, 2)), np.zeros((2, 2, 2, 1))
    for vertex, sign in enumerate((-1.0, 1.0)):
        da[vertex, 0, 0, 1], da[vertex, 1, 1, 1], db[vertex, 1, 1, 0] = 0.1 * sign, 0.7 * sign, 0.1 * sign
    return JumpSystem(a=a, b=b, uncertainty=VertexUncertainty(da=da, db=db))


def chapter2_process() -> SemiMarkov:
    """Two modes, both rates the clipped ramp (2.26)."""
    ramp = clip_rate(0.1, 4.6)
    return SemiMarkov(rates=((None, ramp), (ramp, None)))


def chapter2_gain(boundary_s: float = CHAPTER2_BOUNDARY_S) -> ScheduledGain:
    """The printed gains (2.27), two sections per mode."""
    gain = [
        [[[-22.1292, 14.1944]], [[-11.0213, 7.1232]]],
        [[[-4.7141, 6.3067]], [[-4.0094, 3.3051]]],
    ]
    return ScheduledGain(gain=np.array(gain), starts_s=np.array([[0.0, boundary_s]] * 2))


def chapter2_reference_gain() -> ScheduledGain:
    """The gains by the methods of [1, 2] that Chapter 2 compares with."""
    return constant_gain([[[-3.7949, 2.2244]], [[-1.7292, 1.2225]]])


CHAPTER2_START = (5.0, -4.0)
"""Initial state of the example; initial mode 1 (0 here)."""

CHAPTER3_BOUNDARY_S = 1.8
CHAPTER3_START = (10.0, 6.0, 1.0, -7.0)
CHAPTER3_DELAY_MAX_S = 0.3
CHAPTER3_DELAY_SLOPES = (0.5, 0.6, 0.3)


def _vtol(a32: float, a34: float, b21: float) -> tuple[list[list[float]], list[list[float]]]:
    a = [
        [-0.0366, 0.0271, 0.0188, -0.4555],
        [0.0482, -1.01, 0.0024, -4.0208],
        [0.1002, a32, -0.707, a34],
        [0.0, 0.0, 1.0, 0.0],
    ]
    return a, [[0.4422, 0.1761], [b21, -7.5922], [-5.5200, 4.4900], [0.0, 0.0]]


def chapter3_system() -> DelayedJumpSystem:
    """The VTOL of Section 3.4 at 135, 60 and 170 knots (Table 3.1), A_d = 0.1 A, disturbance through B."""
    modes = [_vtol(0.3681, 1.4200, 3.5446), _vtol(0.0664, 0.1198, 0.9775), _vtol(0.5047, 2.5460, 5.1120)]
    a, b = np.array([m[0] for m in modes]), np.array([m[1] for m in modes])
    c = np.array([[[0.0, 0.1, 0.0, 0.0]]] * 3)
    return DelayedJumpSystem(
        a=a, ad=0.1 * a, b=b, e=b, c=c, delay_max_s=CHAPTER3_DELAY_MAX_S, delay_slopes=np.array(CHAPTER3_DELAY_SLOPES)
    )


def chapter3_rate_bounds() -> tuple[FloatArray, FloatArray]:
    """Lower and upper rates of both sections, each of shape (sections, modes, modes), zero diagonal (1/s)."""
    first = [[0.0, 0.1, 0.2], [0.2, 0.0, 0.3], [0.3, 0.3, 0.0]]
    middle = [[0.0, 0.5, 0.7], [0.7, 0.0, 1.0], [1.0, 1.1, 0.0]]
    last = [[0.0, 0.8, 1.2], [0.9, 0.0, 1.5], [1.8, 2.2, 0.0]]
    return np.array([first, middle]), np.array([middle, last])


def chapter3_process() -> SemiMarkov:
    """Rates that meet the printed bounds: linear over 0, 1.8 and 3.6 s, then constant (assumed; only bounds are printed)."""
    lower, upper = chapter3_rate_bounds()
    knots = np.stack([lower[0], upper[0], upper[1]])
    times = (0.0, CHAPTER3_BOUNDARY_S, 2 * CHAPTER3_BOUNDARY_S)
    rows = [
        tuple(None if i == j else PiecewiseLinearRate(times_s=times, values=tuple(knots[:, i, j].tolist())) for j in range(3))
        for i in range(3)
    ]
    return SemiMarkov(rates=tuple(rows))


def chapter3_gain() -> ScheduledGain:
    """The printed gains of Section 3.4, two sections per mode."""
    first = [
        [[-1.3653, -0.5117, 0.4511, 2.6099], [-0.4102, -0.0651, -0.0271, 0.2903]],
        [[-1.3254, -0.4512, 0.4183, 2.4012], [0.1892, 0.1996, -0.1840, -0.8173]],
        [[-1.2800, -0.4908, 0.5168, 2.6215], [-0.4687, -0.0820, 0.0778, 0.5266]],
    ]
    second = [
        [[-2.7621, -0.6190, 0.5728, 3.4891], [-0.8064, -0.0701, 0.0010, 0.4413]],
        [[-2.6281, -0.5833, 0.5576, 3.2410], [1.4161, 0.5205, -0.3996, -2.3219]],
        [[-2.9429, -0.6438, 0.6372, 3.6782], [-0.6803, 0.0019, 0.0156, 0.2481]],
    ]
    gain = np.stack([np.array(first), np.array(second)], axis=1)
    return ScheduledGain(gain=gain, starts_s=np.array([[0.0, CHAPTER3_BOUNDARY_S]] * 3))


CHAPTER4_START = (0.1, 1.0, -0.2, -0.5)
CHAPTER4_FAILURE_BOUNDARY_S = 1.0
CHAPTER4_DETECTION_BOUNDARY_S = 0.3


def chapter4_system() -> JumpSystem:
    """The VTOL of Section 4.4: mode 0 normal, mode 1 with half the effect of u_1 on the vertical velocity; y = x_2."""
    a, b1 = _vtol(0.3681, 1.4200, 3.5446)
    b2 = [row.copy() for row in b1]
    b2[1][0] = 1.7723
    e = np.array([[[0.0, 0.1], [0.1, 0.0], [0.0, 0.0], [0.0, 0.0]]] * 2)
    return JumpSystem(a=np.array([a, a]), b=np.array([b1, b2]), c=np.array([[[0.0, 1.0, 0.0, 0.0]]] * 2), e=e)


def chapter4_rate_knots() -> tuple[FloatArray, FloatArray]:
    """The rates (4.28) at the start of section 1, the boundary, and the end of section 2.

    Returns lambda of shape (3, 2, 2) and pi of shape (failure mode 2, 3, 2, 2), zero diagonals (1/s).
    """
    failure = [[[0.0, 0.333], [0.1, 0.0]], [[0.0, 0.5], [0.118, 0.0]], [[0.0, 1.0], [0.143, 0.0]]]
    normal = [[[0.0, 1.0], [1.429, 0.0]], [[0.0, 1.538], [2.128, 0.0]], [[0.0, 3.333], [4.167, 0.0]]]
    faulty = [[[0.0, 0.833], [2.0, 0.0]], [[0.0, 1.176], [2.857, 0.0]], [[0.0, 2.0], [5.0, 0.0]]]
    return np.array(failure), np.array([normal, faulty])


def _ramp_process(knots: FloatArray, times: tuple[float, ...]) -> SemiMarkov:
    up = PiecewiseLinearRate(times_s=times, values=tuple(knots[:, 0, 1].tolist()))
    down = PiecewiseLinearRate(times_s=times, values=tuple(knots[:, 1, 0].tolist()))
    return SemiMarkov(rates=((None, up), (down, None)))


def chapter4_process(*, failure_restarts_detection_clock: bool) -> FaultDetection:
    """Rates within (4.28): eta linear over 0, 1, 2 s and r over 0, 0.3, 0.6 s (an assumption; no times are printed)."""
    failure, detection = chapter4_rate_knots()
    eta_times = (0.0, CHAPTER4_FAILURE_BOUNDARY_S, 2 * CHAPTER4_FAILURE_BOUNDARY_S)
    r_times = (0.0, CHAPTER4_DETECTION_BOUNDARY_S, 2 * CHAPTER4_DETECTION_BOUNDARY_S)
    return FaultDetection(
        failure=_ramp_process(failure, eta_times),
        detection=(_ramp_process(detection[0], r_times), _ramp_process(detection[1], r_times)),
        failure_restarts_detection_clock=failure_restarts_detection_clock,
    )


def chapter4_gain() -> FloatArray:
    """The printed gains (4.30): K_ik of shape (failure mode i, detection mode k, 2, 4)."""
    return np.array(
        [
            [
                [[-29.0476, -21.4139, 1.0877, 15.8314], [-28.8441, -10.1142, 1.0381, 15.0394]],
                [[-4.6499, 8.6516, 0.0341, 2.3851], [2.3578, 6.0641, -0.1738, -1.8877]],
            ],
            [
                [[-12.0394, -2.4476, 0.2371, 6.6857], [-4.3991, 0.7927, 0.3011, 2.1268]],
                [[-11.3574, -2.6805, 0.2439, 6.3312], [-4.2524, 0.7151, 0.2960, 2.0400]],
            ],
        ]
    )


def chapter4_partitioned_gain() -> FloatArray:
    """The printed gains (4.31): K_ik,m of shape (failure mode i, detection mode k, section m, 2, 4)."""
    return np.array(
        [
            [
                [
                    [[-0.6338, 5.9167, 0.0186, 0.5508], [0.7768, 3.9104, -0.5256, -1.3280]],
                    [[7.2148, 26.4389, -3.2662, -6.9366], [11.3268, 14.2303, -4.6697, -11.1112]],
                ],
                [
                    [[-2.4914, -0.2779, 0.8977, 2.3757], [-1.5215, 0.8716, 0.5774, 0.9304]],
                    [[-0.5740, 6.4361, -0.0222, 0.4278], [1.2802, 4.2206, -0.6182, -1.7637]],
                ],
            ],
            [
                [
                    [[-2.9476, -4.8933, 1.0848, 3.0509], [-1.9784, -0.4680, 1.1723, 1.5120]],
                    [[-5.8887, -8.7909, 2.0822, 5.5006], [-4.7633, -1.4625, 2.1654, 4.0147]],
                ],
                [
                    [[-1.9209, 0.0587, 0.4517, 1.8868], [-0.6037, 0.9049, 0.2209, 0.0931]],
                    [[-3.3354, -2.6980, 0.9347, 3.0805], [-1.8901, 0.1669, 0.7811, 1.2869]],
                ],
            ],
        ]
    )


def chapter4_seen_gain(*, partitioned: bool) -> ScheduledGain:
    """The printed gains as a controller can use them that sees r only, as (4.2)-(4.3) prescribe: K_kk or K_kk,m.

    The LMIs of Chapter 4 give K_ik, and the fault i is not measured; K_kk believes the detection. With (4.30) this diverges.
    """
    if partitioned:
        both = chapter4_partitioned_gain()
        starts = np.array([[0.0, CHAPTER4_DETECTION_BOUNDARY_S]] * 2)
        return ScheduledGain(gain=np.stack([both[0, 0], both[1, 1]]), starts_s=starts, measured=("r",))
    single = chapter4_gain()
    return constant_gain(np.stack([single[0, 0], single[1, 1]]))
