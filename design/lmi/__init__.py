"""Linear matrix inequalities: programs, and answers that can be trusted, up to their proof in exact fractions.

Where one solver leaves a doubt, another modeller and another solver are asked. A doubt is: Clarabel's matrices prove nothing and
its dual matrices exclude nothing; the margin at its matrices is as small as what rounding changes; or the proof in fractions
fails at them. cvxpy is asked then, and SCS behind it. Whatever answers, the answer is the matrices, put into the inequalities
here.

A certificate is proved without rounding. Its matrices are rounded to multiples of 2^-bits, gains, system and rates are taken as
the rational numbers that their floats are, every inequality is built anew in ``fractions.Fraction``, and the pivots of LDL' are
computed exactly in integers (Bareiss' fraction-free elimination). All pivots positive = positive definite. No solver and no float
is left in the proof.

Reference: Theorem 2.4; ERRATA 4.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt
from msgspec import Struct
from msgspec.structs import replace

from design.errors import FieldError, Infeasible, check_above_zero, solver
from design.lmi.program import Array, Inequality, LmiProgram, LmiSolution, verify

Lift = Callable[[npt.ArrayLike], Array]
"""Into floats or into fractions."""


class Rebuildable(Protocol):
    """A certificate that can build its inequalities anew, in floats or in fractions, at the matrices that it holds."""

    @property
    def method(self) -> str: ...

    @property
    def matrices(self) -> Mapping[str, npt.NDArray[np.float64]]: ...

    @property
    def rebuild(self) -> Callable[[Lift], list[Inequality]] | None: ...


class ExactProof(Struct, frozen=True, kw_only=True):
    """The outcome of an exact check.

    Args:
        proved: all inequalities hold.
        inequalities: how many were checked.
        failed: name of the first that does not hold.
        smallest_pivot: smallest pivot of LDL' over all of them.
        bits: rounding of the matrices, multiples of 2^-bits.
        matrices_by: whose matrices they are: the certificate's, or those of the second opinion.
    """

    proved: bool
    inequalities: int
    smallest_pivot: Fraction
    failed: str | None
    bits: int
    matrices_by: Literal["certificate", "cvxpy"] = "certificate"


def as_float(value: npt.ArrayLike) -> Array:
    """The lift that changes nothing: numbers stay floats."""
    return np.asarray(value, dtype=float)


def as_fraction(value: npt.ArrayLike) -> Array:
    """The lift into exact arithmetic: every float becomes the rational number that it is (and stays an array)."""
    return np.asarray(np.vectorize(Fraction, otypes=[object])(np.asarray(value, dtype=object)))


def rounded(value: npt.ArrayLike, bits: int) -> Array:
    """The nearest multiples of 2^-bits, as fractions; symmetric stays symmetric."""
    return as_fraction(np.ldexp(np.rint(np.ldexp(np.asarray(value, dtype=float), bits)), -bits))


def pivots(matrix: Array) -> list[Fraction]:
    """Pivots of LDL' of a symmetric matrix of fractions, up to and with the first that is not positive.

    >>> pivots(as_fraction([[2, 1], [1, 1]]))
    [Fraction(2, 1), Fraction(1, 2)]
    """
    rows = [[Fraction(entry) for entry in row] for row in matrix.tolist()]
    if any(rows[i][j] != rows[j][i] for i in range(len(rows)) for j in range(i)):
        raise FieldError("matrix", "is not symmetric")
    common = math.lcm(*(entry.denominator for row in rows for entry in row))
    work: list[list[int]] = [[int(entry * common) for entry in row] for row in rows]
    found: list[Fraction] = []
    previous = 1
    for k in range(len(work)):
        pivot = work[k][k]
        found.append(Fraction(pivot, previous * common))
        if pivot <= 0:
            break
        for i in range(k + 1, len(work)):
            for j in range(k + 1, len(work)):
                work[i][j] = (work[i][j] * pivot - work[i][k] * work[k][j]) // previous
        previous = pivot
    return found


def prove_inequalities(inequalities: Iterable[Inequality], matrices: Mapping[str, Array], bits: int) -> ExactProof:
    """Check F < 0 exactly for every inequality; a normalisation (not strict, e.g. I - P <= 0) is proved as F < I/2."""
    smallest: Fraction | None = None
    count = 0
    for item in inequalities:
        negative = -item.at(matrices)
        size = negative.shape[-1]
        if not item.strict:
            negative = negative + as_fraction(np.eye(size)) / 2
        worst = min(pivots(negative))
        smallest = worst if smallest is None else min(smallest, worst)
        count += 1
        if worst <= 0:
            return ExactProof(proved=False, inequalities=count, smallest_pivot=worst, failed=item.name, bits=bits)
    if smallest is None:
        raise FieldError("certificate", "holds no inequality")
    return ExactProof(proved=True, inequalities=count, smallest_pivot=smallest, failed=None, bits=bits)


def prove(certificate: Rebuildable, bits: int = 24) -> ExactProof:
    """Prove a certificate exactly, its matrices rounded to multiples of 2^-bits.

    Raises:
        ValueError: the certificate has no inequalities (method ``exact``).
    """
    if certificate.rebuild is None:
        raise FieldError("certificate", f"method {certificate.method!r} has no inequalities to prove")
    known: dict[str, Any] = {name: rounded(value, bits) for name, value in certificate.matrices.items()}
    return prove_inequalities(certificate.rebuild(as_fraction), known, bits)


TIME_LIMIT_S = 3.0
"""Of the second solver."""


def second_opinion(program: LmiProgram) -> LmiSolution:
    """Maximise the margin t <= 1 of F_i(X) <= -t I (strict) and F_i(X) <= 0 (the others), by cvxpy and SCS.

    The program's own route (`design.lmi.program`) writes triangles for Clarabel by hand. Here cvxpy gets semidefinite constraints
    and translates them itself. The answer is not cvxpy's word either: the matrices that it returns are put into the inequalities.

    Args:
        program: the inequalities and their unknowns.

    Returns:
        the matrices found, with the margin of the inequalities at them; of the dual matrices nothing is known.
    """
    cp = solver("cvxpy")
    x, t = cp.Variable(program.size), cp.Variable()
    constraints = [t <= 1.0]
    for item in program.inequalities:
        constant, linear, columns = program.coefficients(item)
        size = len(constant)
        left = constant + cp.reshape(linear.reshape(-1, size * size).T @ x[columns], (size, size), order="C")
        constraints.append(0.5 * (left + left.T) + (t if item.strict else 0.0) * np.eye(size) << 0)
    problem = cp.Problem(cp.Maximize(t), constraints)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # "may be inaccurate": the eigenvalues say how it is
            problem.solve(solver="SCS", eps=1e-7, max_iters=200_000, time_limit_secs=TIME_LIMIT_S)
        status = str(problem.status)
    except cp.error.SolverError as error:
        status = str(error).splitlines()[0]
    found = program.matrices(np.full(program.size, np.nan) if x.value is None else x.value)
    margin, slack = verify(program.inequalities, found)
    return LmiSolution(
        matrices=found, margin=margin, slack=slack, objective=-margin, excluded=0.0, reach=math.inf, solver="cvxpy", status=status
    )


VerifyWith = Literal["cvxpy", "nothing"]
NARROW = 1e-8
"""A margin below this may be rounding: the entries of the matrices are about 1, or up to 1e3."""


def decide(program: LmiProgram, *, verify_with: VerifyWith = "cvxpy") -> LmiSolution:
    """Maximise the margin with Clarabel, and ask cvxpy too where the answer is in doubt.

    Args:
        program: the inequalities.
        verify_with: who is asked in doubt.

    Returns:
        Clarabel's answer, or the second one where its matrices have the larger margin.
    """
    found = program.solve()
    doubt = not (found.refused or (found.holds and found.margin > NARROW))
    if not doubt or verify_with == "nothing":
        return found
    second = second_opinion(program)
    return second if second.holds and second.margin > found.margin else found


def program_of(certificate: Rebuildable) -> LmiProgram:
    """The inequalities of a certificate that has some, on matrices of the shapes that it holds; what is symmetric stays so."""
    program = LmiProgram(inequalities=[] if certificate.rebuild is None else certificate.rebuild(as_float))
    for name, value in certificate.matrices.items():
        if np.array_equal(value, value.T):
            program.symmetric(name, len(value))
        else:
            program.matrix(name, *value.shape)
    return program


def prove_certificate(certificate: Rebuildable) -> ExactProof:
    """Prove a certificate in fractions, at its own matrices, and where that fails at those of the second opinion.

    Args:
        certificate: what holds in floats.

    Raises:
        ValueError: the certificate has no inequalities (method ``exact``).
    """
    proof = prove(certificate)
    if proof.proved or certificate.rebuild is None:
        return proof
    second = second_opinion(program_of(certificate))
    if not second.holds:
        return proof
    known: dict[str, Any] = {name: rounded(value, proof.bits) for name, value in second.matrices.items()}
    again = prove_inequalities(certificate.rebuild(as_fraction), known, proof.bits)
    return replace(again, matrices_by="cvxpy") if again.proved else proof


BACKOFF = (1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3)
"""Relative distances from the solver's optimum at which a verified interior solution is sought, in this order."""


class Attenuation(Struct, frozen=True, kw_only=True):
    """A gamma whose inequalities were verified (None: of a SIQC): the matrices of ``found`` belong to z scaled by ``scale``."""

    gamma: float | None
    scale: float
    found: LmiSolution


def with_gamma(program: LmiProgram, scaled_gamma: float) -> LmiProgram:
    """The same program with "g2" known."""
    known = {"g2": np.array([[scaled_gamma**2]])}
    fixed = LmiProgram(reach=program.reach)
    for name, variable in program.variables.items():
        if name != "g2":
            fixed.add(name, variable.basis)
    fixed.inequalities = [item.fixing(known) for item in program.inequalities if item.on != ("g2",)]
    return fixed


def attenuation(build: Callable[[float], LmiProgram], what: str, gamma: float | None = None) -> Attenuation:
    """The smallest gamma that could be verified, or a solution at the given one; raises Infeasible as `smallest_gamma` does."""
    return smallest_gamma(build, what) if gamma is None else at_gamma(build, gamma, what)


def smallest_gamma(build: Callable[[float], LmiProgram], what: str) -> Attenuation:
    """Minimise gamma over ``build(scale)``, whose "g2" is (scale gamma)^2; ``what`` names the request in the error.

    A semidefinite solver's tolerance is absolute: with gamma^2 = 4e-4 it stops up to 2.6 times above the optimum and says
    "optimal". So z is scaled until scale gamma is about 1, gamma is then fixed slightly above the optimum, the margin of all
    strict inequalities is maximised, and the matrices found there are verified.

    Raises:
        Infeasible: nothing could be verified; the message says whether dual matrices prove that nothing is there.
    """
    scale, gamma = 1.0, math.inf
    for _ in range(6):
        objective = build(scale).solve("g2").objective
        if not math.isfinite(objective):
            break
        gamma = math.sqrt(max(objective, 1e-4)) / scale
        if 0.8 < scale * gamma < 1.25:
            break
        scale = 1.0 / gamma
    if math.isfinite(gamma):
        program = build(scale)
        for backoff in BACKOFF:
            trial = (1.0 + backoff) * gamma
            found = with_gamma(program, scale * trial).solve()
            if found.holds:
                return Attenuation(gamma=trial, scale=scale, found=found)
    return at_gamma(build, 100.0, what)


def at_gamma(build: Callable[[float], LmiProgram], gamma: float, what: str) -> Attenuation:
    """A verified solution at the given gamma. Raises Infeasible as ``smallest_gamma`` does."""
    check_above_zero(gamma=gamma)
    found = decide(with_gamma(build(1.0 / gamma), 1.0))
    if not found.holds:
        raise Infeasible(f"{what} at gamma = {gamma:g}: {found.explain()}", value=found.margin, proved=found.refused)
    return Attenuation(gamma=gamma, scale=1.0 / gamma, found=found)
