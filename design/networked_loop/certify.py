"""What gains reach over a network, and what no gains can: the certificate of a loop, and lower bounds on its norms.

The loop (7.14) is built and judged as any jump-linear system. The distance of a design from the best possible is at most that
from the lower bounds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.controllers import Selection
from design.jump_linear.certificate import Certificate, certify_system
from design.networked_loop.affine_loop import LoopStructure
from design.networked_loop.closed_loop import loop_structure
from design.processes.delay_chain import Array, DelayChain


def certify_loop(
    A: npt.ArrayLike,
    B: npt.ArrayLike,
    C: npt.ArrayLike,
    Lambda: DelayChain | npt.ArrayLike,
    Pi: DelayChain | npt.ArrayLike,
    gains: npt.ArrayLike,
    selection: Selection | str = "generated",
    Q: npt.ArrayLike | None = None,
    R: npt.ArrayLike | None = None,
    *,
    output: str = "stacked",
    samples: int = 1,
    integral: float = 0.0,
    state_gains: npt.ArrayLike = (),
    initial: npt.ArrayLike | None = None,
    hinf: bool = False,
) -> Certificate:
    """Certify gains over a network: radius, norms and inequality margins of the loop (7.14).

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant.
        Lambda, Pi: S-C and C-A transition matrices or delay chains.
        gains: (tau labels, rows, m, p'), the convention u = u* + K[tau, row] (y - r).
        selection: how the row is chosen, see `design.networked_loop.closed_loop`.
        Q, R: weights of z; defaults C and the row 0.01 .. 0.01.
        output, samples, integral, state_gains: as in `design.networked_loop.closed_loop.loop_structure`.
        initial: distribution of the mode at the impulse; default: uniform over plain chains, else stationary, see
            `design.networked_loop`.
        hinf: compute the H-infinity norm too (some 10 ms more).

    Returns:
        The certificate; a loop that is not stable gives one with ``stable = False``.

    Raises:
        ValueError: wrong shapes; the message starts with the argument at fault.
    """
    from design.whole_process import one_blas_thread

    structure = loop_structure(
        A, B, C, Lambda, Pi, selection, Q=Q, R=R, output=output, samples=samples, integral=integral,  # type: ignore[arg-type]
        state_gains=state_gains,
    )  # fmt: skip
    with one_blas_thread():
        return certify_structure(structure, gains, output=output, initial=initial, hinf=hinf)


def certify_structure(
    structure: LoopStructure, gains: npt.ArrayLike, *, output: str, initial: npt.ArrayLike | None = None, hinf: bool = False
) -> Certificate:
    """Certify gains in a loop structure, see `certify_loop`."""
    return certify_system(
        structure.system(gains),
        selection=structure.selection,
        output=output,
        initial=structure.default_initial if initial is None else initial,
        initial_law=structure.initial_law if initial is None else "given",
        between=structure.between,
        stays=structure.stays,
        hinf=hinf,
    )


HORIZON = 5000


class LowerBounds(NamedTuple):
    """Lower bounds on the H2 and the H-infinity norm.

        full information     the state is known at once
        delayed information  the state is known when the delays (tau, d) let it be known

    They hold for any causal controller and every selection rule. They hold for the stacked z; for the sum Q x + R u1 no such
    bound holds, since the terms may cancel.
    """

    h2_full_information: float
    h2_delayed_information: float
    hinf_full_information: float
    hinf_delayed_information: float


def lower_bounds(
    A: Array,
    B: Array,
    Q: Array,
    sc: DelayChain,
    ca: DelayChain,
    initial: npt.ArrayLike | None = None,
    present: npt.ArrayLike | None = None,
) -> LowerBounds:
    """Lower bounds for plant (A, B), weight Q (l, n) of the state, and the two delay chains.

    A unit impulse w(0) enters in a random direction, and then nothing: x(1) = B w(0). A controller that is linear in what
    it knows applies u = 0 until a sample of time 1 or later has come to it and its packet to the actuator; from then on
    nothing is unknown, and no controller does better than the linear-quadratic one with the whole state and free input.
    Where several nodes measure, the youngest sample of any of them counts as the sample of all.

    The input weight R is left out, which lowers the bounds.

    Args:
        initial: (sc modes * ca modes,) distribution of the mode at the impulse, the same as the norm's; default uniform.
        present: (sc modes * ca modes,) whether the norm knows the mode; default all. The H-infinity norm starts in these.

    The H-infinity norm is at least the square root of the energy of one impulse, in its worst direction and mode.
    """
    weight = Q.T @ Q
    cheap = _cheap_regulator(A, B, weight)
    modes = sc.modes * ca.modes
    alpha = np.full(modes, 1.0 / modes) if initial is None else np.asarray(initial, dtype=np.float64)
    known = np.ones(modes, dtype=bool) if present is None else np.asarray(present, dtype=bool)
    full = B.T @ cheap @ B
    delayed = []
    for mode in range(modes):
        energy, x = np.zeros((B.shape[1], B.shape[1])), B
        informed_before = 0.0
        for informed in informed_probability(sc, ca, mode):
            energy += (informed - informed_before) * x.T @ cheap @ x + (1.0 - informed) * x.T @ weight @ x
            informed_before, x = informed, A @ x
        delayed.append(energy)
    mean = float(sum(a * np.trace(e) for a, e in zip(alpha, delayed, strict=True)))
    return LowerBounds(
        h2_full_information=float(np.sqrt(np.trace(full))),
        h2_delayed_information=float(np.sqrt(mean)),
        hinf_full_information=float(np.sqrt(np.linalg.eigvalsh(full)[-1])),
        hinf_delayed_information=float(np.sqrt(max(np.linalg.eigvalsh(e)[-1] for e, here in zip(delayed, known) if here))),
    )


def informed_probability(sc: DelayChain, ca: DelayChain, mode: int) -> list[float]:
    """Probability that the actuator at k = 1, 2, .. knows of an impulse at k = 0; ends with 1.

    Args:
        mode: index (tau mode) * (d modes) + (d mode) at k = 0.
    """
    newest = sc.delay if sc.ages is None else np.min(sc.ages, axis=1)
    last = 1 + sc.max_delay + ca.max_delay
    # weight of each (slot at which the controller came to know, or 0; tau mode; d mode)
    weights = np.zeros((last + 1, sc.modes, ca.modes))
    weights[0, mode // ca.modes, mode % ca.modes] = 1.0
    slots = np.arange(last + 1)[:, None]
    done, probabilities = 0.0, []
    for k in range(1, last + 1):
        weights = sc.matrix.T @ weights @ ca.matrix
        receives = k - newest >= 1
        weights[k, receives], weights[0, receives] = weights[0, receives], 0.0
        acts = (slots >= 1) & (k - ca.delay >= slots)
        done += float(weights.sum(axis=1)[acts].sum())
        weights = np.where(acts[:, None, :], 0.0, weights)
        probabilities.append(min(done, 1.0))
    probabilities[-1] = 1.0
    return probabilities


def _cheap_regulator(A: Array, B: Array, weight: Array) -> Array:
    """Cost to go of the regulator without input weight; every iterate is a lower bound, so stopping early is sound."""
    S = weight
    for _ in range(HORIZON):
        gain = np.linalg.pinv(B.T @ S @ B, rcond=1e-12, hermitian=True) @ B.T @ S @ A
        closed = A - B @ gain
        following = weight + closed.T @ S @ closed
        following = 0.5 * (following + following.T)
        if np.abs(following - S).max() <= 1e-13 * np.abs(following).max():
            return following
        S = following
    return S
