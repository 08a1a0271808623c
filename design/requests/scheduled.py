r"""State feedback that is scheduled by a mode and by the time spent in it (Chapters 2 to 4), in the loop.

.. math:: u(k) = K(i, h)\, x(k - \tau_k)

The plant's measurement is the state followed by the mode (1, 2, ... as in the thesis): the true mode in Chapters 2 and 3,
the *detected* one in Chapter 4, where the fault itself is never seen. The controller measures the sojourn time h by its
own clock, from the slot in which the mode that it sees changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from design.controllers import LoopModel, Rows, RunningController, Selection
from design.controllers.scheduled_gain import ScheduledGain

if TYPE_CHECKING:
    from design.semi_markov_loop.certificate import JumpCertificate


@dataclass(frozen=True, slots=True, kw_only=True)
class Scheduled:
    """Gains over mode and sojourn time.

    Args:
        gain: nested tuple [mode][section][m][n]. Input unit per state unit.
        starts_s: nested tuple [mode][section]. Sojourn time at which each section begins (``hold``) or at which each node lies
            (``linear``), s; the first is 0.
        schedule: ``hold`` or ``linear``.
    """

    kind: ClassVar[str] = "scheduled"

    gain: tuple[tuple[tuple[tuple[float, ...], ...], ...], ...]
    starts_s: tuple[tuple[float, ...], ...]
    schedule: Literal["hold", "linear"] = "hold"

    def __post_init__(self) -> None:
        self._gain()

    def _gain(self) -> ScheduledGain:
        try:
            gain, starts = np.array(self.gain, dtype=float), np.array(self.starts_s, dtype=float)
        except ValueError:
            raise ValueError("gain: expected [mode][section][m][n] with equal lengths") from None
        return ScheduledGain(gain=gain, starts_s=starts, schedule=self.schedule)

    def start(self, model: LoopModel) -> RunningController:
        gain = self._gain()
        m, p = model.B.shape[1], model.C.shape[0]
        if gain.gain.shape[2:] != (m, p - 1):
            raise ValueError(
                f"gain: {gain.gain.shape[2]} x {gain.gain.shape[3]} matrices; the plant has {m} inputs and measures {p - 1} "
                "states and the mode"
            )
        return _ScheduledRows(gain, model.period_s)


class _ScheduledRows:
    selection: Selection = "constant"

    def __init__(self, gain: ScheduledGain, period_s: float) -> None:
        self._gain, self._period_s = gain, period_s
        self._mode, self._since = -1, 0

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        mode = min(max(round(y[-1]) - 1, 0), self._gain.modes - 1)
        if mode != self._mode:
            self._mode, self._since = mode, k - tau
        K = self._gain.at(mode, (k - self._since) * self._period_s)
        x = [a - b for a, b in zip(y[:-1], r[:-1])]
        return (tuple(float(sum(g * v for g, v in zip(row, x))) for row in K.tolist()),)


Example = Literal["ch2", "ch3", "ch4"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RobustScheduled:
    """Our gains for the examples of Chapters 2 to 4, solved when the experiment is composed, with their certificate.

    Args:
        example: ``ch2`` robust feedback, ``ch3`` H-infinity under time-varying delays, ``ch4`` fault-tolerant, seeing r only.
        gain_bound: largest spectral norm of any gain; without one the best gamma is 0 and the gains have no bound.
        decay: ``ch2`` only: demanded decay rate of E|x|^2, 1/s.
    """

    example: Example
    gain_bound: float = 5.0
    decay: float = 0.0

    def solve(self, model: LoopModel, sc: Any, ca: Any, folder: str) -> tuple[Scheduled, dict[str, Any]]:
        """Return the gains as the controller that runs, and the certificate that was computed from them."""
        from design.as_printed import examples as p

        certificate: JumpCertificate
        if self.example == "ch2":
            from design.semi_markov_loop.robust_feedback import robust_feedback

            system, process = p.chapter2_system("printed"), p.chapter2_process()
            certificate = robust_feedback(system, process, gain_bound=self.gain_bound, decay=self.decay)
        elif self.example == "ch3":
            from design.semi_markov_loop.delayed_hinf import delayed_hinf

            sections = ((0.0, p.CHAPTER3_BOUNDARY_S),) * 3
            certificate = delayed_hinf(
                p.chapter3_system(), p.chapter3_process(), gain_bound=self.gain_bound, sections=sections
            )
        else:
            from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback

            faults = p.chapter4_process(failure_restarts_detection_clock=False)
            certificate = fault_tolerant_feedback(p.chapter4_system(), faults, gain_bound=self.gain_bound)
        assert certificate.gain is not None
        return scheduled_of(certificate.gain), _stated(certificate)


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedScheduled:
    """The printed gains of Chapters 2 to 4, as an experiment can name them, with what can be certified of them.

    Args:
        gains: ``ch2`` (2.27), ``ch2-reference`` (those of [1, 2]), ``ch3``, ``ch4`` ((4.30), seen modes only) or
            ``ch4-partitioned`` (4.31).
    """

    gains: Literal["ch2", "ch2-reference", "ch3", "ch4", "ch4-partitioned"]

    def solve(self, model: LoopModel, sc: Any, ca: Any, folder: str) -> tuple[Scheduled, dict[str, Any]]:
        """Return the gains as the controller that runs, and the verdict on them; nothing is solved."""
        from design.as_printed import examples as p

        certificate: JumpCertificate
        if self.gains in ("ch2", "ch2-reference"):
            from design.semi_markov_loop.stability import analyse

            gain = p.chapter2_gain() if self.gains == "ch2" else p.chapter2_reference_gain()
            certificate = analyse(p.chapter2_system("printed"), gain, p.chapter2_process())
        elif self.gains == "ch3":
            from design.semi_markov_loop.delayed_hinf import analyse_delayed

            gain = p.chapter3_gain()
            certificate = analyse_delayed(p.chapter3_system(), gain, p.chapter3_process())
        else:
            from design.semi_markov_loop.fault_tolerant_analysis import analyse_fault_tolerant

            gain = p.chapter4_seen_gain(partitioned=self.gains == "ch4-partitioned")
            faults = p.chapter4_process(failure_restarts_detection_clock=False)
            certificate = analyse_fault_tolerant(p.chapter4_system(), gain, faults)
        return scheduled_of(gain), _stated(certificate)


def _stated(certificate: JumpCertificate) -> dict[str, Any]:
    """Return the certificate as JSON, saying of what it is one: the loop samples what the theory lets act at every instant."""
    stated: dict[str, Any] = dict(certificate.to_json())
    assumptions: list[str] = list(certificate.assumptions)
    stated["stable"] = certificate.certified and certificate.sound
    stated["assumptions"] = [*assumptions, "the feedback acts at every instant; the loop samples it at T"]
    return stated


def scheduled_of(gain: ScheduledGain) -> Scheduled:
    """Return the controller that runs a :class:`ScheduledGain`."""
    nested: Any = tuple(
        tuple(tuple(tuple(map(float, row)) for row in section) for section in mode) for mode in gain.gain.tolist()
    )
    return Scheduled(
        gain=nested, starts_s=tuple(tuple(map(float, row)) for row in gain.starts_s.tolist()), schedule=gain.schedule
    )
