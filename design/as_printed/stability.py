"""Corollary 2.1 as it is printed. NOT SOUND with sections; kept to be compared with.

Section m sees P_j in its own section m (jumps land in section 1), sections are not linked, and of the box of rates only "all low"
and "all high" are tested.

References: thesis (2.12)-(2.15); ERRATA 1 and 3.
"""

from __future__ import annotations

from functools import partial

from design.controllers.scheduled_gain import ScheduledGain
from design.lmi.decision import decide
from design.processes.partitions import Partition
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.sojourn_grid import Coupling, as_float
from design.semi_markov_loop.stability import CONDITION, checked_gain, known_gain, lyapunov_program
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
    condition: float = CONDITION,
) -> JumpCertificate:
    """What the printed conditions say of the loop u = K(i, h) x; a certificate with ``sound = False``, whatever it says.

    Args:
        nodes: sections per mode, by default those of the gains.
        decay: demanded decay rate of E|x|^2 (1/s).
        condition: largest condition number of P that is searched.

    Raises:
        ValueError: as ``analyse``.
    """
    gain = checked_gain(system, gain, process)
    sections = nodes if nodes is not None else tuple(tuple(row.tolist()) for row in gain.starts_s)
    rebuild = partial(known_gain, system, gain, process, sections, "pwc", decay, coupling=PRINTED)
    found = decide(lyapunov_program(rebuild(as_float), system.states, condition))
    return JumpCertificate(
        method="printed", sound=False, reason=f"printed Corollary 2.1, I <= P <= {condition:g} I: {found.explain()}",
        verdict="certified" if found.holds else "refused" if found.refused else "undecided", margin=found.margin,
        matrices=found.matrices, assumptions=(FALSE, "rates anywhere in their bounds on every cell"), gain=gain,
        rebuild=rebuild, solver=found.solver,
    )  # fmt: skip
