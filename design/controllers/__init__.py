"""What runs inside a loop. Importing this room imports numpy and nothing heavier, because a process that keeps time does.

Each name brings its module when it is first used: a process pays for the controller that it runs, and for no other.
"""

from __future__ import annotations

from design import exports

TYPE_CHECKING = False  # the import of typing takes time
if TYPE_CHECKING:
    from design.controllers.contract import Controller as Controller
    from design.controllers.contract import DistinguishesAges as DistinguishesAges
    from design.controllers.contract import Gains as Gains
    from design.controllers.contract import GainTable as GainTable
    from design.controllers.contract import HistoryGains as HistoryGains
    from design.controllers.contract import IntegralAction as IntegralAction
    from design.controllers.contract import Known as Known
    from design.controllers.contract import LoopModel as LoopModel
    from design.controllers.contract import ModeSchedule as ModeSchedule
    from design.controllers.contract import MultiSampleController as MultiSampleController
    from design.controllers.contract import Rows as Rows
    from design.controllers.contract import RowsOfStays as RowsOfStays
    from design.controllers.contract import RunningController as RunningController
    from design.controllers.contract import Sample as Sample
    from design.controllers.contract import Selection as Selection
    from design.controllers.contract import SeveralSamples as SeveralSamples
    from design.controllers.contract import SojournDependent as SojournDependent
    from design.controllers.contract import check_row_sojourns as check_row_sojourns
    from design.controllers.contract import controller_traits as controller_traits
    from design.controllers.contract import row_count as row_count
    from design.controllers.gain_rows import GainIndex as GainIndex
    from design.controllers.gain_rows import feedforward as feedforward
    from design.controllers.gain_rows import nested as nested
    from design.controllers.historical import Historical as Historical
    from design.controllers.linear_law import AgedFeedback as AgedFeedback
    from design.controllers.linear_law import AgedRows as AgedRows
    from design.controllers.linear_law import LinearFeedback as LinearFeedback
    from design.controllers.linear_law import LinearLaw as LinearLaw
    from design.controllers.linear_law import RowsLaw as RowsLaw
    from design.controllers.one_row import Constant as Constant
    from design.controllers.one_row import Local as Local
    from design.controllers.one_row import OutputFeedback as OutputFeedback
    from design.controllers.send_all import PublishedH2 as PublishedH2
    from design.controllers.send_all import PublishedHinf as PublishedHinf
    from design.controllers.send_all import SendAll as SendAll
    from design.controllers.sensor_nodes import SensorNodes as SensorNodes
    from design.controllers.sensor_nodes import Turns as Turns
else:
    __getattr__, __dir__, __all__ = exports(__name__, __path__[0])
