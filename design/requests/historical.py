"""Gains over historical data as an experiment asks for them: of least cost for its own plant and nodes, or as printed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
import numpy.typing as npt
from msgspec.structs import replace

from design.controllers.gain_rows import nested
from design.controllers.historical import Historical
from design.controllers.sensor_nodes import PacketWindow, SensorNodes, Uses
from design.errors import FieldError, check_above_zero, check_at_least_zero
from design.requests.tracking import DesignTask
from design.tracking.gain_cache import cached_history

if TYPE_CHECKING:
    from design.historical_data import DelayedPlant


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoricalDesigned:
    """Gains of least cost over scheduled sensor nodes, solved for the plant and the nodes of the experiment (Section 5.3).

    Args:
        uses: ``history``: all that has come; ``current-packet``: the packet of this slot; ``newest``: its newest sample.
            ``last-packets``: those of the last ``window`` slots, with gains of their own for every outcome.
        window: ``last-packets``: slots.
        memory: age in slots of the oldest sample that is used; by default the oldest of the first full cycle, or of a packet.
        start: what the cost is the mean over: ``average``: x(0) ~ N(0, I) in any phase; ``given``: the plant's x(0), in
            the schedule's first phase.
        input_weight: a number on u'u in the cost of the design, on top of the plant's own weights.
        peak_input: largest |u| of a run from the plant's x(0) with a zero history; the input weight is then the least that keeps
            to it, in place of any other. Needs ``start = "given"`` and turns that follow a cycle without loss.
    """

    uses: Literal["history", "current-packet", "newest", "last-packets"] = "history"
    window: int = 2
    memory: int | None = None
    start: Literal["average", "given"] = "average"
    input_weight: float = 0.0
    peak_input: float | None = None

    def __post_init__(self) -> None:
        if self.memory is not None and not 0 <= self.memory <= 100:
            raise FieldError("memory", f"{self.memory}, expected 0 to 100 slots")
        if not 1 <= self.window <= 10:
            raise FieldError("window", f"{self.window}, expected 1 to 10 slots")
        check_at_least_zero(input_weight=self.input_weight)
        check_above_zero(peak_input=self.peak_input)
        if self.peak_input is not None:
            if self.start != "given" or self.uses == "last-packets":
                raise FieldError("peak_input", "bounds one run: it needs start = 'given', and uses other than 'last-packets'")
            if self.input_weight:
                raise FieldError("peak_input", "sets the input weight itself: leave out input_weight")

    def solve(self, task: DesignTask) -> Historical:
        """Return the gains as the controller that runs.

        Raises:
            ValueError: a plant or nodes for which nothing can be designed.
        """
        from design.historical_data.guaranteed_cost import Start, average_start
        from design.historical_data.least_cost import match_peak, synthesise
        from design.historical_data.sensor_schedule import (
            lossy,
            mask_of,
            phase_chain,
            phases_at_start,
            undecided_because,
            with_lost_turns,
        )

        nodes, plant = task.model.nodes, task.delayed_plant
        if plant is None or task.initial_state is None:
            raise FieldError("kind", "needs a plant in slots whose state is measured, with a cost (state_delays, cost_weights)")
        m = plant.B.shape[1]
        weight = self.input_weight * np.eye(m) + (0.0 if plant.input_weight is None else plant.input_weight)
        problem = dataclasses.replace(plant, input_weight=weight)
        if self.uses == "last-packets":
            return self._of_last_packets(problem, nodes, task.initial_state)
        uses: Literal["history", "current-packet"] = "history" if self.uses == "history" else "current-packet"
        if self.uses == "history" and nodes.turns is not None and nodes.turns.transition:
            raise FieldError("uses", "over random turns only the current packet has gains of its own: uses = 'current-packet'")
        unknown = undecided_because(nodes)
        if unknown:
            raise FieldError("kind", unknown)
        if uses == "history" and lossy(nodes.turns):
            raise FieldError("uses", "over lost packets gains are designed for uses = 'current-packet' or 'last-packets'")
        if self.uses != "history" and (nodes.turns is None or nodes.turns.received):
            raise FieldError("uses", "where several packets come in a slot, gains are over all that has come: uses = 'history'")
        try:
            mask = mask_of(nodes, self.memory, uses)
        except ValueError as error:
            raise FieldError("memory", str(error)) from None
        if self.uses == "newest":
            late = max(delay or 0 for delay in nodes.delays)
            mask &= (np.arange(mask.shape[1]) == late)[None, :, None]
        phases = len(mask)
        at = phases_at_start(nodes, uses)
        full: npt.NDArray[np.bool_] = with_lost_turns(mask, nodes).astype(bool)
        if self.start == "given":
            start = Start(moment=np.outer(task.initial_state, task.initial_state), phases=at)
        else:
            start = average_start(len(plant.A), len(full))
            if nodes.turns is not None and nodes.turns.loss:
                share = nodes.turns.loss
                start = Start(moment=start.moment, phases=np.kron([1.0 - share, share], np.full(phases, 1.0 / phases)))
        chain = phase_chain(nodes)
        if self.peak_input is not None:
            if chain is not None:
                raise FieldError("peak_input", "needs turns in a cycle, and a medium that loses no packet")
            matched = match_peak(problem, full, task.initial_state, int(at.argmax()), self.peak_input)
            return historical_of(matched.gains, uses)
        K = cached_history((problem, full, start, chain), lambda: synthesise(problem, full, start, transition=chain))
        return historical_of(K[:phases], uses)

    def _of_last_packets(self, plant: DelayedPlant, nodes: SensorNodes, x0: npt.NDArray[np.float64]) -> Historical:
        from design.historical_data.guaranteed_cost import Start
        from design.historical_data.least_cost import synthesise
        from design.historical_data.sensor_schedule import (
            undecided_because,
            window_chain,
            window_mask,
            window_start,
            window_undecided,
        )

        if nodes.turns is None:
            raise FieldError("uses", "the last packets need nodes that take turns")
        window = PacketWindow(turns=nodes.turns, length=self.window)
        unknown = undecided_because(nodes) or window_undecided(nodes, window)
        if unknown:
            raise FieldError("kind", unknown)
        memory = self.window + max(nodes.buffers) - 2 if self.memory is None else self.memory
        given = self.start == "given" or not nodes.turns.order
        first = [nodes.turns.phase] if given else range(len(nodes.turns.order))
        begins = [PacketWindow(turns=replace(nodes.turns, phase=phase), length=self.window) for phase in first]
        phases = np.mean([window_start(begin) for begin in begins], axis=0)
        moment = np.outer(x0, x0) if self.start == "given" else np.eye(len(plant.A))
        mask, start = window_mask(nodes, window, memory), Start(moment=moment, phases=phases)
        chain = window_chain(window)
        K = cached_history((plant, mask, start, chain), lambda: synthesise(plant, mask, start, transition=chain))
        return historical_of(K, "last-packets")


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedHistorical:
    """The printed gains of Section 5.4, as an experiment can name them; of the plant they say nothing.

    Args:
        gains: ``historical`` (5.16), or ``newest`` (5.17), those of the comparison.
    """

    gains: Literal["historical", "newest"]

    gains_given: ClassVar[bool] = True
    """Nothing is solved: they are printed."""

    def solve(self, task: DesignTask) -> Historical:
        """Return the gains as the controller that runs; nothing is solved."""
        from design.as_printed.chapters_5_and_6 import historical_gains, newest_gains

        if self.gains == "historical":
            return historical_of(historical_gains(), "history")
        return historical_of(newest_gains(), "current-packet")


def historical_of(K: npt.NDArray[np.float64], uses: Uses) -> Historical:
    """Return the controller that runs an array K[phase, j, m, p]."""
    return Historical(gains=nested(K), uses=uses)
