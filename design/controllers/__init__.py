"""What runs inside a loop. Importing this room imports numpy and nothing heavier, because a process that keeps time does."""

from design.controllers.contract import (
    Gains,
    LoopModel,
    Rows,
    RunningController,
    Selection,
    StaticGains,
    packet_samples,
    row_count,
)
from design.controllers.published_motor import PublishedH2, PublishedHinf
from design.controllers.send_all import Constant, GainIndex, Local, SendAll, feedforward, nested

__all__ = [
    "Constant", "GainIndex", "Gains", "Local", "LoopModel", "PublishedH2", "PublishedHinf", "Rows", "RunningController",
    "Selection", "SendAll", "StaticGains", "feedforward", "nested", "packet_samples", "row_count",
]  # fmt: skip
