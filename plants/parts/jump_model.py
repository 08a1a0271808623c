"""What a plant that jumps states: the matrices of its modes and the rates at which they change, as plain data."""

from __future__ import annotations

from dataclasses import dataclass

from plants.parts.exponential import Rows
from plants.parts.semi_markov import TransitionRates


@dataclass(frozen=True, slots=True, kw_only=True)
class JumpModel:
    """The matrices of a plant with N modes, mode by mode: what runs, with the parameters that the plant was given.

    x' = (A_i + dA_i) x + Ad_i x(t - tau_i(t)) + (B_i + dB_i) u + E_i w,  z = C_i x; the measurement is S_i x and the mode seen.

    Args:
        A: N matrices, n x n.
        B: N matrices, n x m.
        C: N matrices, p x n, of the performance output z; empty: none.
        E: N matrices, n x q, of the disturbance w; empty: none.
        Ad: N matrices, n x n, of the delayed state; empty: no delay inside.
        max_delay_s: largest tau_i in s.
        min_delay_s: smallest tau_i in s; 0: the plant may be without a delay, and is refused where its loop then is unstable.
        delay_slopes: N bounds of the growth of tau_i, in s per s.
        changes: V pairs (dA of every mode, dB of every mode); what is uncertain lies in their convex hull at every instant.
            Empty: nothing is uncertain.
        S: N matrices, n x n, of the sensors; empty: every sensor shows its state in every mode. The first n entries of the
            running plant's ``state`` then are x.

    Reference: thesis (2.16), (3.1), (4.1), Remark 4.1.
    """

    A: tuple[Rows, ...]
    B: tuple[Rows, ...]
    C: tuple[Rows, ...] = ()
    E: tuple[Rows, ...] = ()
    Ad: tuple[Rows, ...] = ()
    max_delay_s: float = 0.0
    min_delay_s: float = 0.0
    delay_slopes: tuple[float, ...] = ()
    changes: tuple[tuple[tuple[Rows, ...], tuple[Rows, ...]], ...] = ()
    S: tuple[Rows, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class JumpRates:
    """How the modes change, and what the measurement shows of them.

    Args:
        rates: transition rates of the true mode.
        detection: for every true mode the rates of the detected mode, which alone is measured; empty: the true mode is measured.
        failure_restarts_detection_clock: whether a jump of the true mode restarts the sojourn clock of the detected one.

    Reference: thesis (2.1), sec. 4.2.
    """

    rates: TransitionRates
    detection: tuple[TransitionRates, ...] = ()
    failure_restarts_detection_clock: bool = False
