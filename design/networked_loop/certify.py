"""The certificate of gains over a network: the loop (7.14) is built, and judged as any jump-linear system."""

from __future__ import annotations

import numpy.typing as npt

from design.controllers import Selection
from design.jump_linear.certificate import Certificate, certify_system
from design.networked_loop.closed_loop import LoopStructure, loop_structure
from design.processes.delay_chain import DelayChain


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
        output, samples, integral: as in `design.networked_loop.closed_loop.loop_structure`.
        initial: distribution of the mode at the impulse; default: uniform over plain chains, else stationary, see
            `design.networked_loop.initial_law`.
        hinf: compute the H-infinity norm too (some 10 ms more).

    Returns:
        The certificate; a loop that is not stable gives one with ``stable = False``.

    Raises:
        ValueError: wrong shapes; the message starts with the argument at fault.
    """
    from threadpoolctl import threadpool_limits

    structure = loop_structure(
        A, B, C, Lambda, Pi, selection, Q=Q, R=R, output=output, samples=samples, integral=integral  # type: ignore[arg-type]
    )  # fmt: skip
    with threadpool_limits(1, user_api="blas"):  # of matrices this small, threads only wait for each other
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
