"""The second-moment operator of a jump-linear system, on symmetric matrices, dense or matrix-free.

For modes i with matrices A_i and transition matrix P the operator and its adjoint are

    (L S)_i  = A_i' (sum_j p_ij S_j) A_i              (cost to go, "backward")
    (L* X)_j = sum_i p_ij A_i X_i A_i'                (covariance, "forward")

A family of N symmetric n x n matrices is written as N orthonormal coordinate vectors (off-diagonal entries times
sqrt 2), so that the forward operator is the transpose of the backward one, and n (n+1)/2 numbers do for n^2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from design.jump_linear.coupled_lyapunov import basis_of, factors_of, mean, solve_bordered, solve_coupled, transposed_factors
from design.jump_linear.long_computations import spectral_radius
from design.jump_linear.stability_proof import is_sparse, positive_radius, side_of_one, solve_sparse, sparse_operator

Array = npt.NDArray[np.float64]

DENSE_LIMIT = 700  # unknowns up to which a dense factorisation is quicker than GMRES
SINGLE_LIMIT = 100  # the same for a system of one mode
EIG_DENSE_LIMIT = 260  # unknowns up to which all eigenvalues are computed at once
EIG_DENSE_AFTER = 3500  # unknowns up to which they are where ARPACK does not find the largest: some 15 s
ARPACK_RESTARTS = 60  # a spectrum that is not found by then is crowded: no number of restarts that pays finds it
ARPACK_NUMBERS, ARPACK_LEAST = 3_000_000, 5  # unknowns times restarts, at most; with fewer restarts none is begun
CLUSTER_LIMIT = 20_000  # unknowns up to which four eigenvalues are found, in case several lie on the spectral circle


def to_vector(matrices: Array) -> Array:
    """Coordinates (..., n (n+1)/2) of symmetric matrices (..., n, n); an isometry of the Frobenius norm."""
    basis = basis_of(matrices.shape[-1])
    return np.asarray(matrices.reshape(*matrices.shape[:-2], -1).take(basis.places, axis=-1) * basis.scale)


def to_matrix(vectors: Array, n: int) -> Array:
    """Symmetric matrices (..., n, n) of their coordinates (..., n (n+1)/2)."""
    basis = basis_of(n)
    return (vectors / basis.scale).take(basis.origins, axis=-1).reshape(*vectors.shape[:-1], n, n)


def expect(transition: Array, family: Array) -> Array:
    """Conditional expectation E_i(S) = sum_j p_ij S_j, for a family (N, ...)."""
    return np.asarray(np.tensordot(transition, family, axes=(1, 0)))


def backward(A: Array, transition: Array, family: Array) -> Array:
    """(L S)_i = A_i' E_i(S) A_i."""
    return np.asarray(A.transpose(0, 2, 1) @ expect(transition, family) @ A)


def forward(A: Array, transition: Array, family: Array) -> Array:
    """(L* X)_j = sum_i p_ij A_i X_i A_i'."""
    return np.asarray(np.tensordot(transition, A @ family @ A.transpose(0, 2, 1), axes=(0, 0)))


def congruence_matrices(A: Array) -> Array:
    """(N, s, s) matrices of S -> A_i' S A_i in coordinates, s = n (n+1)/2."""
    rows, columns, _, half, *_ = basis_of(A.shape[-1])
    left, right = A[:, :, rows], A[:, :, columns]
    product = left[:, rows] * right[:, columns]
    product += left[:, columns] * right[:, rows]
    product *= half.T
    return np.asarray(product.transpose(0, 2, 1))


def operator_matrix(A: Array, transition: Array) -> Array:
    """(N s, N s) matrix of the backward operator, in Fortran order; its transpose is the forward operator."""
    turned = congruence_matrices(A).transpose(2, 0, 1)
    size, modes, _ = turned.shape
    columns = np.empty((modes, size, modes, size))  # a column is contiguous, as LAPACK takes it
    np.multiply(transition.T[:, None, :, None], turned, out=columns)
    return columns.reshape(modes * size, modes * size).T


def _factorised(matrix: Array) -> tuple[Array, npt.NDArray[Any]]:
    """LU factors of a matrix in Fortran order, which they overwrite; where it is singular, what they solve is not finite."""
    from scipy.linalg.lapack import dgetrf  # 0.15 s: where a process only certifies a small loop, it is not needed

    factors, pivots, _ = dgetrf(matrix, overwrite_a=1)
    return factors, pivots


def _solved(factors: tuple[Array, npt.NDArray[Any]], right: Array, transpose: int) -> Array:
    """Solution for right-hand sides (k,) or (k, m), by LAPACK itself: scipy's wrapper takes as long as one solution."""
    from scipy.linalg.lapack import dgetrs

    return np.asarray(dgetrs(*factors, right, trans=transpose)[0])


class Resolvent:
    """(I - L)^-1 and its adjoint, factored once for several right-hand sides.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) row-stochastic matrix.

    The factorisation is dense up to `DENSE_LIMIT` unknowns. Above that one mode takes a Lyapunov equation, in n^3; several take
    GMRES, matrix-free.
    """

    __slots__ = ("A", "chains", "factors", "n", "transition")

    def __init__(self, A: Array, transition: Array) -> None:
        self.A, self.transition, self.n = A, transition, A.shape[-1]
        self.chains = (transition, transition)
        self.factors: tuple[Array, npt.NDArray[Any]] | None = None
        size = A.shape[0] * self.n * (self.n + 1) // 2
        if size <= (SINGLE_LIMIT if A.shape[0] == 1 else DENSE_LIMIT):
            matrix = operator_matrix(A, transition)
            np.negative(matrix, out=matrix)
            matrix.flat[:: size + 1] += 1.0
            self.factors = _factorised(matrix)
        else:
            self.chains = factors_of(transition)

    def cost(self, families: Array, *, near: Array | None = None) -> Array:
        """S with S - L S = Q for Q (N, n, n), or for several at once (k, N, n, n); `near` is a guess, of use to GMRES alone."""
        return self._solve(families, 0, near)

    def covariance(self, families: Array) -> Array:
        """X with X - L* X = V for V (N, n, n), or for several at once (k, N, n, n)."""
        return self._solve(families, 1)

    def _solve(self, families: Array, transpose: Literal[0, 1], near: Array | None = None) -> Array:
        if self.factors is None:
            flat = families.reshape(-1, *self.A.shape)
            return np.stack([self._free(family, transpose, near) for family in flat]).reshape(families.shape)
        vectors = to_vector(families)
        flat = vectors.reshape(-1, vectors.shape[-2] * vectors.shape[-1])
        solution = _solved(self.factors, flat.T, transpose).T
        return to_matrix(np.ascontiguousarray(solution).reshape(vectors.shape), self.n)

    def _free(self, right: Array, transpose: int, near: Array | None) -> Array:
        """Matrix-free; not a number throughout where the radius is so near 1 that no solution was found."""
        A = self.A
        if len(A) == 1:
            import scipy.linalg

            one = A[0] if transpose else A[0].T
            return np.asarray(scipy.linalg.solve_discrete_lyapunov(one, right[0], method="bilinear"))[None]
        if transpose:
            found = solve_coupled(A, transposed_factors(self.chains), right)
        else:
            turned = np.ascontiguousarray(A.transpose(0, 2, 1))
            guess = None if near is None else mean(self.chains, near)
            expected = solve_coupled(turned, self.chains, mean(self.chains, right), near=guess)
            found = None if expected is None else turned @ expected @ A + right
        return np.full_like(right, np.nan) if found is None else found


def cost_once(A: Array, transition: Array, families: Array) -> Array:
    """S with S - L S = Q, as `Resolvent.cost`, where nothing else is solved with this operator: small ones need numpy alone.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) row-stochastic matrix.
        families: Q, (N, n, n), or several at once, (k, N, n, n).
    """
    size = A.shape[0] * A.shape[-1] * (A.shape[-1] + 1) // 2
    if size > EIG_DENSE_LIMIT and len(A) > 1 and is_sparse(transition, A.shape[-1]):
        vectors = to_vector(families)
        found = solve_sparse(sparse_operator(congruence_matrices(A), transition), vectors.reshape(-1, size).T)
        return to_matrix(np.ascontiguousarray(found.T).reshape(vectors.shape), A.shape[-1])
    if size > EIG_DENSE_LIMIT:
        return Resolvent(A, transition).cost(families)
    vectors = to_vector(families)
    flat = vectors.reshape(-1, size)
    solution = np.linalg.solve(np.eye(size) - operator_matrix(A, transition), flat.T).T
    return to_matrix(np.ascontiguousarray(solution).reshape(vectors.shape), A.shape[-1])


def like_units(A: Array) -> Array | None:
    """Return for every state a unit in which its row and its column in sum_i |A_i| are alike, (n,); None where they are already.

    What is lost in rounding in one unit may be seen in another; x is in these units A_i with rows divided and columns multiplied.
    """
    from scipy.linalg import matrix_balance

    unit = np.asarray(matrix_balance(np.abs(A).sum(axis=0), permute=False, separate=True)[1][0])
    return None if (unit == 1.0).all() else unit


class Bordered:
    """The matrix [[L - I, left], [right', 0]], which is regular where L has the eigenvalue 1 once.

    Args:
        A, transition: as of `Resolvent`.
        left, right: (N s,) borders.
    """

    __slots__ = ("A", "chains", "factors", "left", "n", "right", "transition")

    def __init__(self, A: Array, transition: Array, left: Array, right: Array) -> None:
        self.A, self.transition, self.left, self.right, self.n = A, transition, left, right, A.shape[-1]
        self.chains = (transition, transition)
        self.factors: tuple[Array, npt.NDArray[Any]] | None = None
        size = right.size
        if size <= DENSE_LIMIT:
            matrix = np.zeros((size + 1, size + 1), order="F")
            matrix[:size, :size] = operator_matrix(A, transition)
            matrix.flat[: size * (size + 1) : size + 2] -= 1.0
            matrix[:size, size], matrix[size, :size] = left, right
            self.factors = _factorised(matrix)
        else:
            self.chains = factors_of(transition)

    def solve(self, rhs: Array, *, transposed: bool = False, near: Array | None = None) -> Array:
        """Return the solution (N s + 1,); not a number throughout where none was found.

        Args:
            rhs: (N s + 1,).
            transposed: solve with the transposed matrix.
            near: (N s,) a guess of all but the last entry, of use to GMRES alone.
        """
        if self.factors is not None:
            return _solved(self.factors, rhs, int(transposed))
        shape = (len(self.A), self.n * (self.n + 1) // 2)
        left, right, inner = (to_matrix(v.reshape(shape), self.n) for v in (self.left, self.right, rhs[:-1]))
        guess = None if near is None else to_matrix(near.reshape(shape), self.n)
        A, last = self.A, float(rhs[-1])
        turned = np.ascontiguousarray(A.transpose(0, 2, 1))
        if transposed:
            found = solve_bordered(A, transposed_factors(self.chains), (-inner, right), left, (last, 0.0), near=guess)
        else:
            chains, constant = self.chains, (last + float(np.vdot(right, inner)), -float(np.vdot(right, left)))
            found = solve_bordered(
                turned, chains, (mean(chains, -inner), mean(chains, left)), A @ right @ turned, constant,
                near=None if guess is None else mean(chains, guess),
            )  # fmt: skip
            if found is not None:
                found = turned @ found[0] @ A + found[1] * left - inner, found[1]
        return np.full_like(rhs, np.nan) if found is None else np.append(to_vector(found[0]).ravel(), found[1])


def restarts_for(size: int) -> int:
    """Return how often ARPACK may restart over so many unknowns; 0 where too seldom to be begun.

    >>> [restarts_for(size) for size in (1000, 400_000, 1_000_000)]
    [60, 7, 0]
    """
    allowed = min(ARPACK_RESTARTS, ARPACK_NUMBERS // size)
    return allowed if allowed >= ARPACK_LEAST else 0


def mean_square_radius(A: Array, transition: Array, *, bounded: bool = True) -> float:
    """Spectral radius of the second-moment operator; the system is mean-square stable if and only if it is < 1.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) row-stochastic matrix.
        bounded: where no eigenvalue is found, return a bound on the radius's own side of 1.

    Small systems take every eigenvalue; one large mode takes the squares of those of A. Where few transitions are
    possible, see `design.jump_linear.stability_proof`. Other large systems take ARPACK, matrix-free, started at the identity:
    the operator maps positive semidefinite families to such, so its radius is an eigenvalue with such a family. Where ARPACK
    does not converge, or would take too long, all eigenvalues are computed as far as the size allows. Beyond, none is found: nan,
    or the bound of `design.jump_linear.stability_proof`, which is nan where its budget ends. Stability is decided by (7.17), not
    by this number: `design.jump_linear.certificate`.
    """
    size = A.shape[0] * A.shape[-1] * (A.shape[-1] + 1) // 2
    if len(A) == 1 and size > SINGLE_LIMIT:
        return float(transition[0, 0] * np.abs(np.linalg.eigvals(A[0])).max() ** 2)
    if size <= EIG_DENSE_LIMIT:
        return float(np.abs(np.linalg.eigvals(operator_matrix(A, transition))).max())
    if is_sparse(transition, A.shape[-1]):
        operator = sparse_operator(congruence_matrices(A), transition)
        unit = to_vector(np.broadcast_to(np.eye(A.shape[-1]), A.shape)).ravel()
        return positive_radius(operator, unit, lambda x: to_matrix(x.reshape(len(A), -1), A.shape[-1]))
    shape, chains = (A.shape[0], size // A.shape[0]), factors_of(transition)
    turned = np.ascontiguousarray(A.transpose(0, 2, 1))

    def product(vector: Array) -> Array:
        return to_vector(turned @ to_matrix(mean(chains, vector.reshape(shape)), A.shape[-1]) @ A).ravel()

    start = to_vector(np.broadcast_to(np.eye(A.shape[-1]), A.shape)).ravel()
    found = largest_by_arpack(product, start, restarts_for(size), 4 if size < CLUSTER_LIMIT else 1, 40)
    if found is not None:
        return found
    if size <= EIG_DENSE_AFTER:
        return spectral_radius(operator_matrix(A, transition))
    return side_of_one(A, transition).bound if bounded else float("nan")


def largest_by_arpack(product: Callable[[Array], Array], start: Array, restarts: int, wanted: int, basis: int) -> float | None:
    """Return the largest absolute eigenvalue of a linear map; None where ARPACK does not find it, or may not restart.

    Args:
        product: of the map and a vector (size,).
        start: (size,).
        restarts: at most.
        wanted: eigenvalues, in case several lie on the spectral circle.
        basis: vectors that are kept.
    """
    from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs

    operator = LinearOperator((start.size, start.size), matvec=product, dtype=np.float64)
    try:
        if restarts:
            values: npt.NDArray[Any] = eigs(
                operator, k=wanted, v0=start, ncv=basis, return_eigenvectors=False, tol=1e-12, maxiter=restarts
            )
            return float(np.abs(values).max())
    except ArpackNoConvergence:  # what has converged may not be the largest: its number is not taken
        pass
    return None
