"""Linear matrix inequalities: programs, and their proof in exact fractions.

A certificate is proved without rounding. Its matrices are rounded to multiples of 2^-bits, gains, system and rates are taken as
the rational numbers that their floats are, every inequality is built anew in ``fractions.Fraction``, and the pivots of LDL' are
computed exactly in integers (Bareiss' fraction-free elimination). All pivots positive = positive definite. No solver and no float
is left in the proof.

Reference: Theorem 2.4; ERRATA 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from design.errors import FieldError
from design.lmi.program import Array, Inequality

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


@dataclass(frozen=True, slots=True, kw_only=True)
class ExactProof:
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
