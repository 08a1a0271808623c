"""What runs inside a loop. Importing this room imports numpy and nothing heavier, because a process that keeps time does."""

from design.controllers.contract import (
    Controller,
    CountsSojourns,
    FromSamples,
    Gains,
    GainTable,
    HistoryGains,
    IntegralAction,
    Known,
    LoopModel,
    ModeSchedule,
    Rows,
    RunningController,
    Sample,
    Selection,
    SeveralSamples,
    TellsAges,
    ages_told,
    integrates,
    packet_samples,
    row_count,
    sojourns_told,
)
from design.controllers.gain_rows_many import feedforward, held_exactly
from design.controllers.historical import Historical
from design.controllers.linear_law import LinearFeedback, LinearLaw, OutputFeedback
from design.controllers.published_motor import PublishedH2, PublishedHinf
from design.controllers.send_all import Constant, GainIndex, Local, SendAll, nested
from design.controllers.sensor_nodes import SensorNodes, Turns

__all__ = [
    "Constant", "Controller", "CountsSojourns", "FromSamples", "GainIndex", "GainTable", "Gains", "Historical",
    "HistoryGains", "IntegralAction", "Known", "LinearFeedback", "LinearLaw", "Local", "LoopModel", "ModeSchedule",
    "OutputFeedback", "PublishedH2", "PublishedHinf", "Rows", "RunningController", "Sample", "Selection", "SendAll",
    "SensorNodes", "SeveralSamples", "TellsAges", "Turns", "ages_told", "feedforward", "held_exactly", "integrates", "nested",
    "packet_samples", "row_count", "sojourns_told",
]  # fmt: skip
