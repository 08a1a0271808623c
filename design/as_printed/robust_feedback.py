"""Corollary 2.2 as it is printed. NOT SOUND with sections; kept to be compared with.

X_j stands in its own section, sections are not linked, the uncertainties of A and B have a multiplier each.

References: thesis (2.18)-(2.21); ERRATA 1 and 2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from design.as_printed.stability import PRINTED, printed_stability
from design.errors import Infeasible
from design.lmi.decision import decide
from design.lmi.program import LmiSolution
from design.processes.partitions import Partition, equal_probability
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.robust_feedback import CONDITION, feedback_program, tabulate
from design.semi_markov_loop.system import JumpSystem


@dataclass(frozen=True, slots=True, kw_only=True)
class PrintedRequest:
    """Gains by the printed conditions, within a bound of their norm.

    Args:
        gain_bound: largest spectral norm of any gain.
        sections: number of equal-probability sections, or section starts per mode.
        condition: largest condition number of X that is searched.
    """

    process: SemiMarkov
    gain_bound: float
    sections: int | Partition = 2
    condition: float = CONDITION

    @property
    def starts(self) -> Partition:
        """Section starts per mode."""
        return equal_probability(self.process, self.sections) if isinstance(self.sections, int) else self.sections

    def find(self, system: JumpSystem, decay: float, *, quick: bool = False) -> LmiSolution:
        """Solve (2.21). Raises Infeasible with the proof, or (``quick``: at once) with the best margin reached."""
        program = feedback_program(
            system, self.process, self.starts, "pwc", self.gain_bound, decay, self.condition, PRINTED, multipliers=2
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
