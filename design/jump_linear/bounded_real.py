"""H-infinity norm of a jump-linear system by coupled bounded-real equations, solved at their fold.

For gamma above the norm the equations

    P_i = A_i' E_i(P) A_i + C_i' C_i + G_i' V_i^-1 G_i,   G_i = B_i' E_i(P) A_i + D_i' C_i,
    V_i = gamma^2 I - B_i' E_i(P) B_i - D_i' D_i > 0

have a smallest solution P >= 0, for which the worst disturbance w = F_i x, F_i = V_i^-1 G_i, leaves the system
mean-square stable; this is (7.28) with equality. As gamma falls to the norm, this solution meets another one and both
vanish: a fold, where I - L of A_i + B_i F_i is singular. Value iteration crawls there (0.3406 for a norm of 0.3390),
and Newton's method at fixed gamma turns linear. The fold itself is a regular root of

    (Riccati residual, smallest singular direction of its Jacobian) = 0

in (P, gamma^2), which Newton finds in a few steps, and whose null vectors give the derivative of the norm at once.
The left null vector is the second moment of the state under the worst disturbance: where it is positive
semidefinite, one is its largest eigenvalue, and the fold is the norm.

Newton's method starts at the fold of a system nearby. Where that is too far, it starts at the fold that a solution at a
larger gamma predicts (`predict_fold`).

References: Theorem 7.4; Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria, 2000 (bordered fold).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.errors import NotStable
from design.jump_linear import MJLS
from design.jump_linear.second_moment import DENSE_LIMIT, Array, Bordered, Resolvent, expect, to_matrix, to_vector
from design.jump_linear.stability_proof import StabilityProof, is_positive

NEWTON_STEPS, FOLD_STEPS = 40, 14
TOLERANCE, ROUNDED = 1e-11, 1e-8
"""Relative Newton steps: one at which it ends, and one after which steps that no longer fall are rounding (radius near 1)."""
Matrices = tuple[Array, Array, Array, Array, Array]
"""A, B, C, D and the transition matrix."""


class Policy(NamedTuple):
    """A solution of the bounded-real equations at one gamma: P, worst disturbance F, closed-loop matrices, V."""

    P: Array
    F: Array
    A: Array
    C: Array
    V: Array


def solve_bounded_real(matrices: Matrices, square: float, extra: float = 0.0, near: Policy | None = None) -> Policy | None:
    """Smallest solution of the bounded-real equations at gamma^2 = `square`, or None if gamma is not above the norm.

    They are (7.28) with equality; the smallest gamma for which they have a solution is found by `hinf_norm`.

    Newton's method from w = 0, every step one coupled Lyapunov equation; its iterates rise to the solution.
    `extra` adds extra * I to C_i' C_i, which makes (7.28) strict at the result. `near` is a solution at a larger gamma:
    its disturbance leaves the loop stable here too, and Newton's method rises from there in fewer steps.
    """
    A, B, C, _, transition = matrices
    identity = extra * np.eye(A.shape[-1])
    policy: Policy | None = None
    moved = np.inf
    closed, output = A, C
    F = np.zeros((A.shape[0], B.shape[2], A.shape[1]))
    if near is not None:
        F, closed, output = near.F, near.A, near.C
    ones = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
    proof = StabilityProof(transition) if many(matrices) else None
    for _ in range(NEWTON_STEPS):
        weight = output.transpose(0, 2, 1) @ output - square * (F.transpose(0, 2, 1) @ F) + identity
        if proof is None:
            P, probe = Resolvent(closed, transition).cost(np.stack([weight, ones]))
            stable = is_positive(probe)
        else:
            stable = proof.holds(closed)
            last = policy or near
            P = Resolvent(closed, transition).cost(weight, near=last.P if last else None) if stable else weight
        if not stable or not np.isfinite(P).all():
            return None
        previous = policy
        policy = policy_at(matrices, P, square)
        if policy is None:
            return None
        if previous is not None:
            before, moved = moved, float(np.abs(P - previous.P).max() / (np.abs(P).max() + 1e-300))
            if moved <= TOLERANCE or (before <= ROUNDED and moved >= 0.5 * before):
                return policy
        F, closed, output = policy.F, policy.A, policy.C
    return None


def many(matrices: Matrices) -> bool:
    """Whether GMRES solves the equations: then every product counts, and each solve starts from another one's result."""
    modes, n, _ = matrices[0].shape
    return bool(modes > 1 and modes * n * (n + 1) // 2 > DENSE_LIMIT)


def policy_at(matrices: Matrices, P: Array, square: float) -> Policy | None:
    """The worst disturbance against the cost P at gamma^2, and the loop under it; None where V is not positive definite."""
    A, B, C, D, transition = matrices
    E = expect(transition, P)
    BE = B.transpose(0, 2, 1) @ E
    V = square * np.eye(B.shape[2]) - BE @ B - D.transpose(0, 2, 1) @ D
    if not is_positive(V):
        return None
    F = np.asarray(np.linalg.solve(V, BE @ A + D.transpose(0, 2, 1) @ C), dtype=np.float64)
    return Policy(P, F, A + B @ F, C + D @ F, V)


FOLD_TOLERANCE, COST_TOLERANCE = 1e-12, 1e-7
"""Relative Newton steps in gamma^2 and in P at which the fold is found."""
NEAR = 0.1
"""How far below gamma^2, as a share of it, a predicted fold may lie for Newton's method to be tried."""
FREE_STEPS = 3
"""Newton steps that may have any length. A later one that is not half as long as the one before says that no fold is near."""


class Fold(NamedTuple):
    """The fold: gamma^2, the solution there, and the null vectors (cost direction, worst-case second moment)."""

    square: float
    policy: Policy
    right: Array
    left: Array

    @property
    def norm(self) -> float:
        """The H-infinity norm."""
        return float(np.sqrt(self.square))

    @property
    def power(self) -> float:
        """The norm times sum_i tr F_i W_i F_i', W the worst-case moment: what the derivatives of the norm are divided by."""
        return self.norm * float(np.sum((self.policy.F @ self.left) * self.policy.F))

    def gradient_A(self, transition: Array) -> Array:
        """d norm / d A_i = E_i(P) (A_i + B_i F_i) W_i / power."""
        return np.asarray(expect(transition, self.policy.P) @ self.policy.A @ self.left / self.power)


def hinf_norm(system: MJLS) -> float:
    """H-infinity norm (7.27): the largest sqrt(E sum |z|^2 / E sum |w|^2) from any initial mode with x(0) = 0.

    The disturbance may depend on the past of state and mode.

    Raises:
        NotStable: the radius is not below 1.
    """
    radius = system.radius()
    if radius >= 1.0:
        raise NotStable(f"H-infinity norm: not mean-square stable, radius {radius:.6g}, expected < 1", value=radius)
    found = locate_norm(system.matrices)
    return found.norm if isinstance(found, Fold) else float(np.sqrt(found))


def locate_norm(matrices: Matrices, above: tuple[float, Policy] | None = None) -> Fold | float:
    """The fold of a mean-square stable system; only gamma^2 where the norm is reached without one (finite memory).

    Args:
        matrices: (A, B, C, D, transition).
        above: a gamma^2 above that of the norm, and the solution there.
    """
    A, B, C, D, transition = matrices
    identity = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
    C2 = C.transpose(0, 2, 1) @ C
    S = Resolvent(A, transition).cost(C2)
    gain = B.transpose(0, 2, 1) @ expect(transition, S) @ B + D.transpose(0, 2, 1) @ D
    low = float(np.linalg.eigvalsh(gain).max())  # an impulse is one disturbance
    if low <= 0.0:
        return 0.0
    high, policy = (low, None) if above is None else above
    while policy is None:
        high *= 4.0
        policy = solve_bounded_real(matrices, high)
    near = NEAR  # Newton is tried at ever closer folds, not at every one
    while high / low > 1.0 + 1e-12:
        middle = float(np.sqrt(low * high)) if high / low > 1.01 else 0.5 * (low + high)
        guess = predict_fold(matrices, high, policy)
        away = high / low - 1.0 if guess is None else 1.0 - guess.square / high
        if away < near:
            near = 0.1 * away
            fold = refine_fold(matrices, guess or Fold(high, policy, identity, identity))
            if fold is not None and low * (1 - 1e-9) <= fold.square <= high * (1 + 1e-9):
                return fold
            if guess is not None:
                middle = max(middle, 0.5 * (guess.square + high))
        attempt = solve_bounded_real(matrices, middle, near=policy)
        if attempt is None:
            low = middle
        else:
            high, policy = middle, attempt
    return high


def predict_fold(matrices: Matrices, square: float, policy: Policy) -> Fold | None:
    """Where the fold will be, from the solution at gamma^2 = `square` above it; None where that does not tell.

    Near the fold P = P* - Z sqrt(gamma^2 - gamma*^2). The first two derivatives of P by gamma^2, P' = L P' - F'F and
    P'' = L P'' + 2 F''V F' with V F' = B' E(P') (A + B F) - F, say how far away gamma*^2 is, and what P* and Z are.
    """
    B, transition = matrices[1], matrices[4]
    resolvent = Resolvent(policy.A, transition)
    first = -resolvent.cost(policy.F.transpose(0, 2, 1) @ policy.F)
    turn = np.linalg.solve(policy.V, B.transpose(0, 2, 1) @ expect(transition, first) @ policy.A - policy.F)
    second = 2.0 * resolvent.cost(turn.transpose(0, 2, 1) @ policy.V @ turn)
    fall, bend = (float(np.trace(family, axis1=1, axis2=2).sum()) for family in (first, second))
    if not 0.0 < -0.5 * fall < square * bend:
        return None
    away = -0.5 * fall / bend
    identity = np.broadcast_to(np.eye(policy.A.shape[-1]), policy.A.shape)
    return Fold(square - away, policy._replace(P=policy.P - 2.0 * away * first), -first, identity)


def refine_fold(matrices: Matrices, guess: Fold) -> Fold | None:
    """Newton's method on the fold equations from a guess; None unless it ends at the fold that is the norm."""
    A, B, _, _, transition = matrices
    n = A.shape[-1]
    P, square = guess.policy.P, guess.square
    right, left = _unit(to_vector(guess.right).ravel()), _unit(to_vector(guess.left).ravel())
    shape = (A.shape[0], n * (n + 1) // 2)
    moved = np.inf
    for step in range(FOLD_STEPS):
        policy = policy_at(matrices, P, square)
        if policy is None:
            return None
        E = expect(transition, P)
        residual = (
            policy.A.transpose(0, 2, 1) @ E @ policy.A
            + policy.C.transpose(0, 2, 1) @ policy.C
            - square * (policy.F.transpose(0, 2, 1) @ policy.F)
            - P
        )
        size = right.size
        bordered = Bordered(policy.A, transition, left, right)
        last = np.zeros(size + 1)
        last[size] = 1.0
        v, w = bordered.solve(last, near=right), bordered.solve(last, transposed=True, near=left)
        right_family, left_family = (to_matrix(x[:size].reshape(shape), n) for x in (v, w))
        singular = float(v[size])
        # how the singular direction changes with P and gamma^2: -w' (dJ) v
        Ev = expect(transition, right_family)
        H = B.transpose(0, 2, 1) @ Ev @ policy.A @ left_family
        VH = np.linalg.solve(policy.V, H)
        by_P = B @ VH @ policy.A.transpose(0, 2, 1)
        by_P = np.tensordot(transition, by_P + by_P.transpose(0, 2, 1), axes=(0, 0))
        by_square = 2.0 * float(np.sum(VH * policy.F))
        rhs = np.zeros((size + 1, 2))
        rhs[:size, 0] = -to_vector(residual).ravel()
        rhs[:size, 1] = to_vector(policy.F.transpose(0, 2, 1) @ policy.F).ravel()
        x = np.column_stack([bordered.solve(rhs[:, 0]), bordered.solve(rhs[:, 1])])
        if not (np.isfinite(x).all() and np.isfinite(v).all() and np.isfinite(w).all()):
            return None
        slope = -to_vector(by_P).ravel()
        system = np.array(
            [[x[size, 1], singular], [slope @ x[:size, 1] + by_square, slope @ v[:size]]],
        )
        right_side = np.array([-x[size, 0], -singular - slope @ x[:size, 0]])
        try:
            change, along = np.linalg.solve(system, right_side)
        except np.linalg.LinAlgError:
            return None
        dP = to_matrix((x[:size, 0] + change * x[:size, 1] + along * v[:size]).reshape(shape), n)
        if not np.isfinite(dP).all() or abs(change) > 0.9 * square:
            return None
        P, square = P + dP, square + float(change)
        right, left = _unit(v[:size]), _unit(w[:size])
        before, moved = moved, float(np.abs(dP).max() / np.abs(P).max())
        if abs(change) <= FOLD_TOLERANCE * square and moved <= COST_TOLERANCE:
            return _verified(matrices, P, square, right.reshape(shape), left.reshape(shape))
        if step >= FREE_STEPS and moved > max(0.5 * before, COST_TOLERANCE):
            return None
    return None


def _verified(matrices: Matrices, P: Array, square: float, right: Array, left: Array) -> Fold | None:
    """The fold if it is the norm: V > 0, P >= 0, and null vectors that are positive semidefinite."""
    policy = policy_at(matrices, P, square)
    if policy is None:
        return None
    n = P.shape[-1]
    families = []
    for vector in (right, left):
        family = to_matrix(vector, n)
        if np.trace(family, axis1=1, axis2=2).sum() < 0:
            family = -family
        if np.linalg.eigvalsh(family).min() < -1e-6 * np.abs(family).max():
            return None
        families.append(family)
    if np.linalg.eigvalsh(P).min() < -1e-8 * np.abs(P).max():
        return None
    return Fold(square, policy, families[0], families[1])


def bounded_real_margin(system: MJLS, gamma: float) -> float | None:
    """-largest eigenvalue of (7.28) at matrices P found for `gamma`, each block scaled to gamma^2; None if none exist.

    P solves the equations with a small multiple of I added to C'C, so that a positive margin is strict.
    """
    A, B, C, D, transition = matrices = system.matrices
    scale = float(np.abs(C.transpose(0, 2, 1) @ C).max())
    near: Policy | None = None
    if many(matrices):
        for factor in (1.1, 1.003, 1.0001):
            near = solve_bounded_real(matrices, factor * gamma**2, near=near) or near
    for extra in 10.0 ** np.arange(-5.0, -13.0, -1.0) * scale:
        policy = solve_bounded_real(matrices, gamma**2, extra, near=near)
        if policy is not None:
            break
    else:
        return None
    E = expect(transition, policy.P)
    full = np.concatenate([A, B], axis=2)
    output = np.concatenate([C, D], axis=2)
    inequality = full.transpose(0, 2, 1) @ E @ full + output.transpose(0, 2, 1) @ output
    n = A.shape[-1]
    inequality[:, :n, :n] -= policy.P
    inequality[:, n:, n:] -= gamma**2 * np.eye(B.shape[2])
    return -float(np.linalg.eigvalsh(inequality).max())


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))
