"""*Send all, apply one*: a packet carries one input per delay that it may meet, the actuator applies one (7.9)-(7.13).

*Send all, apply one* over several sensor nodes: the gain is chosen by the age of each node's newest sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from typing import ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import (
    Gains,
    LoopModel,
    MultiSampleController,
    RunningController,
    Selection,
    StateGains,
    check_row_sojourns,
    controller_traits,
    row_count,
)
from design.controllers.gain_rows import BatchGainRows, GainRows, NodeGainRows, NodeGainRowsOfMany
from design.errors import FieldError, check_above_zero


@dataclass(frozen=True, slots=True, kw_only=True)
class SendAll:
    """*Send all, apply one* static output feedback with any table of gains (7.9)-(7.13).

    Args:
        gains: nested tuple [tau][row][m][p]. One gain matrix (m x p, input unit per output unit) for every measured tau and every
            row; one matrix for all of them is kind = "local".
        selection: which row the actuator applies (`hil guide own-plant-law-controller`).
        integral: the gains have p more columns, for the integral of the measured error (Remark 7.7).
        integral_limit: largest size of the integral of each output's error, output unit times slots: it is clamped there, against
            wind-up. One entry per output; absent: no clamp.
        sojourns: how many tables belong to every tau, for 1, 2, ... slots that it has lasted (the last for all longer ones), over
            semi-Markov delays; by default one each, whatever it has lasted.
        samples: samples per packet: the gains have p columns for y(k - tau), then p for y(k - tau - 1), and so on.
        ages: several sensor nodes: how many ages 0, 1, ... of each node have tables of their own, those of the last node first
            (as digits count); by default a table belongs to the oldest of the nodes' ages.
        state_gains: [tau][c][p + c], for a state xi of the controller's own, of size c: xi(k+1) = state_gains[tau] [y; xi], y the
            errors of the samples, and their sum between where there is an integral. The gains have c more columns, of xi.
        row_sojourns: how many rows belong to every d, for 1, 2, ... slots that it has lasted (the last for all longer ones), over
            semi-Markov delays: [tau][d row_sojourns + slots - 1][m][p], for ``selection = "applied"``.
    """

    kind: ClassVar[str] = "send-all"

    gains: Gains
    selection: Selection = "applied"
    integral: bool = False
    integral_limit: tuple[float, ...] = ()
    sojourns: tuple[int, ...] = ()
    samples: int = 1
    state_gains: StateGains = ()
    ages: tuple[int, ...] = ()
    row_sojourns: int = 1

    def __post_init__(self) -> None:
        if self.samples < 1:
            raise FieldError("samples", f"{self.samples}, expected at least 1")
        check_row_sojourns(self.row_sojourns, self.selection, "selection")
        if self.integral_limit and not self.integral:
            raise FieldError("integral_limit", "needs integral = true: without it there is no sum to clamp")
        check_above_zero(**{f"integral_limit[{i}]": most for i, most in enumerate(self.integral_limit)})
        if self.ages and (min(self.ages) < 1 or prod(self.ages) != len(self.gains)):
            raise FieldError("ages", f"{list(self.ages)}, expected counts whose product is {len(self.gains)}, one per table")
        if self.ages and self.sojourns:
            raise FieldError("sojourns", "needs one sensor node; with ages the tables belong to the ages of several nodes")
        try:
            shape = np.asarray(self.gains, dtype=float).shape
        except ValueError:
            shape = ()
        if len(shape) != 4:
            raise FieldError("gains", "expected [tau][row][m][p] with equal lengths")
        if self.state_gains:
            try:
                own = np.asarray(self.state_gains, dtype=float).shape
            except ValueError:
                own = ()
            if len(own) != 3 or own[0] != shape[0] or not 0 < own[1] < own[2] or own[2] != shape[3]:
                raise FieldError("state_gains", f"shape {list(own)}, expected [{shape[0]}][c][{shape[3]}], c columns of xi")
        if self.sojourns and (min(self.sojourns) < 0 or sum(self.sojourns) != shape[0]):
            raise FieldError("sojourns", f"{list(self.sojourns)}, expected counts whose sum is the number of tables, {shape[0]}")

    def table(self, model: LoopModel) -> NDArray[np.float64]:
        K = np.asarray(self.gains, dtype=float)
        m, p = model.B.shape[1], model.C.shape[0]
        if len(self.integral_limit) not in (0, p):
            raise FieldError("integral_limit", f"length {len(self.integral_limit)}, expected {p}: one for each output")
        rows = row_count(self.selection, model.d_max, self.row_sojourns)
        width = p * (self.samples + self.integral) + controller_traits(self).order
        if K.shape[1:] != (rows, m, width):
            raise FieldError(
                "gains",
                f"shape {list(K.shape)} does not fit the loop; expected [tau][{rows}][{m}][{width}] "
                f"for selection {self.selection!r} with d up to {model.d_max}, the max_age of network.ca"
                + (f", and {self.row_sojourns} row_sojourns" if self.row_sojourns > 1 else ""),
            )
        if self.ages:
            count = len(model.nodes.names)
            if len(self.ages) != count:
                raise FieldError("ages", f"{list(self.ages)}, expected one number for each of {count} sensor nodes")
        elif len(self.sojourns or K) < model.tau_max + 1:
            raise FieldError("gains", f"{len(self.sojourns or K)} tables, but tau reaches {model.tau_max}")
        return K

    def start(self, model: LoopModel) -> RunningController | MultiSampleController:
        running = GainRows(
            self.table(model), self.selection, model, self.integral, self.sojourns, self.integral_limit, self.state_gains
        )  # fmt: skip
        if len(self.ages) < 2:  # of one node, the age is tau itself
            return running
        return NodeGainRows(running, model, self.ages, row_count(self.selection, model.d_max, self.row_sojourns))

    def start_batch(self, model: LoopModel, runs: int) -> BatchGainRows | NodeGainRowsOfMany | None:
        """Return a batch of `runs` controllers, ready for slot 0; None over several nodes of which one may keep silent."""
        if len(self.ages) > 1 and model.nodes.silent:
            return None
        running = BatchGainRows(
            self.table(model), self.selection, model, runs, self.integral, self.sojourns, self.integral_limit, self.state_gains
        )  # fmt: skip
        return running if len(self.ages) < 2 else NodeGainRowsOfMany(running, self.ages)


class TableAlone(Protocol):
    """A controller that is nothing but its table of gains."""

    @property
    def selection(self) -> Selection: ...

    def table(self, model: LoopModel) -> NDArray[np.float64]: ...

    def start(self, model: LoopModel) -> RunningController:
        return GainRows(self.table(model), self.selection, model)

    def start_batch(self, model: LoopModel, runs: int) -> BatchGainRows:
        """Return a batch of `runs` controllers, ready for slot 0."""
        return BatchGainRows(self.table(model), self.selection, model, runs)


def _published(values: Sequence[Sequence[float]], model: LoopModel) -> NDArray[np.float64]:
    K = np.asarray(values, dtype=float)[:, :, None, None]
    if model.B.shape[1] != 1 or model.C.shape[0] != 1:
        raise FieldError("kind", "the published motor gains are for one input and one output")
    if model.d_max + 1 > K.shape[1] or model.tau_max + 1 > K.shape[0]:
        raise FieldError(
            "kind",
            f"the published gains cover tau <= {K.shape[0] - 1} and d <= {K.shape[1] - 1}; "
            f"the links reach tau = {model.tau_max}, d = {model.d_max}",
        )
    return K[:, : model.d_max + 1]


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedHinf(TableAlone):
    """The thesis's H-infinity gains (7.36) for the DC motor, with the printed selection rule (7.13) by default.

    Args:
        selection: which row the actuator applies (`hil guide own-plant-law-controller`).
    """

    selection: Literal["generated", "applied"] = "generated"

    def table(self, model: LoopModel) -> NDArray[np.float64]:
        return _published([[-0.1576, -0.1318], [-0.0878, 0.0091], [-0.0342, 0.0074]], model)


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedH2(TableAlone):
    """The thesis's H2 gains (7.37) for the DC motor, with the printed selection rule (7.13) by default.

    Args:
        selection: which row the actuator applies (`hil guide own-plant-law-controller`).
    """

    selection: Literal["generated", "applied"] = "generated"

    def table(self, model: LoopModel) -> NDArray[np.float64]:
        return _published([[-0.1980, -0.1647], [-0.1232, -0.0547], [-0.0747, -0.0399]], model)
