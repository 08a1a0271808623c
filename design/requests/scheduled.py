r"""State feedback that is scheduled by a mode and by the time spent in it (Chapters 2 to 4), in the loop.

.. math:: u(k) = K(i, h)\, x(k - \tau_k)

The plant's measurement is the state followed by the mode (1, 2, ... as in the thesis): the true mode in Chapters 2 and 3,
the *detected* one in Chapter 4, where the fault itself is never seen. The controller measures the sojourn time h by its
own clock, from the slot in which the mode that it sees changed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from design.controllers import Gains, LoopModel, Rows, RunningController, Selection, nested
from design.controllers.exact_products import product
from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError, check_above_zero, check_at_least_zero
from design.requests.tracking import DesignTask

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from design.processes.partitions import Partition
    from design.processes.semi_markov import SemiMarkov
    from design.semi_markov_loop import JumpSystem
    from design.semi_markov_loop.fault_tolerant_analysis import Siqc


Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class QuadraticConstraint:
    """E int [y; w]' [g11 g12; g12' g22] [y; w] dt < 0 of the plant's output y and disturbance w, from x(0) = 0.

    Args:
        g11: positive definite, p x p.
        g12: p x q.
        g22: negative definite, q x q.

    Reference: thesis (4.6), Remark 4.4: I, 0 and -gamma^2 I are the H-infinity norm.
    """

    g11: Matrix
    g12: Matrix
    g22: Matrix

    def __post_init__(self) -> None:
        self.siqc()

    def siqc(self) -> Siqc:
        """Return it for the conditions of Chapter 4."""
        from design.semi_markov_loop.fault_tolerant_analysis import Siqc

        tables = {}
        for name in ("g11", "g12", "g22"):
            try:
                tables[name] = np.array(getattr(self, name), dtype=float)
            except ValueError:
                raise FieldError(name, "expected rows of equal lengths") from None
        return Siqc(**tables)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scheduled:
    """Gains over mode and sojourn time.

    Args:
        gain: nested tuple [mode][section][m][n]. Input unit per state unit.
        starts_s: nested tuple [mode][section]. Sojourn time at which each section begins (``hold``) or at which each node lies
            (``linear``), s; the first is 0.
        schedule: ``hold`` or ``linear``.
        constraint: what the loop shall meet beside stability (4.6), over a plant that shows the detected mode; the certificate
            says whether it does.
    """

    kind: ClassVar[str] = "scheduled"

    gain: Gains
    starts_s: tuple[tuple[float, ...], ...]
    schedule: Literal["hold", "linear"] = "hold"
    constraint: QuadraticConstraint | None = None

    def __post_init__(self) -> None:
        self.schedule_of_modes()

    def constraint_of_modes(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
        """Return the matrices of the constraint."""
        if self.constraint is None:
            return None
        found = self.constraint.siqc()
        return found.g11, found.g12, found.g22

    def schedule_of_modes(self) -> ScheduledGain:
        """Return K(mode, h)."""
        try:
            gain, starts = np.array(self.gain, dtype=float), np.array(self.starts_s, dtype=float)
        except ValueError:
            raise FieldError("gain", "expected [mode][section][m][n] with equal lengths") from None
        return ScheduledGain(gain=gain, starts_s=starts, schedule=self.schedule)

    def start(self, model: LoopModel) -> RunningController:
        gain = self.schedule_of_modes()
        m, p = model.B.shape[1], model.C.shape[0]
        if gain.gain.shape[2:] != (m, p - 1):
            raise FieldError(
                "gain",
                f"{gain.gain.shape[2]} x {gain.gain.shape[3]} matrices, expected {m} x {p - 1}: inputs of the plant, and what it "
                "measures beside the mode",
            )
        return _ScheduledRows(gain, model.period_s)


class _ScheduledRows:
    selection: Selection = "constant"

    def __init__(self, gain: ScheduledGain, period_s: float) -> None:
        self._at, self._last, self._period_s = gain.rows(), gain.modes - 1, period_s
        self._mode, self._since = -1, 0

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        mode = min(max(round(y[-1]) - 1, 0), self._last)
        if mode != self._mode:
            self._mode, self._since = mode, k - tau
        x = [a - b for a, b in zip(y[:-1], r[:-1])]
        return (tuple(product(self._at(mode, (k - self._since) * self._period_s), x)),)


Method = Literal["by-plant", "robust", "delayed-hinf", "fault-tolerant"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RobustScheduled:
    """Gains for a plant that jumps, solved for its own matrices and rates when the experiment is composed (Chapters 2 to 4).

    Args:
        method: ``robust`` (Chapter 2), ``delayed-hinf`` for a plant with a delay inside (Chapter 3), ``fault-tolerant`` for a
            plant that shows the detected mode only (Chapter 4), or ``by-plant``: the one that the plant calls for.
        gain_bound: largest spectral norm of any gain; without one the best gamma is 0 and the gains have no bound.
        decay: ``robust`` only: demanded decay rate of E|x|^2, 1/s.
        sections: into how many sections the sojourn axis of every mode is cut, with equal probability.
        starts_s: nested tuple [mode][section], s. The sections themselves, the first of every mode at 0, instead of ``sections``.
        constraint: ``fault-tolerant`` only: quadratic constraint (4.6) that the gains shall meet, instead of the least gamma.
    """

    method: Method = "by-plant"
    gain_bound: float = 5.0
    decay: float = 0.0
    sections: int = 0
    starts_s: tuple[tuple[float, ...], ...] = ()
    constraint: QuadraticConstraint | None = None

    def __post_init__(self) -> None:
        if self.constraint is not None and self.method not in ("by-plant", "fault-tolerant"):
            raise FieldError("constraint", f"the method {self.method!r} takes none, 'fault-tolerant' does")
        check_above_zero(gain_bound=self.gain_bound)
        check_at_least_zero(decay=self.decay)
        if self.sections < 0:
            raise FieldError("sections", f"{self.sections}, expected at least 1, or 0 for the default of the method")
        if self.sections and self.starts_s:
            raise FieldError("sections", "give either their number or their starts_s")

    def solve(self, task: DesignTask) -> Scheduled:
        """Return the gains as the controller that runs: from the cache, where this was solved before."""
        from design.tracking.gain_cache import cached_gain

        found = cached_gain((self, task.jump_system, task.jump_process), lambda: self._solved(task))
        return scheduled_of(found, self.constraint)

    def _solved(self, task: DesignTask) -> ScheduledGain:
        from design.processes.semi_markov import FaultDetection, SemiMarkov
        from design.semi_markov_loop import DelayedJumpSystem, JumpSystem

        system, process = task.jump_system, task.jump_process
        if system is None or process is None:
            raise FieldError("kind", "needs a plant that jumps (a JumpPlant: jump_system() and jump_process())")
        if isinstance(system, JumpSystem) and system.sensors is not None and isinstance(process, SemiMarkov):
            raise FieldError("kind", "no design covers sensors that fail in a mode that is seen; 'scheduled' takes gains")
        starts = self._starts(process.detection[0] if isinstance(process, FaultDetection) else process)
        bound, asked = self.gain_bound, self.method
        if self.constraint is not None and not isinstance(process, FaultDetection):
            raise FieldError("constraint", "is for a plant that shows the detected mode (Chapter 4)")
        if isinstance(system, JumpSystem) and isinstance(process, SemiMarkov) and asked in ("by-plant", "robust"):
            from design.semi_markov_loop.robust_feedback import FeedbackRequest

            found = FeedbackRequest(process=process, gain_bound=bound, sections=starts or 2).solve(system, self.decay)
        elif isinstance(system, DelayedJumpSystem) and isinstance(process, SemiMarkov) and asked in ("by-plant", "delayed-hinf"):
            from design.semi_markov_loop.delayed_hinf import delayed_hinf

            found = delayed_hinf(system, process, gain_bound=bound, sections=starts)
        elif isinstance(system, JumpSystem) and isinstance(process, FaultDetection) and asked in ("by-plant", "fault-tolerant"):
            from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback

            wanted = None if self.constraint is None else self._fitting(system)
            found = fault_tolerant_feedback(system, process, gain_bound=bound, sections=starts, performance=wanted)
        else:
            delay = "a delay" if isinstance(system, DelayedJumpSystem) else "no delay"
            shown = "detected" if isinstance(process, FaultDetection) else "true"
            raise FieldError("method", f"{asked!r} is not for this plant, which has {delay} inside and shows the {shown} mode")
        if found.gain is None:
            raise FieldError("kind", "the design came back without gains")
        return found.gain

    def _fitting(self, system: JumpSystem) -> Siqc:
        assert self.constraint is not None
        wanted = self.constraint.siqc()
        p, q = (0 if matrix is None else matrix.shape[axis] for matrix, axis in ((system.c, 1), (system.e, 2)))
        if wanted.g12.shape != (p, q):
            said = f"shape {wanted.g12.shape}, expected {(p, q)}: outputs y and disturbances w of the plant"
            raise FieldError("constraint.g12", said)
        return wanted

    def _starts(self, shown: SemiMarkov) -> Partition | None:
        from design.processes.partitions import check_partition, equal_probability

        if self.starts_s:
            try:
                check_partition(shown, self.starts_s)
            except ValueError as error:
                raise FieldError("starts_s", f"{error}") from None
            return self.starts_s
        return equal_probability(shown, self.sections) if self.sections else None


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedScheduled:
    """The printed gains of Chapters 2 to 4, as an experiment can name them; of the plant they say nothing.

    Args:
        gains: ``ch2`` (2.27), ``ch2-reference`` (those of [1, 2]), ``ch3``, ``ch4`` ((4.30), seen modes only) or
            ``ch4-partitioned`` (4.31).
    """

    gains: Literal["ch2", "ch2-reference", "ch3", "ch4", "ch4-partitioned"]

    gains_given: ClassVar[bool] = True
    """Nothing is solved: they are printed."""

    def solve(self, task: DesignTask) -> Scheduled:
        """Return the gains as the controller that runs; nothing is solved."""
        import design.as_printed as p

        tables: dict[str, Callable[[], ScheduledGain]] = {
            "ch2": p.chapter2_gain,
            "ch2-reference": p.chapter2_reference_gain,
            "ch3": p.chapter3_gain,
            "ch4": lambda: p.chapter4_seen_gain(partitioned=False),
            "ch4-partitioned": lambda: p.chapter4_seen_gain(partitioned=True),
        }
        return scheduled_of(tables[self.gains]())


def scheduled_of(gain: ScheduledGain, constraint: QuadraticConstraint | None = None) -> Scheduled:
    """Return the controller that runs a :class:`ScheduledGain`, with the constraint that it is to meet."""
    return Scheduled(gain=nested(gain.gain), starts_s=nested(gain.starts_s), schedule=gain.schedule, constraint=constraint)
