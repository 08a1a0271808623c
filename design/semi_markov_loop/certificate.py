"""What is known of a semi-Markov loop, with everything needed to check it again.

The verdict is never a solver's word. ``certified``: the eigenvalues of every inequality at the returned matrices are on the
right side. ``refused``: dual matrices prove (weak duality) that no solution of this form exists with entries up to
``reach``, or the exact second moments grow. ``undecided``: neither could be shown.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

import numpy as np

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError, Infeasible
from design.lmi import Attenuation, Lift, as_float
from design.lmi.program import Inequality, verify
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import FloatArray, JumpSystem

Method = Literal["exact", "pwl", "pwc", "printed"]
Verdict = Literal["certified", "refused", "undecided"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JumpCertificate:
    """The verdict on a closed loop and its proof.

    Args:
        method: exact, pwl, pwc or printed.
        verdict: certified, refused or undecided; reason: why, in one sentence.
        margin: -(largest eigenvalue) of the strict inequalities at the matrices, which are normalised to P >= I (or X >= I).
        decay_rate: E|x|^2 falls at least like e^(-decay_rate t) (1/s): a bound, exact where the rates are constant. Where the
            sojourn times vary much it may be half the true rate; of a refused loop it bounds the growth from above.
        gamma: L2 gain bound.
        spectral_radius: of the per-jump second-moment operator (``exact`` only).
        matrices: the solution by name.
        rebuild: the inequalities, in floats or in fractions (``design.lmi``).
        gain: the gains that were analysed.
        assumptions: what the verdict rests on.
        solver: who found the matrices.
        scale: factor on z in the inequalities, for conditioning; ``gamma`` is that of the z given.
    """

    method: Method
    verdict: Verdict
    reason: str
    margin: float | None = None
    decay_rate: float | None = None
    gamma: float | None = None
    spectral_radius: float | None = None
    gain: ScheduledGain | None = field(default=None, repr=False)
    assumptions: tuple[str, ...] = ()
    solver: str = ""
    scale: float = 1.0
    matrices: Mapping[str, FloatArray] = field(default_factory=dict, repr=False)
    rebuild: Callable[[Lift], list[Inequality]] | None = field(default=None, repr=False)

    @property
    def sound(self) -> bool:
        """Whether ``certified`` implies stability: of no printed form."""
        return self.method != "printed"

    @property
    def certified(self) -> bool:
        """Whether the verdict is ``certified``; believe it as stability only if ``sound``."""
        return self.verdict == "certified"

    def check(self) -> float:
        """Build every inequality anew, evaluate it at the matrices, return the margin; > 0 proves the claim in floats."""
        if self.rebuild is None:
            raise FieldError("certificate", f"method {self.method!r} has no inequalities to check")
        return min(verify(self.rebuild(as_float), self.matrices))

    def to_json(self) -> dict[str, object]:
        """The verdict and its numbers as a dictionary that ``json.dumps`` takes, without the matrices."""
        keep = ("method", "sound", "verdict", "reason", "margin", "decay_rate", "gamma", "spectral_radius", "solver")
        return {**{name: getattr(self, name) for name in keep}, "assumptions": list(self.assumptions)}


def attenuation_certificate(
    find: Callable[[], Attenuation],
    *,
    method: Method,
    gain: ScheduledGain | None = None,
    assumptions: tuple[str, ...],
    rebuild: Callable[..., list[Inequality]] | None = None,
) -> JumpCertificate:
    """What a search for an attenuation says: the matrices that it found, or why there are none.

    Args:
        find: raises Infeasible where nothing was found.
        method: ``printed`` is not sound.
        gain: the gains that were analysed.
        assumptions: what a certificate rests on.
        rebuild: (scale, gamma, lift) to the inequalities.
    """
    try:
        result = find()
    except Infeasible as error:
        verdict: Verdict = "refused" if error.proved else "undecided"
        return JumpCertificate(method=method, verdict=verdict, reason=str(error), gain=gain)
    found = result.found
    return JumpCertificate(
        method=method, verdict="certified", reason=found.explain(), margin=found.margin, gamma=result.gamma,
        gain=gain, assumptions=assumptions, matrices=found.matrices, scale=result.scale, solver=found.solver,
        rebuild=None if rebuild is None else partial(rebuild, result.scale, result.gamma),
    )  # fmt: skip


def check_stabilisable(system: JumpSystem, process: SemiMarkov) -> None:
    """Raise Infeasible, with the mode, the eigenvalue and the rate, where the nominal system cannot be stabilised.

    If mode i has an eigenvalue mu that the input cannot reach (uncontrollable) and 2 Re mu is at least the largest total rate out
    of the mode, then E|x|^2 has no finite value already within the first stay in that mode, whatever the gains.

    The test (Popov-Belevitch-Hautus, relative tolerance 1e-9) finds certain cases only; passing it promises nothing.
    """
    for i in range(system.modes):
        a, b = system.a[i], system.b[i]
        size = max(float(np.linalg.norm(a, 2)), float(np.linalg.norm(b, 2)), 1e-300)
        exit_rate = float(process.bounds(i, 0.0, np.inf)[1].sum())
        for mu in np.linalg.eigvals(a):
            pencil = np.hstack([a - mu * np.eye(a.shape[0]), b.astype(complex)])
            if 2.0 * mu.real >= exit_rate and np.linalg.svd(pencil, compute_uv=False)[-1] < 1e-9 * size:
                raise Infeasible(
                    f"mode {i}: the eigenvalue {mu.real:+.4g} is out of the input's reach and grows faster than the mode is left "
                    f"(total rate at most {exit_rate:.4g}/s); no gains can stabilise the loop",
                    value=float(mu.real),
                )
