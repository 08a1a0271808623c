"""What runs inside a loop. Importing this room imports numpy and nothing heavier, because a process that keeps time does.

Each name brings its module when it is first used: a process pays for the controller that it runs, and for no other.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from design.controllers.contract import (
        Controller,
        DistinguishesAges,
        Gains,
        GainTable,
        HistoryGains,
        IntegralAction,
        Known,
        LoopModel,
        ModeSchedule,
        MultiSampleController,
        Rows,
        RowsOfStays,
        RunningController,
        Sample,
        Selection,
        SeveralSamples,
        SojournDependent,
        ages_distinguished,
        check_row_sojourns,
        integral_limit,
        integrates,
        packet_samples,
        row_count,
        row_sojourns_distinguished,
        sojourns_distinguished,
    )
    from design.controllers.gain_rows import GainIndex, nested
    from design.controllers.gain_rows_many import feedforward, held_exactly
    from design.controllers.historical import Historical
    from design.controllers.linear_law import AgedFeedback, AgedRows, LinearFeedback, LinearLaw, OutputFeedback, RowsLaw
    from design.controllers.send_all import Constant, Local, PublishedH2, PublishedHinf, SendAll
    from design.controllers.sensor_nodes import SensorNodes, Turns

_HOMES: Final = {
    "AgedFeedback": "design.controllers.linear_law",
    "AgedRows": "design.controllers.linear_law",
    "Constant": "design.controllers.send_all",
    "Controller": "design.controllers.contract",
    "SojournDependent": "design.controllers.contract",
    "MultiSampleController": "design.controllers.contract",
    "GainIndex": "design.controllers.gain_rows",
    "GainTable": "design.controllers.contract",
    "Gains": "design.controllers.contract",
    "Historical": "design.controllers.historical",
    "HistoryGains": "design.controllers.contract",
    "IntegralAction": "design.controllers.contract",
    "Known": "design.controllers.contract",
    "LinearFeedback": "design.controllers.linear_law",
    "LinearLaw": "design.controllers.linear_law",
    "Local": "design.controllers.send_all",
    "LoopModel": "design.controllers.contract",
    "ModeSchedule": "design.controllers.contract",
    "OutputFeedback": "design.controllers.linear_law",
    "PublishedH2": "design.controllers.send_all",
    "PublishedHinf": "design.controllers.send_all",
    "Rows": "design.controllers.contract",
    "RowsOfStays": "design.controllers.contract",
    "RowsLaw": "design.controllers.linear_law",
    "RunningController": "design.controllers.contract",
    "Sample": "design.controllers.contract",
    "Selection": "design.controllers.contract",
    "SendAll": "design.controllers.send_all",
    "SensorNodes": "design.controllers.sensor_nodes",
    "SeveralSamples": "design.controllers.contract",
    "DistinguishesAges": "design.controllers.contract",
    "Turns": "design.controllers.sensor_nodes",
    "ages_distinguished": "design.controllers.contract",
    "check_row_sojourns": "design.controllers.contract",
    "feedforward": "design.controllers.gain_rows_many",
    "held_exactly": "design.controllers.gain_rows_many",
    "integral_limit": "design.controllers.contract",
    "integrates": "design.controllers.contract",
    "nested": "design.controllers.gain_rows",
    "packet_samples": "design.controllers.contract",
    "row_count": "design.controllers.contract",
    "row_sojourns_distinguished": "design.controllers.contract",
    "sojourns_distinguished": "design.controllers.contract",
}

__all__ = [
    "AgedFeedback",
    "AgedRows",
    "Constant",
    "Controller",
    "DistinguishesAges",
    "GainIndex",
    "GainTable",
    "Gains",
    "Historical",
    "HistoryGains",
    "IntegralAction",
    "Known",
    "LinearFeedback",
    "LinearLaw",
    "Local",
    "LoopModel",
    "ModeSchedule",
    "MultiSampleController",
    "OutputFeedback",
    "PublishedH2",
    "PublishedHinf",
    "Rows",
    "RowsLaw",
    "RowsOfStays",
    "RunningController",
    "Sample",
    "Selection",
    "SendAll",
    "SensorNodes",
    "SeveralSamples",
    "SojournDependent",
    "Turns",
    "ages_distinguished",
    "check_row_sojourns",
    "feedforward",
    "held_exactly",
    "integral_limit",
    "integrates",
    "nested",
    "packet_samples",
    "row_count",
    "row_sojourns_distinguished",
    "sojourns_distinguished",
]  # fmt: skip


if not TYPE_CHECKING:  # a type checker shall tell a name that is not there

    def __getattr__(name: str) -> object:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
