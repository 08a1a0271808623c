"""What is known of a closed loop, computed from its gains and from nothing else.

A solver's word is not used: the matrices of every inequality are found again for the given gains, and the inequality's
eigenvalues are computed at these matrices.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from design.controllers import Selection
from design.jump_linear.mjls import MJLS
from design.jump_linear.second_moment import Array, Resolvent, backward, expect
from design.networked_loop.closed_loop import loop_structure
from design.processes.delay_chain import DelayChain


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """Stability and norms of one closed loop, with the eigenvalues of the inequalities that prove them.

    Args:
        mean_square_radius: spectral radius of the second-moment operator; stable if and only if < 1 (Theorem 7.1).
        stable: the radius is below 1 and (7.17), made strict, holds at the matrices found, beyond rounding.
        h2_norm: H2 norm (7.20), z per unit impulse; None if not stable.
        hinf_norm: H-infinity norm (7.27); None if not asked for or not stable.
        lyapunov_margin: -largest eigenvalue of (7.17) at P found with right-hand side I; > 0 proves stability.
        positivity_margin: smallest eigenvalue of these P.
        rounding: bound on the rounding error of the two margins. All three are None if the radius is not below 1.
        h2_residual: largest absolute eigenvalue of (7.21)'s residual, relative to the largest of S.
        hinf_margin: -largest eigenvalue of (7.28) at gamma (1 + 1e-6), relative; > 0 proves the norm.
        modes: number of modes; order: number of states.
        selection: information pattern; output: "stacked" or "sum" z.
    """

    mean_square_radius: float
    stable: bool
    h2_norm: float | None
    hinf_norm: float | None
    lyapunov_margin: float | None
    positivity_margin: float | None
    rounding: float | None
    h2_residual: float | None
    hinf_margin: float | None
    modes: int
    order: int
    selection: str
    output: str

    def to_json(self) -> dict[str, object]:
        """Return the fields as a dictionary that `json.dumps` takes."""
        return asdict(self)


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
        initial: distribution of the mode at the impulse; default uniform.
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
        return certify_system(structure.system(gains), selection=selection, output=output, initial=initial, hinf=hinf)


def certify_system(
    system: MJLS, *, selection: str = "", output: str = "", initial: npt.ArrayLike | None = None, hinf: bool = False
) -> Certificate:
    """Certify any jump-linear system, see `certify_loop`."""
    A, B, C, D, transition = system.matrices
    alpha = system.alpha(initial)
    radius = system.radius()
    h2 = residual = norm = hinf_margin = lyapunov = positivity = rounding = None
    stable = False
    if radius < 1.0:
        identity = np.broadcast_to(np.eye(system.order), A.shape)
        weight = C.transpose(0, 2, 1) @ C
        P, S = Resolvent(A, transition).cost(np.stack([identity, weight]))
        lyapunov = -_largest(backward(A, transition, P) - P)
        positivity = -_largest(-P)
        scale = float(np.abs(P).max() * max(1.0, float((np.abs(A).sum(axis=2) ** 2).max())))
        rounding = 4.0 * system.order * system.modes * float(np.finfo(float).eps) * scale
        energy = B.transpose(0, 2, 1) @ expect(transition, S) @ B + D.transpose(0, 2, 1) @ D
        h2 = float(np.sqrt(max(0.0, float(np.einsum("i,ijj->", alpha, energy)))))
        gap = backward(A, transition, S) + weight - S
        residual = float(np.abs(np.linalg.eigvalsh(gap)).max() / max(float(np.abs(S).max()), 1e-300))
        stable = lyapunov > rounding and positivity > rounding
    if hinf and stable:
        from design.jump_linear.bounded_real import bounded_real_margin, hinf_norm

        norm = hinf_norm(system)
        hinf_margin = bounded_real_margin(system, norm * (1.0 + 1e-6))
    return Certificate(
        mean_square_radius=radius, stable=stable, h2_norm=h2 if stable else None, hinf_norm=norm,
        lyapunov_margin=lyapunov, positivity_margin=positivity, rounding=rounding,
        h2_residual=residual, hinf_margin=hinf_margin, modes=system.modes, order=system.order, selection=selection,
        output=output,
    )  # fmt: skip


def _largest(family: Array) -> float:
    symmetric = 0.5 * (family + family.transpose(0, 2, 1))
    return float(np.linalg.eigvalsh(symmetric).max())
