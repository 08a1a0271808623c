"""Answers that can be trusted: where one solver leaves a doubt, another modeller and another solver are asked.

A doubt is: Clarabel's matrices prove nothing and its dual matrices exclude nothing; the margin at its matrices is as small as
what rounding changes; or the proof in fractions fails at them. cvxpy is asked then, and SCS behind it. Whatever answers, the
answer is the matrices, put into the inequalities here.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from design.errors import FieldError, Infeasible
from design.lmi.exact import ExactProof, Rebuildable, as_float, as_fraction, prove, prove_inequalities, rounded
from design.lmi.program import Inequality, LmiProgram, LmiSolution, verify
from design.solvers import solver

FloatArray = npt.NDArray[np.float64]


def second_opinion(
    inequalities: Sequence[Inequality],
    like: Mapping[str, FloatArray],
    *,
    bases: Mapping[str, FloatArray] | None = None,
    largest_margin: float = 1.0,
    time_limit_s: float = 20.0,
) -> LmiSolution:
    """Maximise the margin t <= largest_margin of F_i(X) <= -t I (strict) and F_i(X) <= 0 (the others), by cvxpy and SCS.

    The program's own route (`design.lmi.program`) writes triangles for Clarabel by hand. Here cvxpy gets matrix variables and
    semidefinite constraints, and translates them itself; the two share the functions of the inequalities and nothing else. The
    answer is not cvxpy's word either: the matrices that it returns are put into the inequalities.

    Args:
        inequalities: affine in the matrices that they name.
        like: name to a matrix of the shape sought; what is symmetric there is sought symmetric.
        bases: name to the matrices, (unknowns, rows, columns), whose combination is sought instead, where it has a pattern.
        largest_margin: bound on t.
        time_limit_s: of the solver, s.

    Returns:
        the matrices found, with the margin of the inequalities at them; of the dual matrices nothing is known.
    """
    cp = solver("cvxpy")
    names = sorted({name for item in inequalities for name in item.on})
    unknown = {name: _unknown(cp, like[name], None if bases is None else bases.get(name)) for name in names}
    t = cp.Variable()
    constraints = [t <= largest_margin]
    for item in inequalities:
        left = _affine(cp, item, unknown)
        size = left.shape[0]
        constraints.append(0.5 * (left + left.T) + (t if item.strict else 0.0) * np.eye(size) << 0)
    problem = cp.Problem(cp.Maximize(t), constraints)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # "may be inaccurate": the eigenvalues say how it is
            problem.solve(solver="SCS", eps=1e-7, max_iters=200_000, time_limit_secs=time_limit_s)
        status = str(problem.status)
    except cp.error.SolverError as error:
        status = str(error).splitlines()[0]
    found = {
        name: np.full(like[name].shape, np.nan) if variable.value is None else np.asarray(variable.value, dtype=np.float64)
        for name, variable in unknown.items()
    }
    margin, slack = verify(inequalities, found)
    return LmiSolution(
        matrices=found, margin=margin, slack=slack, objective=-margin, excluded=0.0, reach=math.inf, solver="cvxpy", status=status
    )


def _unknown(cp: Any, like: FloatArray, basis: FloatArray | None) -> Any:
    """A matrix variable, symmetric or full; where a basis has fewer unknowns than that, their combination."""
    symmetric = np.array_equal(like, like.T) if basis is None else np.array_equal(basis, basis.transpose(0, 2, 1))
    entries = like.shape[0] * (like.shape[0] + 1) // 2 if symmetric else like.size
    if basis is None or basis.shape[0] == entries:
        return cp.Variable(like.shape, symmetric=symmetric)
    combined = cp.reshape(basis.reshape(basis.shape[0], -1).T @ cp.Variable(basis.shape[0]), like.shape, order="C")
    return cp.symmetric_wrap(combined) if symmetric else combined


def _affine(cp: Any, item: Inequality, unknown: Mapping[str, Any]) -> Any:
    """Return F(X) as an expression of cvxpy: F(0) + sum over the entries of (F(E) - F(0)) x, E a single one in a matrix."""
    names = list(dict.fromkeys(item.on))
    shapes = [unknown[name].shape for name in names]
    counts = [rows * columns for rows, columns in shapes]
    total, at, probes = sum(counts), 1, {}
    for name, shape, count in zip(names, shapes, counts):
        # A symmetric unknown is probed by symmetric matrices: a function may read one triangle only.
        units = np.eye(count).reshape(count, *shape)
        if unknown[name].is_symmetric() and shape[0] > 1:
            units = 0.5 * (units + units.transpose(0, 2, 1))
        probes[name] = np.zeros((total + 1, *shape))
        probes[name][at : at + count] = units
        at += count
    values = np.asarray(item.at(probes), dtype=np.float64)
    constant, linear = values[0], values[1:] - values[0]
    size = constant.shape[-1]
    entries = cp.hstack([cp.vec(unknown[name], order="C") for name in names])
    return constant + cp.reshape(linear.reshape(total, size * size).T @ entries, (size, size), order="C")


VerifyWith = Literal["cvxpy", "nothing"]
NARROW = 1e-8
"""A margin below this may be rounding: the entries of the matrices are about 1, or up to 1e3."""
TIME_LIMIT_S = 3.0
"""Of the second solver, for a decision."""


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
    bases = {name: variable.basis for name, variable in program.variables.items()}
    second = second_opinion(program.inequalities, found.matrices, bases=bases, time_limit_s=TIME_LIMIT_S)
    if not (second.holds and second.margin > found.margin):
        return found
    return replace(second, matrices={**found.matrices, **second.matrices})


def prove_certificate(certificate: Rebuildable, *, verify_with: VerifyWith = "cvxpy") -> ExactProof:
    """Prove a certificate in fractions, at its own matrices, and where that fails at those of the second opinion.

    Args:
        certificate: what holds in floats.
        verify_with: who is asked where the proof fails.

    Raises:
        ValueError: the certificate has no inequalities (method ``exact``).
    """
    proof = prove(certificate)
    if proof.proved or verify_with == "nothing" or certificate.rebuild is None:
        return proof
    in_floats = certificate.rebuild(as_float)
    second = second_opinion(in_floats, certificate.matrices, time_limit_s=TIME_LIMIT_S)
    if not second.holds:
        return proof
    known: dict[str, Any] = {name: rounded(value, proof.bits) for name, value in second.matrices.items()}
    again = prove_inequalities(certificate.rebuild(as_fraction), known, proof.bits)
    return replace(again, matrices_by="cvxpy") if again.proved else proof


BACKOFF = (1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3)
"""Relative distances from the solver's optimum at which a verified interior solution is sought, in this order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attenuation:
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
    if not math.isfinite(gamma) or gamma <= 0:
        raise FieldError("gamma", f"{gamma!r} is not a finite positive number")
    found = decide(with_gamma(build(1.0 / gamma), 1.0))
    if not found.holds:
        raise Infeasible(f"{what} at gamma = {gamma:g}: {found.explain()}", value=found.margin, proved=found.refused)
    return Attenuation(gamma=gamma, scale=1.0 / gamma, found=found)
