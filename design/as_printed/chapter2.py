"""Corollaries 2.1 and 2.2 as they are printed. NOT SOUND with sections; kept to be compared with.

Section m sees P_j, and X_j, in its own section m (jumps land in section 1), sections are not linked; of the box of rates only
"all low" and "all high" are tested, and the uncertainties of A and B have a multiplier each.

References: thesis (2.12)-(2.15), (2.18)-(2.21); ERRATA 1 to 3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import Infeasible
from design.lmi.decision import decide
from design.lmi.program import LmiSolution
from design.processes.partitions import Partition, equal_probability
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.robust_feedback import feedback_program, tabulate
from design.semi_markov_loop.sojourn_grid import Coupling
from design.semi_markov_loop.stability import CONDITION, checked_gain, stability_certificate
from design.semi_markov_loop.system import JumpSystem

PRINTED = Coupling(all_corners=False, lands_first=False, linked=False)
FALSE = "jumps from section m land in section m of the next mode and sections are not linked (false: they land in section 1)"


def printed_stability(
    system: JumpSystem,
    gain: ScheduledGain | None,
    process: SemiMarkov,
    *,
    nodes: Partition | None = None,
    decay: float = 0.0,
) -> JumpCertificate:
    """What the printed conditions say of the loop u = K(i, h) x; a certificate with ``sound = False``, whatever it says.

    Args:
        nodes: sections per mode, by default those of the gains.
        decay: demanded decay rate of E|x|^2 (1/s).

    Raises:
        ValueError: as ``analyse``.
    """
    gain = checked_gain(system, gain, process)
    sections = nodes if nodes is not None else tuple(tuple(row.tolist()) for row in gain.starts_s)
    form = f"printed Corollary 2.1, I <= P <= {CONDITION:g} I"
    found = stability_certificate(system, gain, process, sections, "pwc", decay, CONDITION, form, coupling=PRINTED)
    return replace(found, method="printed", sound=False, assumptions=(FALSE, *found.assumptions))


@dataclass(frozen=True, slots=True, kw_only=True)
class PrintedRequest:
    """Gains by the printed conditions, within a bound of their norm.

    Args:
        gain_bound: largest spectral norm of any gain.
        sections: number of equal-probability sections, or section starts per mode.
    """

    process: SemiMarkov
    gain_bound: float
    sections: int | Partition = 2

    @property
    def starts(self) -> Partition:
        """Section starts per mode."""
        return equal_probability(self.process, self.sections) if isinstance(self.sections, int) else self.sections

    def find(self, system: JumpSystem, decay: float, *, quick: bool = False) -> LmiSolution:
        """Solve (2.21). Raises Infeasible with the proof, or (``quick``: at once) with the best margin reached."""
        program = feedback_program(
            system, self.process, self.starts, "pwc", self.gain_bound, decay, CONDITION, PRINTED, multipliers=2
        )
        found = decide(program, verify_with="nothing" if quick else "cvxpy")
        if not found.holds:
            raise Infeasible(f"printed Corollary 2.2, gain norm <= {self.gain_bound:g}: {found.explain()}", value=found.margin)
        return found

    def judge(self, system: JumpSystem, found: LmiSolution, decay: float) -> JumpCertificate:
        """The gains and what the printed test says of them (``sound = False``); Infeasible where it does not accept them."""
        gain = tabulate(found, self.starts, "pwc", "hold", 1)
        gain = replace(gain, gain=gain.gain * min(1.0, self.gain_bound / gain.norm))
        certificate = printed_stability(system, gain, self.process, nodes=self.starts, decay=decay)
        if not certificate.certified:
            raise Infeasible(f"printed Corollary 2.2: gains found, but {certificate.reason}", value=certificate.margin)
        return certificate
