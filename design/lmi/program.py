"""Linear matrix inequalities without a modelling layer: write F(X, Y, ...) once, let it be probed, solved and verified.

An inequality is a plain function of matrices that is affine in them and must be negative definite at the solution. The
same function is evaluated

- on a basis of all its variables at once (a leading batch axis) to read off its coefficients,
- on the returned matrices, whose eigenvalues are the verdict (never the solver's status),
- on matrices of ``fractions.Fraction`` for an exact proof (``design.lmi``).

A verdict "infeasible" needs the solver's dual matrices to prove a bound (`excluded`). Where that leaves a doubt, `design.lmi`
asks for a second opinion.

Clarabel solves min q'x with b - A x in a product of positive semidefinite triangles: upper ones, column by column, off-diagonals
times sqrt(2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from msgspec import Struct, field
from scipy import sparse

from design.errors import FieldError, solver

FloatArray = npt.NDArray[np.float64]
Array = npt.NDArray[Any]
Function = Callable[..., Array]

LARGEST_GAIN: Final = 1e9
"""Its square stands in an inequality beside 1, and the solver has 16 digits."""


def transpose(matrix: Array) -> Array:
    """The transpose of the last two axes, under any batch axes."""
    return np.swapaxes(matrix, -1, -2)


def symmetric_part(matrix: Array) -> Array:
    """M + M', under any batch axes."""
    return matrix + transpose(matrix)


def symmetric_blocks(rows: Sequence[Sequence[Array | None]]) -> Array:
    """The symmetric matrix with the given lower block triangle; ``None`` is a zero block."""
    sizes = [row[-1].shape[-1] for row in rows]  # type: ignore[union-attr]
    batch = np.broadcast_shapes(*(b.shape[:-2] for row in rows for b in row if b is not None))
    kind = np.result_type(*(b for row in rows for b in row if b is not None))
    edges = np.concatenate([[0], np.cumsum(sizes)])
    out = np.zeros((*batch, edges[-1], edges[-1]), dtype=kind)
    if kind == np.object_:
        out += 0  # integer zeros, not floats: exact arithmetic goes through here
    for r, row in enumerate(rows):
        for c, block in enumerate(row):
            if block is not None:
                out[..., edges[r] : edges[r + 1], edges[c] : edges[c + 1]] = block
                if r != c:
                    out[..., edges[c] : edges[c + 1], edges[r] : edges[r + 1]] = transpose(block)
    return out


def add_schur_rows(rows: list[list[Array | None]], tops: Iterable[Array], corners: Iterable[Array]) -> None:
    """Add sum_k T_k' Y_k^-1 T_k to the first block of ``rows`` (see `symmetric_blocks`) by a new row [T_k, 0, -Y_k] for each."""
    for top, corner in zip(tops, corners):
        rows.append([top, *([None] * (len(rows) - 1)), -corner])


def check_gain_bound(bound: float) -> None:
    """Refuse everything but a norm above 0 that a solver in double precision can keep gains below.

    Raises:
        FieldError: of the field ``gain_bound``.
    """
    if not 0.0 < bound <= LARGEST_GAIN:
        raise FieldError("gain_bound", f"{bound!r}, expected a norm above 0, at most {LARGEST_GAIN:g}")


def gain_limit(x: Array, u: Array, s: Array | float = 1.0, *, bound: float) -> Array:
    """The matrix that is negative semidefinite only if the gain U X^-1 has at most the norm ``bound``, given X >= s I."""
    return -symmetric_blocks([[bound * bound * s * np.eye(u.shape[-2])], [transpose(u), x]])


def largest_eigenvalue(matrix: FloatArray) -> float:
    """The largest eigenvalue of the symmetric part of a matrix (or of a stack of them)."""
    return float(np.linalg.eigvalsh(0.5 * (matrix + transpose(matrix)))[..., -1].max())


class Variable(Struct, frozen=True, kw_only=True, eq=False):
    """A matrix of unknowns: ``basis`` has shape (unknowns, rows, columns), the first one is x[offset]."""

    basis: FloatArray
    offset: int

    def value(self, x: FloatArray) -> FloatArray:
        """The matrix at the solution vector x."""
        return np.tensordot(x[self.offset : self.offset + self.basis.shape[0]], self.basis, axes=1)


class Inequality(Struct, frozen=True, kw_only=True, eq=False):
    """function(*matrices) < 0, the matrices given by name; without ``strict``, <= 0 is enough.

    ``function`` accepts batch axes and is affine in the matrices that are unknown (all together).
    """

    name: str
    function: Function
    on: tuple[str, ...]
    strict: bool = True

    def at(self, matrices: Mapping[str, Array]) -> Array:
        """The left side at the given matrices."""
        return np.asarray(self.function(*(matrices[name] for name in self.on)))

    def fixing(self, known: Mapping[str, Array]) -> Inequality:
        """The inequality on the remaining names, with the known matrices put in."""
        rest = tuple(name for name in self.on if name not in known)

        def function(*matrices: Array) -> Array:
            given = dict(zip(rest, matrices))
            return self.function(*(known[name] if name in known else given[name] for name in self.on))

        return Inequality(name=self.name, function=function, on=rest, strict=self.strict)


class LmiSolution(Struct, frozen=True, kw_only=True, eq=False):
    """What came back: the matrices by name, the verified eigenvalues, what the dual matrices prove.

    Args:
        matrices: solution by variable name.
        margin: -(largest eigenvalue) over all strict inequalities at these matrices; slack: over the others.
        objective: value of the minimised scalar, or minus the margin that was maximised.
        excluded: where a margin was maximised, the dual matrices prove that no solution with entries up to this size has a
            positive one (0: they prove nothing).
        reach: the size up to which solutions count; by default 1e3, or ten times the largest entry returned.
        solver: who found it.
        status: what the solver said (for the reader only).
    """

    matrices: dict[str, FloatArray]
    margin: float
    slack: float
    objective: float
    excluded: float
    reach: float
    solver: Literal["clarabel", "cvxpy"]
    status: str

    @property
    def holds(self) -> bool:
        """Whether every strict inequality holds at the matrices, and the others to rounding."""
        return self.margin > 0 and self.slack > -1e-7

    @property
    def refused(self) -> bool:
        """Whether it is proved that there is no solution with entries up to ``reach``."""
        return not self.holds and self.excluded >= self.reach

    @property
    def verdict(self) -> Literal["certified", "refused", "undecided"]:
        """What is known of the inequalities."""
        return "certified" if self.holds else "refused" if self.refused else "undecided"

    def explain(self) -> str:
        """The verdict in words."""
        if self.holds:
            return f"every inequality holds at the returned matrices, margin {self.margin:.3g}"
        if self.refused:
            return f"dual matrices prove that no solution with entries up to {self.excluded:.2g} exists"
        part = f"; dual matrices exclude entries up to {self.excluded:.2g} only" if self.excluded > 1 else ""
        return f"none was found (best margin {self.margin:.3g}, {self.solver}: {self.status}){part}; absence is not proved"


def verify(inequalities: Iterable[Inequality], matrices: Mapping[str, FloatArray]) -> tuple[float, float]:
    """The margin -(largest eigenvalue) over the strict inequalities, and over the others; -inf if not all is finite."""
    if not all(np.isfinite(matrix).all() for matrix in matrices.values()):
        return -np.inf, -np.inf
    worst = {True: np.inf, False: np.inf}
    for item in inequalities:
        worst[item.strict] = min(worst[item.strict], -largest_eigenvalue(item.at(matrices)))
    return worst[True], worst[False]


class LmiProgram(Struct):
    """Collects variables and inequalities, then minimises a scalar or maximises the margin.

    ``reach``: a bound on every entry that the inequalities contain themselves, if they do; a verdict "infeasible" then
    needs a proof up to that size.

    >>> program = LmiProgram()
    >>> program.symmetric("P", 2)
    >>> a = np.array([[0.0, 1.0], [-1.0, -1.0]])
    >>> program.require("Lyapunov", lambda P: symmetric_part(P @ a), "P")
    >>> program.require("P > I", lambda P: np.eye(2) - P, "P")
    >>> program.require("P < 50 I", lambda P: P - 50 * np.eye(2), "P")
    >>> program.solve().margin > 0
    True
    """

    reach: float | None = None
    variables: dict[str, Variable] = field(default_factory=dict)
    inequalities: list[Inequality] = field(default_factory=list)
    size: int = 0

    def add(self, name: str, basis: FloatArray) -> None:
        """Add the unknown sum_k x_k basis[k]."""
        self.variables[name] = Variable(basis=basis, offset=self.size)
        self.size += basis.shape[0]

    def symmetric(self, name: str, n: int, *, least: float | None = None, most: float | None = None) -> None:
        """Add a symmetric n x n unknown, at least and at most so many times the unit matrix where that is given."""
        rows, cols = np.tril_indices(n)
        basis = np.zeros((rows.size, n, n))
        basis[np.arange(rows.size), rows, cols] = basis[np.arange(rows.size), cols, rows] = 1.0
        self.add(name, basis)
        if least is not None:
            self.require(f"{name} >= {least:g} I", lambda v: least * np.eye(n) - v, name, strict=False)
        if most is not None:
            self.require(f"{name} bounded", lambda v: v - most * np.eye(n), name, strict=False)

    def matrix(self, name: str, rows: int, columns: int) -> None:
        """Add a full rows x columns unknown."""
        self.add(name, np.eye(rows * columns).reshape(-1, rows, columns))

    def bounded_gain(self, x: str, u: str, inputs: int, bound: float) -> None:
        """Add the unknown U of a gain U X^-1 with a norm of at most ``bound``, X >= s I; "s" and X are there."""
        identity = np.eye(self.variables[x].basis.shape[-1])
        self.matrix(u, inputs, identity.shape[0])
        self.require(f"{x} >= s I", lambda v, s: s * identity - v, x, "s", strict=False)
        self.require(f"gain bound at {x}", partial(gain_limit, bound=bound), x, u, "s", strict=False)

    def require(self, name: str, function: Function, *on: str, strict: bool = True) -> None:
        """Demand function(*matrices) < 0."""
        self.inequalities.append(Inequality(name=name, function=function, on=on, strict=strict))

    def coefficients(self, item: Inequality) -> tuple[FloatArray, FloatArray, npt.NDArray[np.intp]]:
        """Constant part, coefficient matrices and their columns, by evaluating at 0 and at every basis matrix."""
        names = list(dict.fromkeys(item.on))
        total = sum(self.variables[name].basis.shape[0] for name in names)
        probes, columns, at = {}, [], 1
        for name in names:
            variable = self.variables[name]
            count = variable.basis.shape[0]
            probes[name] = np.zeros((total + 1, *variable.basis.shape[1:]))
            probes[name][at : at + count] = variable.basis
            columns.append(np.arange(variable.offset, variable.offset + count))
            at += count
        values = np.asarray(item.at(probes), dtype=float)
        return values[0], values[1:] - values[0], np.concatenate(columns)

    def _conic(self, margin: bool) -> tuple[sparse.csc_matrix, FloatArray, list[int]]:
        """A, b and the matrix sizes of: b - A x in a product of PSD triangles; the margin is the last unknown."""
        data, rows, cols, rhs, sizes, top = [], [], [], [], [], 0
        for item in self.inequalities:
            constant, linear, columns = self.coefficients(item)
            r, c, weight = triangle(constant.shape[0])
            block = linear[:, r, c] * weight
            hit = np.nonzero(block)
            data.append(block[hit])
            rows.append(top + hit[1])
            cols.append(columns[hit[0]])
            if margin and item.strict:
                diagonal = np.flatnonzero(r == c)
                data.append(np.ones(diagonal.size))
                rows.append(top + diagonal)
                cols.append(np.full(diagonal.size, self.size))
            rhs.append(-constant[r, c] * weight)
            sizes.append(constant.shape[0])
            top += r.size
        shape = (top, self.size + int(margin))
        entries = (np.concatenate(data), (np.concatenate(rows), np.concatenate(cols)))
        return sparse.csc_matrix(entries, shape=shape), np.concatenate(rhs), sizes

    def matrices(self, x: FloatArray) -> dict[str, FloatArray]:
        """The matrices at the solution vector x."""
        return {name: variable.value(x) for name, variable in self.variables.items()}

    def solve(self, minimise: str | None = None) -> LmiSolution:
        """Minimise the scalar (1 x 1) of that name, or maximise the margin t <= 1 of the strict ones."""
        a, b, sizes = self._conic(minimise is None)
        q = np.zeros(a.shape[1])
        q[-1 if minimise is None else self.variables[minimise].offset] = -1.0 if minimise is None else 1.0
        if minimise is None:  # t <= 1, as one more 1 x 1 block
            row = sparse.csc_matrix(([1.0], ([0], [self.size])), shape=(1, a.shape[1]))
            a, b, sizes = sparse.vstack([a, row], format="csc"), np.append(b, 1.0), [*sizes, 1]
        x, z, status = clarabel(q, a, b, sizes)
        matrices = self.matrices(x)
        margin, slack = verify(self.inequalities, matrices)
        largest = float(np.abs(x).max())
        return LmiSolution(
            matrices=matrices, margin=margin, slack=slack, objective=float(q @ x),
            excluded=excluded(q, a, b, sizes, z) if minimise is None else 0.0,
            reach=max(1e3, 10.0 * largest) if self.reach is None else self.reach, solver="clarabel", status=status,
        )  # fmt: skip


def triangle(size: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], FloatArray]:
    """Rows, columns and weights of the triangle of a symmetric matrix; the weights keep the inner product."""
    rows, cols = np.tril_indices(size)
    return cols, rows, np.where(rows == cols, 1.0, np.sqrt(2.0))


def excluded(q: FloatArray, a: sparse.csc_matrix, b: FloatArray, sizes: list[int], z: FloatArray) -> float:
    """Weak duality: for Z >= 0 and every admissible x, q'x >= (q + A'z)'x - b'z >= -|q + A'z|_1 max|x| - b'z.

    With q'x = -margin, no margin is positive while max|x| <= -b'z / |q + A'z|_1. Z is the solver's, projected on Z >= 0.
    """
    if not np.isfinite(z).all():
        return 0.0
    projected, top = np.empty_like(z), 0
    for size in sizes:
        r, c, weight = triangle(size)
        matrix = np.zeros((size, size))
        matrix[r, c] = matrix[c, r] = z[top : top + r.size] / weight
        values, vectors = np.linalg.eigh(matrix)
        matrix = (vectors * np.maximum(values, 0.0)) @ vectors.T
        projected[top : top + r.size] = matrix[r, c] * weight
        top += r.size
    return max(0.0, float(-(b @ projected) / max(np.abs(q + a.T @ projected).sum(), 1e-300)))


def clarabel(q: FloatArray, a: sparse.csc_matrix, b: FloatArray, sizes: list[int]) -> tuple[FloatArray, FloatArray, str]:
    """Interior point: x, z and what the solver says of them."""
    package = solver("clarabel")
    settings = package.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 2
    cones = [package.PSDTriangleConeT(size) for size in sizes]
    quadratic = sparse.csc_matrix((q.size, q.size))
    result = package.DefaultSolver(quadratic, q, a, b, cones, settings).solve()
    return np.array(result.x), np.array(result.z), str(result.status)
