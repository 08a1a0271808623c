"""What a coupler needs for a delay that varies in any way from sample to sample, without waiting for the largest.

Let a_j = u(j - d_j) be the force that is felt in slot j, and w_j the movement that the wall sees in slot k(j). Samples come in
their order, so that each movement is seen once, and k(j) - j - 1 is a whole number from the least to the largest tau: where tau
falls, several movements come at once. Coupler and wall see sum u(k(j)) w_j. If the coupler takes the squares below,

    sum u(k(j)) w_j <= -(1/4 beta) sum (u(k(j)) - a_j)^2,   then   sum a_j w_j <= beta sum w_j^2

by completing the square: what the motor gives, damping takes. Which pair (tau, d) it is in which slot is not known; the sum of
the squares of all pairs is an upper bound, and asks of the coupler

    (z - 1)/(T z) C(z) - sum_N (1 - z^-N)/(2 beta)   positive real,   N = tau + d + 1 over all pairs.

It is sufficient alone. Whether a coupler below it is safe under every change of delay is not decided: the exact question, over
all sequences of pairs, is one of a switched system over every passive hand. Waiting for the largest delay at both ends asks for
the largest N alone and is never softer: min of C(1) is N_max T/(2 beta) there and the sum of all N here.

Reference: Theorem 6.1 with random delays, 6.6; ERRATA 22.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from design.processes.delay_chain import DelayChain


def lags(sc: Iterable[int], ca: Iterable[int]) -> tuple[int, ...]:
    """Return the total delays whose F_N add up, each as often as a pair has it.

    Args:
        sc: delays tau of the position, in samples; they rise by at most one a slot.
        ca: delays d of the force, in samples, in any order.

    >>> lags([1, 2], [1])
    (2, 3)
    """
    taus, forces = sorted(set(sc)), sorted(set(ca))
    return tuple(sorted(tau + d for tau in range(taus[0], taus[-1] + 1) for d in forces))


def keeps_order(sc: DelayChain | int) -> bool:
    """Return whether no sample is seen after a newer one: the delay rises by at most one a slot.

    Args:
        sc: delay of the position.
    """
    if isinstance(sc, int):
        return True
    rise = sc.delay[None, :] - sc.delay[:, None]
    return bool((rise[np.asarray(sc.matrix) > 0.0] <= 1).all())
