"""The gains that Section 7.4 prints for the DC motor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import LoopModel, RunningController
from design.controllers.gain_rows import GainRows
from design.controllers.gain_rows_many import BatchGainRows
from design.errors import FieldError


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
class PublishedHinf:
    """The thesis's H-infinity gains (7.36) for the DC motor, with the printed selection rule (7.13) by default.

    Args:
        selection: which row the actuator applies; see the module's table.
    """

    selection: Literal["generated", "applied"] = "generated"

    def table(self, model: LoopModel) -> NDArray[np.float64]:
        return _published([[-0.1576, -0.1318], [-0.0878, 0.0091], [-0.0342, 0.0074]], model)

    def start(self, model: LoopModel) -> RunningController:
        return GainRows(self.table(model), self.selection, model)

    def start_batch(self, model: LoopModel, runs: int) -> BatchGainRows:
        """Return so many of them, ready for slot 0."""
        return BatchGainRows(self.table(model), self.selection, model, runs)


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedH2:
    """The thesis's H2 gains (7.37) for the DC motor, with the printed selection rule (7.13) by default.

    Args:
        selection: which row the actuator applies; see the module's table.
    """

    selection: Literal["generated", "applied"] = "generated"

    def table(self, model: LoopModel) -> NDArray[np.float64]:
        return _published([[-0.1980, -0.1647], [-0.1232, -0.0547], [-0.0747, -0.0399]], model)

    def start(self, model: LoopModel) -> RunningController:
        return GainRows(self.table(model), self.selection, model)

    def start_batch(self, model: LoopModel, runs: int) -> BatchGainRows:
        """Return so many of them, ready for slot 0."""
        return BatchGainRows(self.table(model), self.selection, model, runs)
