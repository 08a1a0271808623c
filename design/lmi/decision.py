"""Where one solver leaves a doubt, another modeller and another solver are asked: cvxpy, and SCS behind it.

A doubt is: Clarabel's matrices prove nothing and its dual matrices exclude nothing; the margin at its matrices is as small as
what rounding changes; or the proof in fractions fails at them. Whatever answers, the answer is the matrices, put into the
inequalities here.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from design.lmi.exact import ExactProof, Rebuildable, as_fraction, prove, prove_inequalities, rounded
from design.lmi.program import LmiProgram, LmiSolution
from design.lmi.second_opinion import second_opinion

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
    matrices = {**found.matrices, **second.matrices}
    return replace(
        found, matrices=matrices, margin=second.margin, slack=second.slack, objective=-second.margin, solver="cvxpy",
        status=second.status,
    )  # fmt: skip


def prove_certificate(certificate: Rebuildable, bits: int = 24, *, verify_with: VerifyWith = "cvxpy") -> ExactProof:
    """Prove a certificate in fractions, at its own matrices, and where that fails at those of the second opinion.

    Args:
        certificate: what holds in floats.
        bits: rounding of the matrices, multiples of 2^-bits.
        verify_with: who is asked where the proof fails.

    Raises:
        ValueError: the certificate has no inequalities (method ``exact``).
    """
    proof = prove(certificate, bits)
    if proof.proved or verify_with == "nothing" or certificate.rebuild is None:
        return proof
    in_floats = certificate.rebuild(lambda value: np.asarray(value, dtype=float))
    second = second_opinion(in_floats, certificate.matrices, time_limit_s=TIME_LIMIT_S)
    if not second.holds:
        return proof
    known: dict[str, Any] = {name: rounded(value, bits) for name, value in second.matrices.items()}
    again = prove_inequalities(certificate.rebuild(as_fraction), known, bits)
    return replace(again, matrices_by="cvxpy") if again.proved else proof
